"""Logs in files: fetched, gone on with, and refused where they do not fit together."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tests.unit.client.logs import LIFE, Log, answer, capture
from tests.unit.client.sealing import NOTES, Device

from veilcam_client import fetch_log, verify_log
from veilcam_client.errors import FileError
from veilcam_client.keys.capture_log import is_genuine
from veilcam_client.wire.log import LogGap


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "captures.jsonl"


def test_log_is_fetched_and_gone_on_with(path: Path) -> None:
    log = Log(Device())
    added, head = fetch_log(log, path)
    assert added == 10
    assert head.position == 9
    assert is_genuine(head)
    assert path.read_bytes() == b"".join(line + b"\n" for line in log.lines)
    assert fetch_log(log, path)[0] == 0
    for number in range(5, 11):
        log.append(capture(number))
    assert fetch_log(log, path)[0] == 6
    assert path.read_bytes() == b"".join(line + b"\n" for line in log.lines)
    assert not verify_log(path, device=log.device.public).findings


def test_log_that_does_not_go_on_there_is_refused(path: Path) -> None:
    device = Device()
    fetch_log(Log(device), path)
    held = path.read_bytes()
    shorter = Log(device, LIFE[:4])
    another = Log(device, (*LIFE[:-1], LogGap(answers=1)))
    longer = Log(device, (*LIFE[:-1], LogGap(answers=1), capture(9)))
    dropped = Log(device, (*LIFE, capture(9), capture(10)))
    del dropped.records[:11]
    for log in (shorter, another, longer, dropped):
        with pytest.raises(FileError, match=r"does not go on where .*captures.jsonl ends"):
            fetch_log(log, path)
        assert path.read_bytes() == held


def test_log_that_grows_meanwhile_is_no_departure(path: Path) -> None:
    log = Log(Device())
    fetch_log(log, path)

    class Growing(Log):
        def head(self, *, missed: int = 0) -> Any:
            self.append(capture(9))
            return super().head()

    log.__class__ = Growing
    assert fetch_log(log, path)[0] == 0


LOG = Log(Device())


@pytest.mark.parametrize("held", [b"x\n", b"{}", b"\n".join(LOG.lines)])
def test_file_that_does_not_end_with_a_record_is_left_alone(path: Path, held: bytes) -> None:
    path.write_bytes(held)
    with pytest.raises(FileError, match="does not end with a record"):
        fetch_log(LOG, path)
    assert path.read_bytes() == held
    path.write_bytes(b"")
    assert fetch_log(LOG, path)[0] == 10


def test_files_that_cannot_be_used_are_named(path: Path, tmp_path: Path) -> None:
    with pytest.raises(FileError, match="nowhere/log cannot be written"):
        fetch_log(Log(Device()), tmp_path / "nowhere" / "log")
    with pytest.raises(FileError, match=r"captures.jsonl cannot be read"):
        verify_log(path)
    log = Log(Device())
    fetch_log(log, path)
    other = tmp_path / "other.json"
    for why in ("cannot be read", "holds something else"):
        with pytest.raises(FileError, match=rf"other\.json {why}"):
            verify_log(path, head=other)
        with pytest.raises(FileError, match=rf"other\.json {why}"):
            verify_log(path, answer=other)
        other.write_text("{}")
    for kept, why in (
        (answer(1).model_copy(update={"notes": NOTES}), "was opened"),
        (answer(1).model_copy(update={"id": "c0ffee"}), "hides nothing"),
    ):
        other.write_text(kept.model_dump_json())
        with pytest.raises(FileError, match=rf"other\.json: .*{why}"):
            verify_log(path, answer=other)


def test_head_and_answer_are_read_from_files(path: Path, tmp_path: Path) -> None:
    log = Log(Device())
    fetch_log(log, path)
    head, kept = tmp_path / "head.json", tmp_path / "answer.json"
    head.write_text(log.head().model_dump_json())
    kept.write_text(answer(2).model_dump_json())
    found = verify_log(path, head=head, answer=kept)
    assert (found.findings, found.answer) == ([], 3)
    log.append(LogGap(answers=1))
    head.write_text(log.head().model_dump_json())
    assert len(verify_log(path, head=head).findings) == 1
