"""How large the product is: statements at a commit and now, the fullest folder, a driver's traces.

    python -m benchmarks.structure 7e29704 --figures benchmarks/results/house.json

A statement is one of Python's, imports included; docstrings are counted apart.
"""

from __future__ import annotations

import ast
import re
import subprocess
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath
from typing import Annotated

import typer

from benchmarks.figures import FiguresOption, record

ROOT = Path(__file__).resolve().parents[1]
PRODUCT = ("client", "optics", "training", "server")
ENTRY = re.compile(r"^ +st7735r\.DRIVER,$", re.MULTILINE)


def sources_at(commit: str) -> dict[str, str]:
    """Every Python file of the product at ``commit``, by its path."""
    names = _git("ls-tree", "-r", "--name-only", commit, "--", *PRODUCT).splitlines()
    return {name: _git("show", f"{commit}:{name}") for name in names if name.endswith(".py")}


def statements(sources: Iterable[str]) -> tuple[int, int]:
    """Statements without docstrings, and docstrings."""
    code, documents = 0, 0
    for source in sources:
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.stmt):
                documents += _is_document(node)
                code += not _is_document(node)
    return code, documents


def fullest_folder(paths: Iterable[str]) -> tuple[str, int]:
    """The folder with the most modules, and how many those are."""
    folders = Counter(str(PurePosixPath(path).parent) for path in paths)
    return folders.most_common(1)[0]


def files_of_a_driver(sources: Mapping[str, str]) -> int:
    """Files that a panel's driver needs: its own, and those with a table of drivers."""
    return 1 + sum(1 for source in sources.values() if ENTRY.search(source))


def main(
    before: Annotated[str, typer.Argument(help="Commit to compare with.")],
    figures: FiguresOption = None,
) -> None:
    """Count what is committed."""
    old, new = sources_at(before), sources_at("HEAD")
    (then, documents_then), (now, documents_now) = (
        statements(sources.values()) for sources in (old, new)
    )
    folder, files = fullest_folder(new)
    print(f"statements: {then} at {before}, {now} now, {100 * (now / then - 1):+.1f} %")
    print(f"docstrings: {documents_then / then:.4f} a statement, {documents_now / now:.4f} now")
    print(f"fullest folder: {folder}, {files} modules")
    print(f"files of a panel's driver: {files_of_a_driver(new)}")
    record(
        figures,
        {
            "statements_before": then,
            "statements_after": now,
            "docstrings_per_statement_before": documents_then / then,
            "docstrings_per_statement_after": documents_now / now,
            "largest_folder_files": files,
            "panel_driver_files_touched": files_of_a_driver(new),
        },
    )


def _is_document(node: ast.stmt) -> bool:
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Constant)
        and isinstance(node.value.value, str)
    )


def _git(*arguments: str) -> str:
    done = subprocess.run(["git", *arguments], cwd=ROOT, check=True, capture_output=True, text=True)
    return done.stdout


if __name__ == "__main__":
    typer.run(main)
