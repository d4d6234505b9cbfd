"""Budgets: what leaves behind a mask is counted before it leaves, over the mask's whole life."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.unit.server.damage import DAMAGES

from veilcam_server.camera.budget import NAME, ReleaseBudget
from veilcam_server.errors import ProblemError, StorageError
from veilcam_server.masks.source import Mask

MARKS = frozenset({"a1", "b2"})


def stored(mark: str = "a1") -> Mask:
    """A mask that comes again."""
    return Mask(np.ones((2, 3), np.uint8), object(), mark)  # type: ignore[arg-type]


def drawn() -> Mask:
    """A mask that never comes again."""
    return stored("")


def record(directory: Path) -> dict[str, int]:
    """Counts on the disk, where nothing but marks and numbers is stored beside the checksum."""
    told: dict[str, dict[str, int]] = json.loads((directory / NAME).read_text().splitlines()[1])
    assert set(told) == {"counts"}
    return told["counts"]


@pytest.mark.parametrize("mask", [stored, drawn])
def test_sealed_embeddings_leave_without_end_and_nothing_is_written(
    tmp_path: Path, mask: Callable[[], Mask]
) -> None:
    budget, one = ReleaseBudget(tmp_path, 0), mask()
    for _ in range(100):
        assert not budget.is_spent(one, "sealed")
        budget.spend(one, "sealed")
    assert budget.spent(MARKS, "sealed") == frozenset()
    assert not list(tmp_path.iterdir())


def test_budget_of_a_drawn_mask_is_its_own(tmp_path: Path) -> None:
    budget, mask, other = ReleaseBudget(tmp_path, 1), drawn(), drawn()
    assert not budget.is_spent(mask, "raw")
    budget.spend(mask, "raw")
    assert budget.is_spent(mask, "raw")
    assert not budget.is_spent(other, "raw")
    assert not list(tmp_path.iterdir())  # it never comes again


@pytest.mark.parametrize("mask", [stored, drawn])
@pytest.mark.parametrize("raw", [0, 1, 3])
def test_as_many_raw_embeddings_leave_as_the_operator_says(
    tmp_path: Path, mask: Callable[[], Mask], raw: int
) -> None:
    budget, one = ReleaseBudget(tmp_path, raw), mask()
    left = 0
    while not budget.is_spent(one, "raw"):
        budget.spend(one, "raw")
        left += 1
    assert left == raw
    assert ReleaseBudget(tmp_path, 5).is_spent(mask(), "none")


def test_masks_are_counted_each_for_itself(tmp_path: Path) -> None:
    budget = ReleaseBudget(tmp_path, 2)
    for mark in ("a1", "b2", "a1"):
        budget.spend(stored(mark), "raw")
    assert record(tmp_path) == {"a1": 2, "b2": 1}
    assert budget.spent(MARKS, "raw") == {"a1"}
    assert budget.is_spent(stored("a1"), "raw")
    assert not budget.is_spent(stored("b2"), "raw")
    assert budget.spent(frozenset({"c3"}), "raw") == frozenset()


def test_counts_outlive_the_daemon_and_another_number_is_held_against_them(tmp_path: Path) -> None:
    budget = ReleaseBudget(tmp_path, 5)
    for _ in range(2):
        budget.spend(stored(), "raw")
    assert ReleaseBudget(tmp_path, 3).spent(MARKS, "raw") == frozenset()
    assert ReleaseBudget(tmp_path, 2).spent(MARKS, "raw") == {"a1"}
    assert ReleaseBudget(tmp_path, 0).spent(MARKS, "raw") == MARKS


@pytest.mark.slow
def test_embedding_that_was_to_leave_when_the_daemon_was_killed_has_left(tmp_path: Path) -> None:
    """Killed between the count and the answer: nobody knows what left, so it did."""
    script = (
        "import os, pathlib, sys\n"
        "from veilcam_server.camera.budget import ReleaseBudget\n"
        "from veilcam_server.masks.source import Mask\n"
        "budget = ReleaseBudget(pathlib.Path(sys.argv[1]), 3)\n"
        "for _ in range(2): budget.spend(Mask(None, None, 'a1'), 'raw')\n"
        "os.kill(os.getpid(), 9)\n"
    )
    killed = subprocess.run([sys.executable, "-c", script, str(tmp_path)], check=False)
    assert killed.returncode == -9
    assert ReleaseBudget(tmp_path, 2).is_spent(stored(), "raw")
    assert not ReleaseBudget(tmp_path, 3).is_spent(stored(), "raw")


@pytest.mark.parametrize("half_way", [False, True])
def test_embedding_that_cannot_be_recorded_does_not_leave(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, half_way: bool
) -> None:
    budget = ReleaseBudget(tmp_path, 2)
    budget.spend(stored(), "raw")
    change = budget._file.change

    def full(update: object) -> None:
        if half_way:  # one copy has its new name, and then the disk fails
            change(update)  # type: ignore[arg-type]
        raise StorageError("written (No space left on device): check the disk")

    with monkeypatch.context() as patched:
        patched.setattr(budget._file, "change", full)
        with pytest.raises(StorageError, match=r"written \(No space left .*: check"):
            budget.spend(stored(), "raw")
    budget.spend(stored(), "raw")
    # Never less than what left; what may have been written counts.
    assert record(tmp_path) == {"a1": 3 if half_way else 2}
    assert budget.is_spent(stored(), "raw")


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_after_a_loss_every_stored_mask_is_spent_also_after_a_restart(
    tmp_path: Path, damage: Callable[[Path], None]
) -> None:
    ReleaseBudget(tmp_path, 1).spend(stored(), "raw")
    for name in (NAME, f"{NAME}.copy"):
        damage(tmp_path / name)
    for _ in range(2):
        faults: list[ProblemError] = []
        budget = ReleaseBudget(tmp_path, 5, faults.append)
        assert [fault.code for fault in faults] == ["state_lost"]
        assert budget.spent(MARKS, "raw") == MARKS
        assert budget.is_spent(stored("c3"), "raw")
        # What needs no record goes on.
        assert not budget.is_spent(stored(), "sealed")
        assert budget.spent(MARKS, "sealed") == frozenset()
        assert not budget.is_spent(drawn(), "raw")
    for path in tmp_path.glob(f"{NAME}*"):  # as the fault says, and with what was left
        path.rename(tmp_path / f"away-{path.name}")
    assert not ReleaseBudget(tmp_path, 5).is_spent(stored(), "raw")
