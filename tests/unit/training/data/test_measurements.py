"""Files of labelled measurements: what the SDK writes is what training reads."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import torch
from tests.unit.client.recordings import Daemon, answer
from tests.unit.client.sealing import BUNDLE, VALUES, Device, Epoch

from veilcam_client import Shot, collect
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_training.data.measurements import Measurements, read_measurements
from veilcam_training.errors import TrainingError


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "measurements.jsonl"


def written(path: Path, labels: str = "0110") -> Measurements:
    def raw(number: int) -> dict[str, Any]:
        told = answer(number)
        told["embedding"]["form"] = "raw"
        return told

    daemon = Daemon(answers=raw, release="raw")
    daemon.status["bundle"] = {**daemon.status["bundle"], "mode": "pairs"}
    collect(daemon.camera(), path, [Shot(label) for label in labels])
    return read_measurements(path)


def test_files_of_the_sdk_are_read(path: Path) -> None:
    found = written(path)
    assert found.labels.tolist() == [0, 1, 1, 0]
    assert found.header.labels == ("0", "1")
    assert (found.header.bundle, found.header.mode) == ("0f" * 32, "pairs")
    for number in range(4):
        expected = answer(number)
        assert found.values[number].tolist() == expected["embedding"]["values"]
        assert found.epochs[number] == expected["epoch"]
    assert found.values.dtype == torch.float32
    assert not found.mask_keys
    assert "values" not in repr(found)


def test_fresh_masks_key_is_read(path: Path) -> None:
    receiver, device = ReceiverKey.generate(), Device()
    epoch = Epoch(device, receiver)
    daemon = Daemon(
        answers=lambda number: epoch.capture(number).model_dump(mode="json"), release="sealed"
    )
    daemon.status["device"] = {**daemon.status["device"], "key": device.public}
    daemon.status["bundle"] = {**daemon.status["bundle"], "digest": BUNDLE}
    collect(daemon.camera(), path, [Shot("1")] * 3, key=receiver)
    found = read_measurements(path)
    assert found.mask_keys == {epoch.name: bytes(epoch.key.levels())}
    assert torch.equal(found.values, torch.from_numpy(VALUES.ravel()).expand(3, -1))
    assert epoch.key.levels().hex() not in repr(found)


@pytest.mark.parametrize(
    "change",
    [
        *({"label": "2"}, {"mask_key": "ab" * 32}, {"epoch": None}),
        *({"values": values} for values in ([0.0], "1234", [float("inf")] * 6)),
    ],
    ids=str,
)
def test_line_that_is_no_measurement_is_named(path: Path, change: dict[str, Any]) -> None:
    written(path)
    lines = path.read_text().splitlines()
    lines[2] = json.dumps({**json.loads(lines[2]), **change})
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(TrainingError, match=r"line 3: this is no measurement: remove it$"):
        read_measurements(path)


def test_file_without_measurements_is_refused(path: Path, tmp_path: Path) -> None:
    whole = written(path)
    path.write_bytes(path.read_bytes()[:-5])
    assert len(read_measurements(path)) == len(whole) - 1
    path.write_bytes(path.read_bytes().splitlines(keepends=True)[0])
    with pytest.raises(TrainingError, match="holds no measurements"):
        read_measurements(path)
    for content in (b"", b"{}\n", b'{"format": "veilcam-recording", "version": 1}\n'):
        path.write_bytes(content)
        with pytest.raises(TrainingError, match="is no file of measurements"):
            read_measurements(path)
    with pytest.raises(TrainingError, match="cannot be read"):
        read_measurements(tmp_path / "none")
