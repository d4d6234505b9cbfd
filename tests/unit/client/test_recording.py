"""Recordings: what is written, and what is refused when it is read."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.unit.client.recordings import VERDICT, Daemon, answer
from tests.unit.client.sealing import NOTES, VALUES, Device, Epoch
from typer.testing import CliRunner

from veilcam_client import read_recording, record
from veilcam_client.cli.main import app
from veilcam_client.errors import DeviceError, FileError
from veilcam_client.keys.blocks import Opener
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.recording import MAX_BYTES
from veilcam_client.wire.captures import Prediction

Line = dict[str, Any]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "recording.jsonl"


@pytest.mark.parametrize("labels", [False, True])
def test_recording_holds_what_was_answered(path: Path, *, labels: bool) -> None:
    counted: list[int] = []
    size = record(
        Daemon().camera(), path, count=3, labels=labels, advance=lambda: counted.append(1)
    )
    assert size == path.stat().st_size
    assert len(counted) == 3
    assert path.stat().st_mode & 0o777 == 0o600
    recording = read_recording(path)
    assert recording.header.status.device.sensor == "IMX477"
    for number, recorded in enumerate(recording.captures):
        expected = answer(number)
        told = json.loads(recorded.capture.model_dump_json())
        for name in ("id", "epoch", "number", "embedding"):
            assert told[name] == expected[name]
        values = np.asarray(expected["embedding"]["values"], np.float32).reshape(2, 3)
        assert np.array_equal(np.asarray(recorded.capture), values)
        verdict = recorded.verdict
        assert (None if verdict is None else verdict.model_dump()) == (VERDICT if labels else None)


@pytest.mark.parametrize("labels", [False, True])
def test_sealed_capture_stays_sealed_unless_a_key_opens_it(tmp_path: Path, *, labels: bool) -> None:
    receiver, device = ReceiverKey.generate(), Device()
    epochs = [Epoch(device, receiver) for _ in range(2)]
    taken = [epoch.capture(0).model_dump(mode="json") for epoch in epochs]

    def daemon() -> Daemon:
        return Daemon(answers=lambda number: taken[number], release="sealed")

    sealed, opened = tmp_path / "sealed", tmp_path / "opened"
    record(daemon().camera(), sealed, count=2, labels=labels)
    record(daemon().camera(key=receiver, device=device.public), opened, count=2, labels=labels)
    closed, clear = read_recording(sealed), read_recording(opened)
    assert (closed.header.status.release, clear.header.status.release) == ("sealed", "raw")
    opener = Opener(receiver, device.public)
    for one, other, came in zip(closed.captures, clear.captures, taken, strict=True):
        assert json.loads(one.capture.embedding.model_dump_json()) == came["embedding"]
        assert opener.open(one.capture) == other.capture
        assert np.array_equal(np.asarray(other.capture), VALUES)
        assert other.capture.notes == NOTES
    sealed.write_bytes(sealed.read_bytes() + opened.read_bytes().split(b"\n")[1] + b"\n")
    with pytest.raises(FileError, match="line 4: this is raw, and the others are sealed"):
        read_recording(sealed)


def test_label_is_kept_without_the_scores_that_did_not_come(path: Path) -> None:
    daemon = Daemon()
    daemon.verdict = {"label": "1"}
    record(daemon.camera(), path, count=1, labels=True)
    (recorded,) = read_recording(path).captures
    assert recorded.verdict == Prediction(label="1")


def test_failed_recording_is_whole_up_to_the_failure(path: Path) -> None:
    with pytest.raises(DeviceError):
        record(Daemon(captures=2).camera(), path, count=3)
    assert len(read_recording(path).captures) == 2


def test_recording_overwrites_nothing_and_records_no_replay(path: Path, tmp_path: Path) -> None:
    path.write_text("mine")
    with pytest.raises(FileError, match="exists: give another name"):
        record(Daemon().camera(), path, count=1)
    assert path.read_text() == "mine"
    with pytest.raises(FileError, match=r"cannot be written \(No such file"):
        record(Daemon().camera(), tmp_path / "no" / "such", count=1)
    with pytest.raises(FileError, match="replays a recording: copy its file"):
        record(Daemon(state="replay").camera(), tmp_path / "other", count=1)
    assert not (tmp_path / "other").exists()


def no_captures(lines: list[Line]) -> None:
    del lines[1:]


SMALL = {"form": "raw", "shape": [1, 1], "values": [1.0]}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"epoch": 7}, "line 3: this is no capture"),
        ({"replay": {"capture": "1", "place": 0}}, "line 3: this was itself replayed"),
        ({"embedding": SMALL}, "line 3: this is of another camera"),
        ({"embedding": {**SMALL, "form": "white"}}, "line 3: this is no capture"),
        (
            lambda lines: lines[2].update(verdict={**VERDICT, "label": "cat"}),
            "line 3: this label is not one of the camera's",
        ),
        (lambda lines: lines[0].update(version=2), "is no recording of this version"),
        (no_captures, "holds no captures"),
    ],
)
def test_damaged_recording_is_refused(
    path: Path, change: Line | Callable[[list[Line]], None], message: str
) -> None:
    record(Daemon().camera(), path, count=3)
    lines = [json.loads(line) for line in path.read_text().splitlines()]
    if callable(change):
        change(lines)
    else:
        lines[2]["capture"].update(change)
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    with pytest.raises(FileError, match=message):
        read_recording(path)


def test_file_that_is_cut_off_missing_or_too_large(path: Path, tmp_path: Path) -> None:
    record(Daemon().camera(), path, count=3)
    path.write_bytes(path.read_bytes()[:-10])
    with pytest.raises(FileError, match="is cut off: remove its last line"):
        read_recording(path)
    with pytest.raises(FileError, match=r"missing cannot be read \(No such file"):
        read_recording(tmp_path / "missing")
    with path.open("wb") as stream:
        stream.truncate(MAX_BYTES + 1)  # a hole, which takes no disk
    with pytest.raises(FileError, match="is larger than 256 MiB"):
        read_recording(path)


def test_record_command_writes_a_recording(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    daemon = Daemon(captures=2)
    monkeypatch.setattr("veilcam_client.cli.terminal.Camera", lambda *_, **__: daemon.camera())
    options = ["record", "--count", "2", "--labels", "--out", str(path)]
    result = CliRunner().invoke(app, options)
    assert result.exit_code == 0, result.output
    assert result.output == f"wrote 2 captures to {path}, 0.0 MB\n"
    assert all(each.verdict for each in read_recording(path).captures)
    result = CliRunner().invoke(app, options)
    assert result.exit_code == 2
    assert "exists: give another name" in result.output
    result = CliRunner().invoke(app, [*options[:-1], str(path.with_name("other"))])
    assert result.exit_code == 6
