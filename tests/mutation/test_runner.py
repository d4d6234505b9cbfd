"""Mutants put to the test in a small repository, and what is said of them."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from .operators import Mutant, find_mutants
from .report import Report
from .results import Outcome, Result, append_result, read_results
from .runner import Copy, Runner, digest, list_files
from .sample import Equivalent
from .subjects import Subject

SOURCE = "def larger(a, b):\n    return a > b\n\n\ndef half(a):\n    return a / 2\n"
TESTS = "from thing import larger\n\n\ndef test_larger():\n    assert not larger(1, 1)\n"
THING = Subject("thing", ("client/thing.py",), ("tests/test_thing.py",))


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """A module, one of whose functions is tested."""
    root = tmp_path / "repository"
    for name, text in (
        ("client/thing.py", SOURCE),
        ("tests/test_thing.py", TESTS),
        (".gitignore", "*.log\n"),
        ("a.log", "not part of it"),
    ):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)
    subprocess.run(["git", "init", "-q", root], check=True)
    return root


@pytest.fixture
def copy(repository: Path, tmp_path: Path) -> Copy:
    return Copy.make(repository, list_files(repository), tmp_path / "copy")


def mutant(source: str, after: str) -> Mutant:
    (found,) = (each for each in find_mutants(THING.sources[0], source) if each.after == after)
    return found


def test_a_copy_holds_what_git_does_not_ignore(repository: Path, copy: Copy) -> None:
    files = [".gitignore", "client/thing.py", "tests/test_thing.py"]
    assert list_files(repository) == files
    (repository / "client" / "thing.py").unlink()
    assert list_files(repository) == [files[0], files[2]]
    assert (copy.root / "client" / "thing.py").read_text() == SOURCE


def test_another_byte_is_another_repository(repository: Path) -> None:
    files = list_files(repository)
    before = digest(repository, files)
    assert digest(repository, files) == before
    (repository / "tests" / "test_thing.py").write_text(TESTS + "\n")
    assert digest(repository, files) != before


@pytest.mark.slow
def test_mutants_are_killed_or_survive_and_leave_nothing_behind(
    repository: Path, copy: Copy
) -> None:
    killed = mutant(SOURCE, "return a >= b")
    survivor = mutant(SOURCE, "return a * 2")
    results = list(Runner([copy], "tree").run({THING: [killed, survivor]}))
    assert {result.mutant: result.outcome for result in results} == {
        killed: "killed",
        survivor: "survived",
    }
    assert {(result.tree, result.subject) for result in results} == {("tree", "thing")}
    assert (copy.root / THING.sources[0]).read_text() == SOURCE
    assert (repository / THING.sources[0]).read_text() == SOURCE


@pytest.mark.slow
def test_a_mutant_without_an_end_is_stopped(copy: Copy) -> None:
    source = "def larger(a, b):\n    while a > b:\n        pass\n"
    (copy.root / THING.sources[0]).write_text(source)
    endless = mutant(source, "while a >= b:")
    # It never ends, and the original does at once: any limit tells.
    assert copy.run(THING.tests) == 0
    assert copy.try_mutant(endless, THING.tests, limit=3.0) == "timeout"


@pytest.mark.slow
def test_tests_that_fail_without_a_mutant_are_an_error(copy: Copy) -> None:
    (copy.root / THING.tests[0]).write_text("def test():\n    assert False\n")
    with pytest.raises(RuntimeError, match=r"tests/test_thing\.py fail on the original"):
        list(Runner([copy], "").run({THING: [mutant(SOURCE, "return a >= b")]}))


def test_results_are_taken_up_again_where_nothing_has_changed(tmp_path: Path) -> None:
    path = tmp_path / "out" / "results.jsonl"
    assert read_results(path, "now") == []
    first, second = (
        Result(tree, "thing", mutant(SOURCE, "return a >= b"), "killed") for tree in ("now", "then")
    )
    append_result(path, first)
    append_result(path, second)
    with path.open("a") as stream:
        stream.write(json.dumps({"tree": "now"})[:-3])  # cut short by a kill
    assert read_results(path, "now") == [first]


def test_the_report_counts_what_could_be_killed_and_shows_the_rest() -> None:
    outcomes: dict[str, Outcome] = {
        "return a >= b": "killed",
        "return a * 2": "survived",
        "return a / 3": "survived",
    }
    results = [Result("", "thing", mutant(SOURCE, after), how) for after, how in outcomes.items()]
    results.append(Result("", "other", mutant(SOURCE, "return a >= b"), "timeout"))
    same = Equivalent(THING.sources[0], "return a / 2", "return a / 3", "Nobody asks for a half.")
    mistaken = Equivalent(THING.sources[0], "return a > b", "return a >= b", "A test kills it.")
    report = Report(results, [same, mistaken], seed=7)
    assert report.share == 2 / 3
    text = report.render()
    assert "2 of 3 (67%, bar 85%, seed 7)" in text
    assert "| thing | 1 | 2 | 0 | 1 |" in text
    assert "| other | 1 | 1 | 1 | 0 |" in text
    survivors, _, equivalent = text.partition("## Equivalent")
    assert (
        "client/thing.py:6 arithmetic (survived)\n```diff\n- return a / 2\n+ return a * 2" in text
    )
    assert "return a / 3" not in survivors
    assert "Nobody asks for a half." in equivalent
    assert "Equivalent" not in Report(results, [], seed=7).render()
