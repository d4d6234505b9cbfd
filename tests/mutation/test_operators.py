"""What is edited in a source, and what is left alone."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from .operators import find_mutants
from .subjects import SUBJECTS, Subject

ROOT = Path(__file__).resolve().parents[2]


def mutate(source: str, kind: str | None = None) -> list[str]:
    """All mutated sources, of one kind or of any."""
    return [
        mutant.apply(source)
        for mutant in find_mutants("a.py", source)
        if kind is None or mutant.kind == kind
    ]


@pytest.mark.parametrize(
    ("source", "mutated"),
    [
        ("a < b", ["a <= b"]),
        ("a <= b", ["a < b"]),
        ("a > b", ["a >= b"]),
        ("a >= b", ["a > b"]),
        ("a == b", ["a != b"]),
        ("a != b", ["a == b"]),
        ("a is b", ["a is not b"]),
        ("a is not b", ["a is b"]),
        ("a in b", ["a not in b"]),
        ("a not in b", ["a in b"]),
        ("a < b <= c", ["a <= b <= c", "a < b < c"]),
        ("(a) <  # <= b\n(b)", None),
    ],
)
def test_comparisons(source: str, mutated: list[str] | None) -> None:
    if mutated is None:
        source, mutated = f"x = [{source}]", ["x = [(a) <=  # <= b\n(b)]"]
    assert mutate(source, "comparison") == mutated


@pytest.mark.parametrize(
    ("source", "mutated"),
    [
        ("a + b", ["a - b"]),
        ("a - b", ["a + b"]),
        ("a * b", ["a / b"]),
        ("a / b", ["a * b"]),
        ("a // b", ["a * b"]),
        ("a % b", ["a * b"]),
        ("a ** b", ["a * b"]),
        ("a << b", ["a >> b"]),
        ("a | b & c", ["a & b & c", "a | b | c"]),
        ("a += b", ["a -= b"]),
        ("-a", ["a"]),
        ("a @ b", []),
        ("a + 'text'", []),
        ("'%s' % a", []),
        ("(a + b) * (c - d)", ["(a - b) * (c - d)", "(a + b) / (c - d)", "(a + b) * (c + d)"]),
    ],
)
def test_arithmetic(source: str, mutated: list[str]) -> None:
    assert mutate(source, "arithmetic") == mutated


@pytest.mark.parametrize(
    ("source", "mutated"),
    [
        ("3", "4"),
        ("0x7F", "128"),
        ("0", "1"),
        ("2.5", "5.0"),
        ("0.0", "1.0"),
        ("True", "False"),
        ("'safe'", "''"),
        ("''", "'mutated'"),
        ("b'\\x06'", "b''"),
    ],
)
def test_constants(source: str, mutated: str) -> None:
    assert mutate(f"x = {source}") == [f"x = {mutated}"]


@pytest.mark.parametrize(
    ("source", "mutated"),
    [
        ("a and b and c", ["a or b and c", "a and b or c"]),
        ("a or b", ["a and b"]),
        ("not (a)", [" (a)"]),
        ("if a.b:\n    c", ["if not (a.b):\n    c"]),
        ("while a():\n    b", ["while not (a()):\n    b"]),
        ("x = 1 if a else 2", ["x = 1 if not (a) else 2"]),
        ("[a for a in b if c]", ["[a for a in b if not (c)]"]),
        ("if a < b:\n    c", []),  # its comparison is exchanged
    ],
)
def test_conditions(source: str, mutated: list[str]) -> None:
    assert mutate(source, "condition") == mutated


def test_a_called_statement_is_left_out() -> None:
    assert mutate("f(\n    a,\n)\ng") == ["pass\ng"]
    assert mutate("async def f():\n    await g()") == ["async def f():\n    pass"]
    assert mutate("x = f(a)") == []


@pytest.mark.parametrize(
    "source",
    [
        '"""A module of 3 words."""',
        'class A:\n    """2."""\n    a: int\n    """[m]."""',
        "@dataclass(frozen=True, slots=True)\nclass A(Base, flag=True):\n    pass",
        "def f(a: Literal[3], *, b: int | None) -> Literal['x']:\n    pass",
        "A: TypeAlias = Literal['x', 'y']",
        "__all__ = ['a', 'b']",
        "if TYPE_CHECKING:\n    a = 3",
        "if __name__ == '__main__':\n    main(3)",
        "raise ValueError(f'{a + 1} is not valid: use {3}', a < b)",
        "return_ = StartError('text')",
        "log.warning('text', count=3)",
        "assert a < 3",
        "x = f'{a + 1}'",
        "x = 'a text for people'",
        "x = invalid('step', 'm')",
    ],
)
def test_what_no_test_should_look_at_stays(source: str) -> None:
    assert mutate(source) == []


def test_a_check_may_be_left_out_and_its_bound_moved_but_not_its_words() -> None:
    source = "require_count('reach.rows', reach.rows, least=0)"
    assert mutate(source) == ["pass", source.replace("0", "1")]


def test_defaults_are_constants() -> None:
    assert mutate("async def f(a=2, *, b=0.5):\n    pass") == [
        "async def f(a=3, *, b=0.5):\n    pass",
        "async def f(a=2, *, b=1.0):\n    pass",
    ]


def test_places_are_right_behind_letters_of_more_than_one_byte() -> None:
    assert mutate("x = 'µ' + ß * 2", "constant") == ["x = '' + ß * 2", "x = 'µ' + ß * 3"]


def test_a_mutant_tells_its_line() -> None:
    (mutant,) = find_mutants("a.py", "a = b\nif (\n    a\n    <   b\n):\n    c")
    assert (mutant.line, mutant.before, mutant.after) == (4, "< b", "<= b")
    (mutant,) = find_mutants("a.py", "a\nf(\n    b,\n)\n")
    assert (mutant.line, mutant.before, mutant.after) == (2, "f( b, )", "pass")


@pytest.mark.slow
@pytest.mark.parametrize("subject", SUBJECTS, ids=lambda subject: subject.name)
def test_every_mutant_of_every_subject_is_another_valid_module(subject: Subject) -> None:
    for file in subject.sources:
        source = (ROOT / file).read_text()
        original = ast.dump(ast.parse(source))
        mutants = find_mutants(file, source)
        assert mutants
        assert len(set(mutants)) == len(mutants)
        for mutant in mutants:
            assert ast.dump(ast.parse(mutant.apply(source))) != original, mutant
