"""Own pictures from the command line: drawn, found in their folder, summed up, fitted and shown."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tests.fits.conftest import Call

from veilcam_training.bundle import read_bundle

QUICK = ("--embedding", "6x8", "--epochs", 1, "--batch", 8, "--seed", 0, "--device", "cpu")


@pytest.mark.slow
def test_folder_is_drawn_summed_up_and_fitted(call: Call, tmp_path: Path) -> None:
    shapes, out = tmp_path / "shapes", tmp_path / "own.veilcam"
    # A line breaks where the terminal ends, and a path is as long as it is.
    said = call("draw", shapes, "--count", 50, "--seed", 3).replace("\n", "")
    assert f"into {shapes}/train" in said
    printed = call("fit", "--data", shapes, *QUICK, "--out", out)
    assert "image-folder: 32 x 32, gray" in printed
    assert "star" in printed[: printed.index("Scene32")]  # before the fit
    bundle = read_bundle(out)
    assert bundle.task == "image-folder"
    assert bundle.labels == ("circle", "cross", "square", "star", "triangle")
    assert bundle.scene.shape == (32, 32)
    settings = bundle.provenance["settings"]
    assert isinstance(settings, dict)
    assert settings["classifier"] == "Scene32"
    # What is named goes before what was found.
    assert "LR" in call("fit", "--data", shapes, *QUICK, "--classifier", "LR")
    assert "is missing" in call("fit", "--data", shapes, *QUICK, "--dataset", "mnist", code=1)


@pytest.mark.slow
def test_fit_for_fresh_masks_takes_a_folder(call: Call, tmp_path: Path) -> None:
    shapes, out = tmp_path / "shapes", tmp_path / "own.veilcam"
    call("draw", shapes, "--count", 200)
    (shapes / "dataset.toml").write_text("rows = 16\ncolumns = 16")
    config = tmp_path / "a.toml"
    config.write_text(
        'embedding = "6x8"\nclassifier = "Scene2"\nmasks = 4\nvalidation_masks = 4\n'
        "recipe = {rank = 9}\nmisalignment = {panels = 2}"
    )
    options = ("--config", config, "--epochs", 1, "--batch", 16, "--masks", 4, "--seed", 0)
    call("fit-fresh", "--data", shapes, *options, "--device", "cpu", "--out", out)
    bundle = read_bundle(out)
    assert (bundle.mode, bundle.task) == ("fresh", "image-folder")


def draw(folder: Path, *names: str, shape: tuple[int, ...] = (12, 16)) -> Path:
    for name in names:
        (folder / name).mkdir(parents=True)
        for number in range(20):
            pixels = np.random.default_rng(number).integers(0, 256, shape, dtype=np.uint8)
            Image.fromarray(pixels).save(folder / name / f"{number}.png")
    return folder


@pytest.mark.thorough
def test_pictures_in_colour_are_fitted_in_colour(call: Call, tmp_path: Path) -> None:
    data, out = draw(tmp_path / "data", "cat", "dog", shape=(12, 16, 3)), tmp_path / "a.veilcam"
    options = ("--classifier", "Scene2", "--allow-visible", "--out", out)
    for command in (("fit", "--end-to-end"), ("keyring", "--pairs", 2)):
        call(*command, "--data", data, *QUICK, *options)
        bundle = read_bundle(out)
        assert bundle.channels == 3
        settings = bundle.provenance["settings"]
        assert isinstance(settings, dict)
        recipe = settings["recipe"]
        assert isinstance(recipe, dict)
        assert (recipe["hidden"], recipe["end_to_end"]) == (False, "--end-to-end" in command)
        assert recipe["jitter"]["mirror"] is True  # type: ignore[index, call-overload]


@pytest.mark.thorough
def test_fit_that_keeps_nothing_says_so_before_it_starts(call: Call, tmp_path: Path) -> None:
    data, said = draw(tmp_path / "data", "cat", "dog"), "nothing of this fit will be kept"
    printed = call("fit", "--data", data, *QUICK)
    assert said in printed[: printed.index("image-folder")]
    assert said not in call("fit", "--data", data, *QUICK, "--work", tmp_path / "work")


def test_label_that_no_bundle_can_hold_costs_no_fit(call: Call, tmp_path: Path) -> None:
    data = draw(tmp_path / "data", "tea", "Unknown")
    for command in ("fit", "fit-fresh", "keyring"):
        said = call(command, "--data", data, "--out", tmp_path / "a.veilcam", code=1)
        assert "label 'Unknown' is the word" in said


@pytest.mark.thorough
def test_damaged_pictures_may_be_left_out(call: Call, tmp_path: Path) -> None:
    data, out = draw(tmp_path / "caf\udce9", "cat", "dog"), tmp_path / "a.veilcam"
    (data / "cat" / "3.png").write_bytes(b"")
    (data / "dog" / "notes.txt").write_text("")
    assert "1 of 40 pictures cannot be read: cat/3.png" in call(
        "fit", "--data", data, *QUICK, "--out", out, code=1
    )
    printed = call("fit", "--data", data, *QUICK, "--out", out, "--skip-damaged")
    assert "warning: passed over: 1 .txt" in printed
    assert "1 damaged pictures are left out: cat/3.png" in printed
    # Its folder's name is no UTF-8, and stands in the command.
    assert r"caf\udce9" in str(read_bundle(out).provenance["command"])
