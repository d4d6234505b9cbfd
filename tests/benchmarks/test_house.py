"""The cost of a command: time of its children counts, and one that fails is no measurement."""

from __future__ import annotations

import subprocess
import sys

import pytest
from benchmarks import house

WORK = """
from resource import RUSAGE_SELF, getrusage
while getrusage(RUSAGE_SELF).ru_utime < 0.2: pass
"""


def test_cost_counts_children_of_a_command() -> None:
    in_a_child = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {WORK!r}])"
    _, used = house.cost([sys.executable, "-c", in_a_child])
    assert used >= 0.2


def test_cost_of_a_command_that_fails_is_refused() -> None:
    with pytest.raises(subprocess.CalledProcessError):
        house.cost([sys.executable, "-c", "raise SystemExit(1)"])
