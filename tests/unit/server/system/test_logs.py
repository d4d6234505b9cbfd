"""Logs: a stream that fails ends nothing, and a defect is told without its text."""

from __future__ import annotations

import errno
import io
import json
import logging
import os
import sys
from pathlib import Path

import pytest
import structlog

from veilcam_server.cli.serve import _say
from veilcam_server.system.logs import LogStream, Throttle, configure, log_defect


class Disk(io.StringIO):
    """A stream whose writes fail while ``fault`` is set."""

    fault: Exception | None = None

    def write(self, text: str) -> int:
        if self.fault is not None:
            raise self.fault
        return super().write(text)


@pytest.mark.parametrize(
    "fault",
    [
        OSError(errno.ENOSPC, "No space left on device"),
        BrokenPipeError(errno.EPIPE, "Broken pipe"),
        OSError(errno.EIO, "Input/output error"),
        ValueError("I/O operation on closed file"),
    ],
)
def test_line_that_cannot_be_written_is_counted_and_said_once(fault: Exception) -> None:
    disk = Disk()
    stream = LogStream(disk)
    stream.write("first\n")
    disk.fault = fault
    for _ in range(3):
        stream.write("lost\n")
    assert stream.lost == 3
    disk.fault = None
    stream.write("second\n")
    stream.write("third\n")
    first, second, told, third = disk.getvalue().splitlines()
    assert (first, second, third) == ("first", "second", "third")
    assert json.loads(told)["lost"] == 3
    assert stream.lost == 0


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
def test_logs_onto_a_full_disk_end_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    with io.TextIOWrapper(io.FileIO("/dev/full", "w"), write_through=True) as full:
        monkeypatch.setattr(sys, "stderr", full)
        monkeypatch.setattr(logging.root, "handlers", [])
        monkeypatch.setattr(logging, "raiseExceptions", True)
        configure("info")
        structlog.get_logger().info("nobody reads this")
        logging.getLogger("uvicorn").error("nor this")
        monkeypatch.setattr(sys, "stdout", full)
        _say("http://127.0.0.1:8787")


def test_pipe_that_nobody_reads_ends_nothing() -> None:
    reading, writing = os.pipe()
    os.close(reading)
    with os.fdopen(writing, "wb", buffering=0) as raw:
        stream = LogStream(io.TextIOWrapper(raw, write_through=True))
        stream.write("a\n")
        stream.write("b\n")
        assert stream.lost == 2


def test_defect_is_told_without_its_text(capsys: pytest.CaptureFixture[str]) -> None:
    try:
        raise RuntimeError("0 63 12 7")
    except RuntimeError as error:
        log_defect(error, during="rotation")
    told = capsys.readouterr().out
    assert "RuntimeError" in told
    assert "rotation" in told
    assert "test_defect_is_told_without_its_text" in told
    assert "63" not in told


def test_line_a_minute_stands_for_all_that_came() -> None:
    clock = [100.0]
    throttle = Throttle(60.0, now=lambda: clock[0])
    assert throttle.due() == 1
    for clock[0] in (101.0, 130.0, 159.9):
        assert throttle.due() is None
    clock[0] = 160.0
    assert throttle.due() == 4
    assert throttle.due() is None
    clock[0] = 1000.0
    assert throttle.due() == 2
