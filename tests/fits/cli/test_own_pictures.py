"""Own pictures from the command line: drawn, found in their folder, summed up, fitted and shown."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from tests.fits.conftest import Call

from veilcam_optics.camera.masks import to_weights
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_server.testing import FakeCamera
from veilcam_training.bundle import read_bundle
from veilcam_training.models.network import build_classifier

QUICK = ("--embedding", "6x8", "--epochs", 1, "--batch", 8, "--seed", 0, "--device", "cpu")


@pytest.mark.slow
def test_folder_is_drawn_summed_up_and_fitted(call: Call, tmp_path: Path) -> None:
    shapes, out = tmp_path / "shapes", tmp_path / "own"
    # A line breaks where the terminal ends, and a path is as long as it is.
    said = call("draw", shapes, "--count", 50, "--seed", 3).replace("\n", "")
    assert f"into {shapes}/train" in said
    printed = call("fit", "--data", shapes, *QUICK, "--out", out)
    assert "image-folder: 32 x 32, gray" in printed
    assert "Scene32" in printed
    assert "star" in printed[: printed.index("Scene32")]  # before the fit
    bundle = read_bundle(out / "model.veilcam")
    assert bundle.task == "image-folder"
    assert bundle.labels == ("circle", "cross", "square", "star", "triangle")
    assert bundle.scene.shape == (32, 32)
    settings = bundle.provenance["settings"]
    assert isinstance(settings, dict)
    assert settings["classifier"] == "Scene32"
    # What is named goes before what was found.
    assert "LR" in call(
        "fit", "--data", shapes, *QUICK, "--classifier", "LR", "--out", tmp_path / "b"
    )
    assert "is missing" in call("fit", "--data", shapes, *QUICK, "--dataset", "mnist", code=1)


@pytest.mark.slow
def test_fit_for_fresh_masks_takes_a_folder(call: Call, tmp_path: Path) -> None:
    shapes, out = tmp_path / "shapes", tmp_path / "own"
    call("draw", shapes, "--count", 200)
    (shapes / "dataset.toml").write_text("rows = 16\ncolumns = 16")
    config = tmp_path / "a.toml"
    config.write_text(
        'embedding = "6x8"\nclassifier = "Scene2"\nrank = 9\n[fresh]\nvalidation_masks = 4\n'
        "masks = 4\n[fresh.misalignment]\npanels = 2"
    )
    options = ("--config", config, "--epochs", 1, "--batch", 16, "--seed", 0)
    call("fit", "--fresh", "--data", shapes, *options, "--device", "cpu", "--out", out)
    bundle = read_bundle(out / "model.veilcam")
    assert (bundle.mode, bundle.task) == ("fresh", "image-folder")


def draw(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).mkdir(parents=True)
        for number in range(20):
            pixels = np.random.default_rng(number).integers(0, 256, (12, 16), dtype=np.uint8)
            Image.fromarray(pixels).save(folder / name / f"{number}.png")
    return folder


COLOURS = {"blue": (60, 60, 200), "green": (60, 200, 60), "red": (200, 60, 60)}


@pytest.fixture
def coloured(tmp_path: Path) -> Path:
    """A folder of 20 pictures of each colour, none of which is plain."""
    draws = np.random.default_rng(4)
    for name, colour in COLOURS.items():
        (tmp_path / "data" / name).mkdir(parents=True)
        for number in range(20):
            pixels = (np.array(colour) + draws.integers(-50, 51, (12, 16, 3))).astype(np.uint8)
            Image.fromarray(pixels).save(tmp_path / "data" / name / f"{number:02}.png")
    return tmp_path / "data"


@pytest.mark.slow
def test_folder_in_colour_is_fitted_and_served(call: Call, coloured: Path, tmp_path: Path) -> None:
    data, out = coloured, tmp_path / "own" / "model.veilcam"
    call("fit", "--data", data, *QUICK, "--classifier", "LR", "--out", out.parent)
    bundle = read_bundle(out)
    assert bundle.channels == 3
    pair = bundle.pairs[0]
    transfer = TransferOperator(bundle.camera, bundle.scene, bundle.embedding, colour=True)
    files = [path for name in COLOURS for path in sorted((data / name).iterdir())]
    pictures = torch.from_numpy(np.stack([np.asarray(Image.open(path)) for path in files]))
    weights = torch.from_numpy(to_weights(pair.levels, bundle.camera.panel))
    expected = transfer.embed(pictures.permute(0, 3, 1, 2) / 255, weights)
    scores = build_classifier(pair.layers, pair.weights)(expected.flatten(1))
    labels = [bundle.labels[place] for place in scores.argmax(1)]
    assert set(labels) == set(COLOURS)
    folders = tuple(str(data / name) for name in COLOURS)
    settings = {"bundle": out, "scenes": folders, "release": "raw", "raw_budget": 100}
    with FakeCamera(settings) as fake, fake.camera() as camera:
        assert camera.status().bundle.embedding_shape == (3, 6, 8)
        answers = [camera.classify(include_embedding=True) for _ in files]
        for name, colour in COLOURS.items():
            camera.simulation.hold_scene(np.full((12, 16, 3), colour, np.uint8))
            assert camera.classify().label == name
    told = [answer.label == label for answer, label in zip(answers, labels, strict=True)]
    assert sum(told) >= len(files) - 3
    seen = np.stack([np.asarray(answer) for answer in answers])
    assert np.linalg.norm(seen - expected.numpy()) < 0.02 * np.linalg.norm(expected)


@pytest.mark.slow
def test_fresh_masks_read_a_folder_in_colour(call: Call, coloured: Path, tmp_path: Path) -> None:
    config, out = tmp_path / "a.toml", tmp_path / "own" / "model.veilcam"
    config.write_text(
        'embedding = "6x8"\n[fresh]\nvalidation_masks = 4\nmasks = 8\n'
        "[fresh.misalignment]\npanels = 2"
    )
    options = ("--config", config, "--epochs", 16, "--batch", 8, "--seed", 0)
    call("fit", "--fresh", "--data", coloured, *options, "--device", "cpu", "--out", out.parent)
    folders = tuple(str(coloured / name) for name in COLOURS)
    with FakeCamera({"bundle": out, "scenes": folders}) as fake, fake.camera() as camera:
        assert camera.status().release == "none"
        told = [camera.classify().label for _ in range(60)]
    assert sum(label == list(COLOURS)[place // 20] for place, label in enumerate(told)) >= 57


def test_label_that_no_bundle_can_hold_costs_no_fit(call: Call, tmp_path: Path) -> None:
    data = draw(tmp_path / "data", "tea", "Unknown")
    for command, out in (("fit",), "a"), (("fit", "--fresh"), "a"), (("keyring",), "a.veilcam"):
        said = call(*command, "--data", data, "--out", tmp_path / out, code=1)
        assert "label 'Unknown' is the word" in said


@pytest.mark.thorough
def test_damaged_pictures_may_be_left_out(call: Call, tmp_path: Path) -> None:
    data, out = draw(tmp_path / "caf\udce9", "cat", "dog"), tmp_path / "a"
    (data / "cat" / "3.png").write_bytes(b"")
    (data / "dog" / "notes.txt").write_text("")
    assert "1 of 40 pictures cannot be read: cat/3.png" in call(
        "fit", "--data", data, *QUICK, "--out", out, code=1
    )
    printed = call("fit", "--data", data, *QUICK, "--out", out, "--skip-damaged")
    assert "warning: passed over: 1 .txt" in printed
    assert "1 damaged pictures are left out: cat/3.png" in printed
    # Its folder's name is no UTF-8, and stands in the command.
    assert r"caf\udce9" in str(read_bundle(out / "model.veilcam").provenance["command"])
