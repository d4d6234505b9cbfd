"""Logs in files: fetched, gone on with, and refused where they do not fit together."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.unit.client.logs import LIFE, Log, capture, event
from tests.unit.client.sealing import Device

from veilcam_client import fetch_log, verify_log
from veilcam_client.errors import FileError


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "captures.jsonl"


def test_log_is_fetched_and_gone_on_with(path: Path) -> None:
    log = Log(Device())
    assert fetch_log(log, path) == 10
    assert path.read_bytes() == b"".join(line + b"\n" for line in log.lines)
    assert fetch_log(log, path) == 0
    for number in range(5, 11):
        log.append(capture(number))
    assert fetch_log(log, path) == 6
    assert path.read_bytes() == b"".join(line + b"\n" for line in log.lines)
    assert not verify_log(path.read_bytes(), device=log.device.public).findings


def test_log_that_does_not_go_on_there_is_refused(path: Path) -> None:
    device = Device()
    fetch_log(Log(device), path)
    held = path.read_bytes()
    shorter = Log(device, LIFE[:4])
    another = Log(device, (*LIFE[:-1], event("gap", entries=1)))
    longer = Log(device, (*LIFE[:-1], event("gap", entries=1), capture(9)))
    dropped = Log(device, (*LIFE, capture(9), capture(10)))
    del dropped.records[:11]
    for log in (shorter, another, longer, dropped):
        with pytest.raises(FileError, match=r"does not go on where .*captures.jsonl ends"):
            fetch_log(log, path)
        assert path.read_bytes() == held


LOG = Log(Device())


@pytest.mark.parametrize("held", [b"x\n", b"{}", b"\n".join(LOG.lines)])
def test_file_that_does_not_end_with_a_record_is_left_alone(path: Path, held: bytes) -> None:
    path.write_bytes(held)
    with pytest.raises(FileError, match="does not end with a record"):
        fetch_log(LOG, path)
    assert path.read_bytes() == held
    path.write_bytes(b"")
    assert fetch_log(LOG, path) == 10


def test_file_that_cannot_be_used_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="nowhere/log cannot be read and written"):
        fetch_log(Log(Device()), tmp_path / "nowhere" / "log")
