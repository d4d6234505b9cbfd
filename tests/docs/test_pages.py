"""Pages: commands, options, links, figures, equations, and ways to install."""

from __future__ import annotations

import re
import shlex
import subprocess
import tomllib
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest
from benchmarks.tables import privacy
from benchmarks.tables.pages import PAGES as WITH_TABLES
from benchmarks.tables.pages import with_tables
from typer.core import TyperCommand, TyperGroup, TyperOption
from typer.main import get_command

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    *(ROOT / name for name in ("README.md", "SECURITY.md", "CONTRIBUTING.md", "deploy/README.md")),
    *sorted((ROOT / "docs").glob("*.md")),
]
NAMES = [str(page.relative_to(ROOT)) for page in PAGES]
PROGRAMS = {
    "veilcam": "veilcam_client.cli.main",
    "veilcam-mqtt": "veilcam_mqtt.cli",
    "veilcamd": "veilcam_server.cli.main",
    "veilcam-train": "veilcam_training.cli.main",
    "veilcam-optics": "veilcam_optics.cli.main",
}
BLOCK = re.compile(r"^```\w*\n(.*?)^```", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"(?:^|[\s/])(veilcam(?:d|-train|-optics|-mqtt)?) ([a-z][a-z-]*(?=\s|$).*)")

OTHERS = {"--long"}
Command = TyperCommand | TyperGroup


@cache
def program(name: str) -> Command:
    command = get_command(import_module(PROGRAMS[name]).app)
    assert isinstance(command, TyperCommand | TyperGroup)
    return command


def code(text: str) -> Iterator[str]:
    """Every line of a block of code, a line that goes on joined; then every span of code."""
    text = text.replace("\\\n", " ")
    for block in BLOCK.findall(text):
        yield from block.splitlines()
    text = BLOCK.sub("", text)
    yield from re.findall(r"^    .*$", text, re.MULTILINE)
    yield from (span.replace("\n", " ") for span in re.findall(r"`([^`]+)`", text))


def commands(text: str) -> Iterator[tuple[str, list[str]]]:
    for line in code(text):
        if found := COMMAND.search(line):
            name, rest = found.groups()
            yield name, shlex.split(rest, comments=True)


def resolved(name: str, words: list[str]) -> tuple[Command, list[str]]:
    command = program(name)
    while isinstance(command, TyperGroup) and words:
        assert words[0] in command.commands, f"{name} has no command {words[0]}"
        inner, words = command.commands[words[0]], words[1:]
        assert isinstance(inner, TyperCommand | TyperGroup)
        command = inner
    return command, words


def options(command: Command) -> set[str]:
    here = {
        option
        for each in command.params
        if isinstance(each, TyperOption)
        for option in (*each.opts, *each.secondary_opts)
    }
    return here | {"--help"}


@pytest.mark.parametrize("name", NAMES)
def test_commands_and_their_options_exist(name: str) -> None:
    for program_name, words in commands((ROOT / name).read_text()):
        command, rest = resolved(program_name, words)
        said = {word.partition("=")[0] for word in rest if word.startswith("--")}
        assert said <= options(command), f"{program_name} {' '.join(words)}"


def all_options(command: Command) -> Iterator[str]:
    yield from options(command)
    for inner in command.commands.values() if isinstance(command, TyperGroup) else ():
        assert isinstance(inner, TyperCommand | TyperGroup)
        yield from all_options(inner)


@pytest.mark.parametrize("name", NAMES)
def test_options_that_are_named_alone_exist(name: str) -> None:
    known = {option for each in PROGRAMS for option in all_options(program(each))} | OTHERS
    text = BLOCK.sub("", (ROOT / name).read_text())
    assert set(re.findall(r"`(--[a-z][a-z0-9-]*)[^`]*`", text)) <= known


def test_commands_are_found() -> None:
    block = "```\nsudo /bin/veilcamd show \\\n --digit 3  # three\n```"
    text = f"`veilcam status` and `veilcam bundle, signed`\n{block}"
    assert list(commands(text)) == [("veilcamd", ["show", "--digit", "3"]), ("veilcam", ["status"])]


def anchors(page: Path) -> set[str]:
    """As GitHub makes them of headings."""
    text = BLOCK.sub("", page.read_text())
    titles = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("name", [*NAMES, "CHANGELOG.md"])
def test_links_lead_somewhere(name: str) -> None:
    page = ROOT / name
    for path, anchor in re.findall(r"\]\((?!http)([^)#\s]*)#?([^)\s]*)\)", page.read_text()):
        target = page.parent / path if path else page
        assert target.exists(), path
        assert not anchor or anchor in anchors(target), f"{path}#{anchor}"


def test_figures_are_those_of_the_result_files() -> None:
    for name in WITH_TABLES:
        page = (ROOT / name).read_text()
        assert with_tables(name, page) == page, "run python -m benchmarks.tables"
    assert privacy.MODULE.read_text() == privacy.module(), "run python -m benchmarks.tables"


@pytest.mark.parametrize("name", ["own-pictures", "tutorial-label", "tutorial-receiver"])
def test_tutorial_is_one_page(name: str) -> None:
    assert len((ROOT / "docs" / f"{name}.md").read_text().split()) <= 450


def test_every_dependency_has_its_reason() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = list(project["dependencies"])
    for extra in project["optional-dependencies"].values():
        wanted += extra
    rows = (ROOT / "docs" / "dependencies.md").read_text()
    for requirement in wanted:
        name = re.split(r"[\[<>=]", requirement)[0]
        assert name == "veilcam" or re.search(rf"\b{re.escape(name)}\b", rows), name


FROM_AN_INDEX = re.compile(r"""pip3? install [^\n`]*?(?<![\w./+-])["']?veilcam(?![\w-])""")
"""Veilcam is on no package index."""


def test_installing_from_an_index_is_told_nowhere() -> None:
    listed = subprocess.run(
        ["git", "ls-files", "*.py", "*.md", "*.toml", "*.sh", "*.html", "*.js", "*.service"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    told = []
    for name in listed.stdout.split():
        # A message may go on in the next line of the code.
        text = re.sub(r'"\s*\n\s*f?"', "", (ROOT / name).read_text())
        told += [f"{name}: {found[0]}" for found in FROM_AN_INDEX.finditer(text)]
    assert told == []
    for wrong in ("veilcam", "'veilcam[mqtt]'", "-U veilcam[x]"):
        assert FROM_AN_INDEX.search(f"pip install {wrong}")
    for right in ("-e '.[mqtt]'", "./veilcam-1.whl"):
        assert not FROM_AN_INDEX.search(f"pip install {right}")


MATHEMATICS = (ROOT / "docs" / "mathematics.md").read_text()
NUMBER = re.compile(r" {6}\((\d+)\)$", re.MULTILINE)
CITED = re.compile(r"equation\s+\((\d+)\)")
NAMED = re.compile(r"\((\d+)\)")


def test_equations_are_numbered_in_order() -> None:
    numbers = [int(number) for number in NUMBER.findall(MATHEMATICS)]
    assert len(numbers) >= 10
    assert numbers == list(range(1, len(numbers) + 1))


def test_every_equation_that_the_mathematics_name_is_there() -> None:
    text = "\n".join(line for line in MATHEMATICS.splitlines() if not line.startswith("    "))
    assert set(NAMED.findall(text)) <= set(NUMBER.findall(MATHEMATICS))


def test_every_equation_that_the_code_cites_is_there() -> None:
    cited = {
        path: CITED.findall(path.read_text())
        for path in (ROOT / "optics" / "veilcam_optics").rglob("*.py")
    }
    numbers = set(NUMBER.findall(MATHEMATICS))
    assert sum(map(len, cited.values())) >= 6
    for path, found in cited.items():
        assert set(found) <= numbers, path
