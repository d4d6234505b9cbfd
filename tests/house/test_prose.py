"""Docstrings: the words that they and their argument lines may begin with; ruff has D401."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("client", "server", "optics", "training")
QUESTION = re.compile(
    r"(what|who|whom|whose|how|where|when|which|why|whether|from|of)\b", re.IGNORECASE
)
NO_NOUN = re.compile(
    r"(of|that|who|whose|with|to|which|by|behind|for|in|on|at|from|how|so|where|when|what|told|if|as|"
    r"whether|it|its|this|these|those)\b",
    re.IGNORECASE,
)
ARGUMENT = re.compile(r"^ {4}\*{0,2}[a-z_]\w*: (.*)")


def docstrings(source: str) -> Iterator[tuple[int, str]]:
    """Yield the docstrings of a module, its classes and functions, each with its line."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node)
            if text is not None:
                yield getattr(node, "lineno", 1), text


def faults(source: str) -> list[str]:
    """List the docstrings that open with a question word and the argument lines without a noun."""
    found = []
    for line, text in docstrings(source):
        if QUESTION.match(text):
            found.append(f"{line}: {text.splitlines()[0]}")
        arguments = [match[1] for each in text.splitlines() if (match := ARGUMENT.match(each))]
        found += [f"{line}: argument {each!r}" for each in arguments if NO_NOUN.match(each)]
    return found


@pytest.mark.parametrize("package", PACKAGES)
def test_docstrings_open_with_a_noun_or_a_verb(package: str) -> None:
    found = {
        str(path.relative_to(ROOT)): each
        for path in sorted((ROOT / package).rglob("*.py"))
        if (each := faults(path.read_text()))
    }
    assert not found, f"{sum(map(len, found.values()))} faults: {found}"


def test_prose_check_finds_what_it_refuses() -> None:
    source = '''
"""What a token is."""


def look(camera: int, place: int) -> None:
    """Look once.

    Args:
        camera: with which one looks.
        place: place of the camera.
    """
'''
    assert len(faults(source)) == 2
