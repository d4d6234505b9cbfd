"""The sample is even and repeats itself; what is called equivalent is there, with a reason."""

from __future__ import annotations

from pathlib import Path

import pytest

from .operators import find_mutants
from .sample import Equivalent, draw, mutants_of, read_equivalents
from .subjects import SUBJECTS, Subject, check_subjects

ROOT = Path(__file__).resolve().parents[2]
SMALL, LARGE, OTHER = (Subject(name, (f"{name}.py",), ()) for name in ("small", "large", "other"))
FOUND = {
    SMALL: find_mutants("small.py", "x = [1, 2]"),
    LARGE: find_mutants("large.py", f"x = {list(range(40))}"),
    OTHER: find_mutants("other.py", f"x = {list(range(40))}"),
}


def sizes(count: int) -> list[int]:
    return [len(mutants) for mutants in draw(FOUND, count, 1).values()]


def test_mutants_are_drawn_evenly_as_far_as_there_are_any() -> None:
    assert sizes(2) == [1, 1, 0]
    assert sizes(6) == [2, 2, 2]
    assert sizes(21) == [2, 10, 9]
    assert sizes(10**6) == [2, 40, 40]


def test_a_seed_draws_the_same_mutants_and_another_one_others() -> None:
    first = draw(FOUND, 20, 1)
    assert draw(FOUND, 20, 1) == first
    assert draw(FOUND, 20, 2) != first
    for subject, mutants in first.items():
        assert len(set(mutants)) == len(mutants)
        assert [mutant.file for mutant in mutants] == len(mutants) * list(subject.sources)
        assert [mutant.start for mutant in mutants] == sorted(mutant.start for mutant in mutants)


def test_subjects_are_drawn_by_themselves() -> None:
    alone = {LARGE: FOUND[LARGE], OTHER: FOUND[OTHER]}
    assert draw(alone, 18, 1)[LARGE] == draw({**FOUND, SMALL: []}, 18, 1)[LARGE]
    starts = [[mutant.start for mutant in mutants] for mutants in draw(alone, 18, 1).values()]
    assert starts[0] != starts[1]


def test_an_equivalent_is_told_by_file_and_line() -> None:
    (mutant,) = find_mutants("a.py", "x = 3")
    assert Equivalent("a.py", "x = 3", "x = 4", "why").matches(mutant)
    for other in (("b.py", "x = 3", "x = 4"), ("a.py", "y = 3", "x = 4"), ("a.py", "x = 3", "x")):
        assert not Equivalent(*other, "why").matches(mutant)
    with pytest.raises(ValueError, match="without a reason"):
        Equivalent("a.py", "x = 3", "x = 4", " ")


def test_the_list_is_read(tmp_path: Path) -> None:
    path = tmp_path / "equivalent.toml"
    path.write_text("# none\n")
    assert read_equivalents(path) == []
    path.write_text('[[equivalent]]\nfile = "a"\nbefore = "b"\nafter = "c"\nreason = "d"\n')
    assert read_equivalents(path) == [Equivalent("a", "b", "c", "d")]
    path.write_text('[[equivalent]]\nfile = "a"\nbefore = "b"\nafter = "c"\n')
    with pytest.raises(TypeError, match="reason"):
        read_equivalents(path)


def test_every_equivalent_is_a_mutant_of_today_s_source() -> None:
    mutants = [mutant for subject in SUBJECTS for mutant in mutants_of(subject, ROOT)]
    for equivalent in read_equivalents():
        assert any(map(equivalent.matches, mutants)), f"strike out {equivalent}"


def test_the_table_names_files_that_are_there(tmp_path: Path) -> None:
    check_subjects(ROOT)
    with pytest.raises(FileNotFoundError, match=r"small: there is no small\.py"):
        check_subjects(tmp_path, (SMALL,))
