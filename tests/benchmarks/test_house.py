"""The cost of a command: time of its children counts, and one that fails is no measurement."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from benchmarks import house

WORK = """
from resource import RUSAGE_SELF, getrusage
while getrusage(RUSAGE_SELF).ru_utime < 0.2: pass
"""


def test_cost_counts_children_of_a_command() -> None:
    in_a_child = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {WORK!r}])"
    _, used, _ = house.cost([sys.executable, "-c", in_a_child])
    assert used >= 0.2


def test_cost_of_a_command_that_fails_is_refused() -> None:
    with pytest.raises(subprocess.CalledProcessError):
        house.cost([sys.executable, "-c", "raise SystemExit(1)"])


def test_mutant_that_lives_anew_is_named(tmp_path: Path) -> None:
    fates = {"kept": "killed", "lost": "survived", "moved": "gone", "untried": "no tests"}
    mutants = [{"file": "a.py", "line": 1, "before": before} for before in [*fates, "old"]]
    files = tmp_path / "before.json", tmp_path / "after.json"
    for path, outcomes in zip(files, (["killed"] * 4, fates.values()), strict=True):
        pairs = zip(mutants, [*outcomes, "survived"], strict=True)
        path.write_text(json.dumps([mutant | {"outcome": each} for mutant, each in pairs]))
    assert house.living_anew(*files) == ["a.py:1 lost: survived", "a.py:1 untried: no tests"]
