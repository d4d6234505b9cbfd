"""Lines of README.md, run as they are written, and the tutorials.

    python -m benchmarks.people.readme --figures benchmarks/results/people.json

`readme_lines_failed` counts the lines that do not end with 0, against the daemon of `make serve`
and once more where it wants tokens. That second time the line that makes the first token is run
before all others, and its token stands in `VEILCAM_TOKEN`. Blocks of code and spans that begin with
one of our programs are lines; `LEFT` names those that are not run, each with its reason. Commands
in tables are the measurements of their figures. A line with a word such as LINE gets what an
earlier line printed, as the page says.

`concepts_to_array` counts what a reader has to name between `make serve` and the first array,
each thing once: commands with their subcommands, options, files, classes, and arguments by
keyword. Not counted: the URL, which `make serve` prints; the folder of the programs, which is the
same for all; words that are free, as a label; and methods and attributes of the array's own line,
without which no design does. README had seven: `veilcam receiver keygen`, `veilcam receiver add`,
`--label`, receiver.key, receiver.pub, `Camera` and `key=`.

`tutorials_run` counts the tutorials whose test passed.
"""

from __future__ import annotations

import ast
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from itertools import dropwhile, pairwise
from pathlib import Path
from typing import Final

import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.rig import work_folder
from tests.docs.lines import BLOCK, ROOT, Desk, Line, LineError, lines, make_serve

README = ROOT / "README.md"
TUTORIALS = ROOT / "tests" / "docs" / "test_tutorials.py"
SERVE: Final = "make serve"
FIRST: Final = "sudo veilcamd token first"
LEFT = {
    "make demo": "takes a minute: tests/app/server/demo/test_demo.py",
    "make check": "runs the tests: .ci/run",
    "make test": "runs the tests: .ci/run",
    "make docs": "builds the site: tests/docs/test_reference.py",
    "make PYTHON=PATH": "installs: tests/docs/test_makefile.py",
    "pip install": "installs: tests/system/clean_root/__main__.py",
    "veilcamd demo --fresh": "takes a minute: tests/app/server/demo/test_demo.py",
    "veilcamd doctor": "wants a Raspberry Pi: tests/app/server/doctor/test_doctor.py",
    "veilcam-train attack report": "takes minutes: tests/unit/training/cli/test_attack.py",
}
"""Lines that begin like these are left to their own tests: the reason, and the test."""
SPAN = re.compile(r"`((?:veilcam[a-z-]*|make|pip) [^`]+)`")


def spans(page: str) -> list[Line]:
    """Return the command lines that stand in sentences: spans of code outside blocks and tables."""
    text = re.sub(r"^\|.*$", "", BLOCK.sub("", page), flags=re.MULTILINE)
    return [Line(" ".join(each.split())) for each in SPAN.findall(text)]


def written(page: str) -> list[Line]:
    """Return all lines of the page that are run, in order, each once."""
    found = dict.fromkeys([*lines(page), *spans(page)])
    return [each for each in found if not each.text.startswith((SERVE, *LEFT))]


def failures(page: str, *options: str) -> Iterator[str]:
    """Run all lines against one daemon; yield what was wrong with each that failed.

    Args:
        page: text of the page.
        options: options of ``veilcamd serve`` besides those of ``make serve``.
    """
    todo = written(page)
    with work_folder() as folder:
        desk = Desk(folder)
        with desk.serving(*make_serve(), *options):
            if options:
                todo.remove(Line(FIRST))
                desk.run(Line(FIRST))
                desk.environment["VEILCAM_TOKEN"] = desk.said("TOKEN")
            for line in todo:
                try:
                    desk.run(line)
                except LineError as error:
                    yield str(error)


def concepts(page: str) -> list[str]:
    """Return what a reader names between ``make serve`` and the first array."""
    found: dict[str, None] = {}
    after = dropwhile(lambda line: line.text != SERVE, lines(page))
    for line in after:
        if line.python:
            found |= dict.fromkeys(_names(line.text))
            if ".embedding" in line.text:
                return list(found)
        elif not line.text.startswith((SERVE, *LEFT)):
            found |= dict.fromkeys(_words(line.text))
    raise LookupError("the page makes no array")


def _words(command: str) -> Iterator[str]:
    """Yield the command, options and files of a command line; an option's value is free."""
    words = [Path(each).name for each in shlex.split(command)]
    plain = [each for each in words if re.fullmatch(r"[a-z-]+", each) and each[0] != "-"]
    value_of = {after: option for option, after in pairwise(words)}
    yield " ".join(each for each in plain if not value_of.get(each, "").startswith("-"))
    yield from (each for each in words if each.startswith("--") or re.search(r"\w\.\w", each))


def _names(program: str) -> Iterator[str]:
    """Yield the classes, keywords and files of a program."""
    for node in ast.walk(ast.parse(program)):
        if isinstance(node, ast.ImportFrom):
            yield from (each.name for each in node.names)
        elif isinstance(node, ast.keyword):
            yield f"{node.arg}="
        elif isinstance(node, ast.Constant) and re.fullmatch(r"\w+\.\w+", str(node.value)):
            yield str(node.value)


def main(*, figures: FiguresOption = None) -> None:
    """Run the lines and the tutorials; status 1 if one fails."""
    page = README.read_text()
    failed = [*failures(page), *failures(page, "--auth", "tokens")]
    for error in failed:
        typer.echo(error)
    run = [sys.executable, "-m", "pytest", "-q", str(TUTORIALS)]
    told = subprocess.run(run, stdout=subprocess.PIPE, text=True, check=False).stdout
    passed = re.search(r"(\d+) passed", told)
    tutorials = int(passed[1]) if passed else 0
    typer.echo(told)
    named = concepts(page)
    typer.echo(f"{len(written(page))} lines, concepts: {', '.join(named)}")
    values = {
        "readme_lines_failed": len(failed),
        "concepts_to_array": len(named),
        "tutorials_run": tutorials,
    }
    typer.echo("\n".join(f"{name}: {value}" for name, value in values.items()))
    record(figures, values)
    raise SystemExit(bool(failed) or tutorials < TUTORIALS.read_text().count("def test_"))


if __name__ == "__main__":
    typer.run(main)
