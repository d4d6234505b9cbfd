"""What a simulated camera is told to look at, from files to data sets."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from veilcam_server.devices import SensorError
from veilcam_server.devices.simulated.scene_files import open_scenes
from veilcam_server.devices.simulated.scenes import write_scene
from veilcam_server.errors import StartError
from veilcam_server.settings import Settings
from veilcam_training.data.idx import idx_bytes

SHAPE = (28, 28)


def settings(tmp_path: Path, *scenes: Path | str, **more: Any) -> Settings:
    given = {"device": "simulated", "state_dir": tmp_path / "state", **more}
    return Settings.model_validate({**given, "scenes": tuple(map(str, scenes))})


def levels(tmp_path: Path, *scenes: Path | str) -> list[int]:
    deck = open_scenes(settings(tmp_path, *scenes), SHAPE)
    return [round(255 * float(scene.read()[0, 0])) for scene in deck]


def write(path: Path, level: int) -> Path:
    path.parent.mkdir(exist_ok=True)
    write_scene(path, np.full(SHAPE, level, np.uint8))
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "folder"
    for name, level in (("b.npy", 2), ("a.npy", 1), ("c.NPY", 3), (".hidden.npy", 9)):
        write(folder / name, level)
    (folder / "README.txt").write_text("no image")
    (folder / "deeper.npy").mkdir()
    return folder


@pytest.fixture
def mnist(tmp_path: Path) -> Path:
    """Twenty training images of levels 0 to 19, and five to test with, of 100 to 104."""
    folder = tmp_path / "mnist"
    folder.mkdir()
    for part, first, count in (("train", 0, 20), ("t10k", 100, 5)):
        images = torch.arange(first, first + count).to(torch.uint8)[:, None, None]
        for name, content in (("images-idx3", images.expand(-1, 28, 28)), ("labels-idx1", None)):
            labels = torch.full((count,), 7, dtype=torch.uint8)
            (folder / f"{part}-{name}-ubyte").write_bytes(
                idx_bytes(labels if content is None else content)
            )
    return folder


def test_files_and_folders_in_their_order(tmp_path: Path, folder: Path) -> None:
    one = write(tmp_path / "one:two.npy", 8)
    assert levels(tmp_path, one, folder) == [8, 1, 2, 3]


def test_data_set_is_its_validation_part_unless_it_is_said(tmp_path: Path, mnist: Path) -> None:
    validation = levels(tmp_path, f"mnist:{mnist}")
    assert len(validation) == 2
    assert max(validation) < 20
    assert levels(tmp_path, f"mnist:{mnist}:validation") == validation
    assert levels(tmp_path, f"mnist:{mnist}:test") == [100, 101, 102, 103, 104]


def test_colour_of_a_data_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from veilcam_training import data

    class Red:
        def test(self) -> data.Images:
            pixels = torch.zeros(1, 3, 8, 4, dtype=torch.uint8)
            pixels[:, 0] = 255
            return data.Images(pixels, torch.zeros(1, dtype=torch.int64))

    monkeypatch.setattr(data, "open_source", lambda *_: Red())
    (scene,) = open_scenes(settings(tmp_path, f"cifar10:{tmp_path}:test"), SHAPE)
    assert scene.read() == pytest.approx(0.299)


def test_scene_that_cannot_be_opened_is_named(tmp_path: Path, folder: Path, mnist: Path) -> None:
    (tmp_path / "empty").mkdir()
    (folder / "bad.png").write_text("no image")
    for name, reason in (
        (tmp_path / "empty", r"empty: no image in this folder \(it is empty\): use \.npy, PNG"),
        (f"mnist:{mnist}:training", "no part 'training': use validation or test"),
        ("digits:/somewhere", "data set 'digits' is unknown: use one of mnist"),
        ("mnist:/not/there", "/not/there is not a folder"),
    ):
        with pytest.raises(StartError, match=reason):
            open_scenes(settings(tmp_path, name), SHAPE)
    with pytest.raises(SensorError, match=r"scene file .*/folder/bad\.png is no image"):
        open_scenes(settings(tmp_path, folder), SHAPE)
    with pytest.raises(SensorError, match=r"there is no scene file /not/there\.png"):
        open_scenes(settings(tmp_path, "/not/there.png"), SHAPE)


def test_environment_names_one_or_several(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("VEILCAM_DEVICE", "simulated")
    for value, expected in (
        ("mnist:data/mnist", ("mnist:data/mnist",)),
        (json.dumps(["a.png", "b"]), ("a.png", "b")),
    ):
        monkeypatch.setenv("VEILCAM_SCENES", value)
        assert Settings().scenes == expected  # type: ignore[call-arg]
    assert Settings().redacted()["scenes"] == "given"  # type: ignore[call-arg]
    monkeypatch.delenv("VEILCAM_SCENES")
    assert Settings().redacted()["scenes"] is None  # type: ignore[call-arg]
