"""The log, whose writers are killed."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import count
from pathlib import Path

import pytest
from tests.app.server.killing import kill_writers
from tests.unit.server.logs import events, open_log


@pytest.mark.thorough
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_log_whose_writer_is_killed_has_every_answer_that_left(tmp_path: Path) -> None:
    def write(said: int) -> Iterator[int]:
        log = open_log(tmp_path, limit=20_000, kept=10_000)
        log.begin(lambda _: None)
        for number in count(said):
            log.append("capture", {"number": number, "answer": f"{number:064x}"})
            yield number + 1

    def found(said: int) -> int:
        numbers = [int(each["number"]) for each in events(tmp_path, "capture")]
        # What had left is there, and at most the answer that was cut off besides.
        assert set(range(said)) <= set(numbers) <= set(range(said + 1))
        starts = [each["after"] for each in events(tmp_path, "start")]
        assert set(starts[1:]) <= {"cut", "stop"}
        return max(numbers, default=-1) + 1

    assert kill_writers(write, found) > 30
