"""Files of labelled measurements: what is written, resumed and refused."""

from __future__ import annotations

import json
import os
import stat
from contextlib import nullcontext
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from tests.unit.client.recordings import Daemon, answer
from tests.unit.client.sealing import BUNDLE, NOTES, VALUES, Device, Epoch

from veilcam_client import Shot, collect, held_before
from veilcam_client.collecting import labelled_pictures
from veilcam_client.errors import DeviceError, FileError, SealedError
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.measurements import Measured, MeasurementsHeader
from veilcam_client.wire.simulation import HeldScene

SHOTS = [Shot(label, name=f"{label}/{number}.png") for number in range(3) for label in "01"]


def raw(number: int) -> dict[str, Any]:
    told = answer(number)
    told["embedding"]["form"] = "raw"
    return told


def daemon(captures: int = 100, **status: Any) -> Daemon:
    made = Daemon(captures, raw, **{"release": "raw", **status})
    made.status["bundle"] = {**made.status["bundle"], "mode": "pairs", "pairs": 1}
    return made


def sealing(count: int, mode: str) -> tuple[ReceiverKey, list[Epoch], Daemon]:
    receiver, device = ReceiverKey.generate(), Device()
    epochs = [Epoch(device, receiver) for _ in range(count)]
    taken = [epoch.capture(0).model_dump(mode="json") for epoch in epochs]
    made = Daemon(answers=lambda number: taken[number], release="sealed")
    made.status["device"] = {**made.status["device"], "key": device.public}
    made.status["bundle"] = {**made.status["bundle"], "mode": mode, "digest": BUNDLE}
    return receiver, epochs, made


def lines(path: Path) -> tuple[MeasurementsHeader, list[Measured]]:
    first, *rest = path.read_bytes().splitlines()
    return MeasurementsHeader.model_validate_json(first), [
        Measured.model_validate_json(line) for line in rest
    ]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "measurements.jsonl"


def test_measurement_is_kept_with_its_label_and_epoch(path: Path) -> None:
    assert collect(daemon().camera(), path, SHOTS) == 6
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    first, second, *_ = map(json.loads, path.read_text().splitlines())
    assert first["format"] == "veilcam-measurements"
    fields = {"picture", "label", "epoch", "number", "taken_at", "values", "mask_key"}
    assert set(second) == fields
    header, found = lines(path)
    assert (header.bundle, header.labels, header.shape) == ("0f" * 32, ("0", "1"), (2, 3))
    for number, (shot, measured) in enumerate(zip(SHOTS, found, strict=True)):
        expected = raw(number)
        assert (measured.label, measured.picture) == (shot.label, shot.name)
        assert (measured.epoch, measured.number) == (expected["epoch"], expected["number"])
        assert measured.values.tolist() == expected["embedding"]["values"]
        assert measured.mask_key is None


@pytest.mark.parametrize("cut", [0, 1, 40])
def test_collection_that_broke_off_goes_on_and_measures_nothing_twice(path: Path, cut: int) -> None:
    with pytest.raises(DeviceError):
        collect(daemon(captures=2).camera(), path, SHOTS)
    with path.open("ab") as stream:
        stream.write(b"x" * cut)  # what a machine that lost its power leaves of a line
    seen: list[Shot] = []
    assert collect(daemon().camera(), path, SHOTS, advance=seen.append) == 4
    assert seen == SHOTS[2:]
    assert [each.picture for each in lines(path)[1]] == [shot.name for shot in SHOTS]
    assert collect(daemon().camera(), path, SHOTS) == 0


def test_file_that_broke_off_in_its_first_line_begins_anew(path: Path) -> None:
    path.write_bytes(b'{"format":"veil')
    assert collect(daemon().camera(), path, SHOTS[:1]) == 1
    assert len(lines(path)[1]) == 1


def test_label_of_a_person_is_taken_as_often_as_it_is_said(path: Path) -> None:
    for _ in range(2):
        assert collect(daemon().camera(), path, [Shot("1"), Shot("1")]) == 2
    assert [each.picture for each in lines(path)[1]] == [None] * 4


def test_measurement_is_on_the_disk_before_the_next_is_taken(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    held: list[int] = []
    monkeypatch.setattr(os, "fsync", lambda _: held.append(1))
    collect(daemon().camera(), path, SHOTS[:2], advance=lambda _: held.append(0))
    assert held == [1, 1, 0, 1, 0]


@pytest.mark.parametrize("mode", ["pairs", "fresh"])
def test_sealed_measurement_is_opened_and_a_fresh_masks_key_is_kept(path: Path, mode: str) -> None:
    receiver, epochs, made = sealing(2, mode)
    collect(made.camera(), path, SHOTS[:2], key=receiver)
    header, found = lines(path)
    assert header.mode == mode
    for epoch, measured in zip(epochs, found, strict=True):
        assert np.array_equal(measured.values.reshape(2, 3), VALUES)
        assert measured.mask_key == (epoch.key.levels().hex() if mode == "fresh" else None)
        # Nothing in the file opens what else was sealed in this epoch.
        content = path.read_text()
        assert epoch.key.sealing().hex() not in content
        assert bytes(epoch.key.reveal()).hex() not in content
        assert "values" not in repr(measured)
        assert epoch.key.levels().hex() not in repr(measured)


@pytest.mark.parametrize(
    ("release", "mode", "why"),
    [
        ("none", "pairs", "no embeddings leave this camera: pair a receiver"),
        ("sealed", "pairs", "leave sealed: pair a receiver"),
        ("raw", "fresh", "does not say which fresh mask"),
    ],
)
def test_form_that_no_classifier_can_be_adapted_with_is_refused_first(
    path: Path, release: str, mode: str, why: str
) -> None:
    made = daemon(release=release)
    made.status["bundle"] = {**made.status["bundle"], "mode": mode}
    with pytest.raises(FileError, match=why):
        collect(made.camera(), path, SHOTS)
    assert made.taken == 0
    assert not path.exists()


def test_replay_unknown_label_and_another_camera_are_refused(path: Path) -> None:
    with pytest.raises(FileError, match="replays a recording"):
        collect(daemon(state="replay").camera(), path, SHOTS)
    with pytest.raises(FileError, match="'cat' is no label of the camera's bundle: use one"):
        collect(daemon().camera(), path, [Shot("cat")])
    receiver, _, made = sealing(1, "pairs")
    with pytest.raises(SealedError, match="check the camera"):
        collect(made.camera(), path.with_name("other"), SHOTS, key=receiver, device="ab" * 32)


@pytest.mark.parametrize("other", ["device", "bundle"])
def test_file_of_another_camera_or_bundle_is_not_gone_on_with(path: Path, other: str) -> None:
    collect(daemon().camera(), path, SHOTS[:1])
    before = path.read_bytes()
    made = daemon()
    name = {"device": "key", "bundle": "digest"}[other]
    made.status[other] = {**made.status[other], name: "ab" * 32}
    with pytest.raises(FileError, match="another camera, or with another bundle"):
        collect(made.camera(), path, SHOTS)
    assert path.read_bytes() == before


def test_bundle_that_changes_on_the_way_is_noticed(path: Path) -> None:
    made = daemon()

    def change(_: Shot) -> None:
        made.status["bundle"] = {**made.status["bundle"], "digest": "ab" * 32}

    with pytest.raises(FileError, match="another bundle now"):
        collect(made.camera(), path, SHOTS, advance=change)
    assert len(lines(path)[1]) == 1
    receiver, _, sealed = sealing(1, "pairs")
    sealed.status["bundle"] = {**sealed.status["bundle"], "digest": "ab" * 32}
    with pytest.raises(FileError, match="another bundle now"):
        collect(sealed.camera(), path.with_name("other"), SHOTS, key=receiver)


def test_scene_that_another_caller_held_up_is_not_labelled(path: Path) -> None:
    receiver, _, made = sealing(2, "pairs")

    def shows(number: int) -> Any:
        return lambda _: nullcontext(number)

    assert NOTES.scene == 3
    assert collect(made.camera(), path, SHOTS[:1], key=receiver, show=shows(3)) == 1
    with pytest.raises(FileError, match="another caller held up another scene"):
        collect(made.camera(), path, SHOTS[1:], key=receiver, show=shows(4))


def test_file_of_something_else_is_left_alone(path: Path) -> None:
    collect(daemon().camera(), path, [])
    header = path.read_bytes()
    for content, why in (
        (b"no\n", "is no file of measurements"),
        (header + b'{"label": "0"}\n', "line 2: this is no measurement"),
    ):
        path.write_bytes(content)
        with pytest.raises(FileError, match=why):
            collect(daemon().camera(), path, SHOTS)
        assert path.read_bytes() == content


def test_two_collections_do_not_write_one_file(path: Path, tmp_path: Path) -> None:
    def second(_: Shot) -> None:
        with pytest.raises(FileError, match="another collection"):
            collect(daemon().camera(), path, SHOTS)

    assert collect(daemon().camera(), path, SHOTS[:1], advance=second) == 1
    with pytest.raises(FileError, match="cannot be written"):
        collect(daemon().camera(), tmp_path / "no" / "such", SHOTS)


def test_pictures_come_one_of_each_label_after_the_other(tmp_path: Path) -> None:
    for name in ("b/2.PNG", "b/1.png", "a/deep/1.jpg", "a/notes.txt", ".x/1.png", "b/3.jpeg"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(name.encode())
    found = labelled_pictures(tmp_path)
    assert [each.name for each in found] == ["a/deep/1.jpg", "b/1.png", "b/2.PNG", "b/3.jpeg"]
    assert [each.label for each in found] == ["a", "b", "b", "b"]
    assert labelled_pictures(tmp_path, per_class=1) == found[:2]
    with pytest.raises(FileError, match="holds no pictures"):
        labelled_pictures(tmp_path / "a" / "deep")
    with pytest.raises(FileError, match="cannot be read"):
        labelled_pictures(tmp_path / "none")


def test_picture_is_held_up_while_it_is_measured_alone(tmp_path: Path) -> None:
    class Holder:
        held: ClassVar[list[bytes | None]] = []

        def hold_scene(self, picture: bytes | None) -> HeldScene:
            self.held.append(picture)
            return HeldScene(scene=len(self.held))

    picture = tmp_path / "1.png"
    picture.write_bytes(b"picture")
    show = held_before(Holder())
    with show(Shot("a", picture)) as scene:
        assert (scene, Holder.held) == (1, [b"picture"])
    with pytest.raises(ZeroDivisionError), show(Shot("a", picture)):
        raise ZeroDivisionError
    assert Holder.held[-1] is None
    picture.unlink()
    with pytest.raises(FileError, match="cannot be read"), show(Shot("a", picture)):
        pass
    with pytest.raises(ValueError, match="use unaided"), show(Shot("a")):
        pass
