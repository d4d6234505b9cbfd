"""``veilcam-train predict`` beside a daemon that sees the same files."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image
from tests.unit.server.conftest import EMBEDDING, LABELS, make_bundle
from typer.testing import CliRunner

from veilcam_server.demo_data import BUNDLE, FRESH, load_digits
from veilcam_server.testing import FakeCamera
from veilcam_training.bundle import Bundle, read_bundle, write_bundle
from veilcam_training.bundle.layers import LayerNorm, Linear
from veilcam_training.cli.main import app
from veilcam_training.errors import TrainingError

COUNT = 20
BUNDLES = {"pairs": BUNDLE, "fresh": FRESH}


def coloured() -> Bundle:
    """Return a bundle in colour whose classifier is random."""
    [pair] = make_bundle(pairs=1).pairs
    draws, inputs = np.random.default_rng(2), 3 * EMBEDDING.size
    weight = draws.normal(size=(len(LABELS), inputs)).astype(np.float32)
    weights: dict[str, npt.NDArray[Any]] = {
        "1.weight": weight / 4,
        "1.bias": np.zeros(len(LABELS), np.float32),
    }
    layers = (LayerNorm(shape=(inputs,), affine=False), Linear(inputs=inputs, outputs=len(LABELS)))
    return replace(
        make_bundle(pairs=1), channels=3, pairs=(replace(pair, layers=layers, weights=weights),)
    )


def draw(folder: Path) -> list[Path]:
    """Draw digits of several sizes, forms, depths and turns, some of them tinted."""
    paths = []
    draws = np.random.default_rng(3)
    for number, digit in enumerate(load_digits().images[:COUNT]):
        pixels = np.kron(digit, np.ones((1 + number % 3,) * 2, np.uint8))
        beside = np.full((len(pixels), 5 + number), 255, np.uint8)
        pixels = np.hstack([beside, pixels, beside])
        if number % 4 == 0:
            tint = draws.uniform(0.6, 1, 3)
            pixels = (pixels[..., None] * tint).astype(np.uint8)
        elif number % 4 == 1:
            pixels = pixels.astype(np.uint16) * 257
        exif = Image.Exif()
        if number % 4 == 2:
            pixels, exif[0x0112] = np.rot90(pixels).copy(), 6
        paths.append(folder / f"{'ab'[number % 2]}" / f"{number:02}.png")
        paths[-1].parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(pixels).save(paths[-1], exif=exif)
    return sorted(paths)


def predicted(*arguments: object) -> list[list[str]]:
    result = CliRunner().invoke(app, ["predict", *map(str, arguments)])
    if result.exception is not None:
        raise result.exception
    return [line.split("\t") for line in result.output.splitlines()]


@pytest.mark.parametrize(("kind", "noise"), [("pairs", 0.1), ("fresh", 0.1), ("colour", 0.03)])
def test_labels_are_those_of_a_daemon_that_sees_the_files(
    kind: str, noise: float, tmp_path: Path
) -> None:
    bundle = read_bundle(BUNDLES[kind]) if kind in BUNDLES else coloured()
    bundle = replace(bundle, pairs=bundle.pairs[:1])
    path = tmp_path / "own.veilcam"
    write_bundle(path, replace(bundle, card=None))
    pictures = draw(tmp_path / "pictures")
    told = predicted(path, tmp_path / "pictures")
    assert told == predicted(path, *pictures)
    scenes = tuple(map(str, pictures))
    settings = {"bundle": path, "scenes": scenes, "snr_db": math.inf, "allow_visible": True}
    settings["full_scores"] = True
    with FakeCamera(settings) as fake, fake.camera() as camera:
        seen = [camera.classify() for _ in pictures]
    sure = 0
    for picture, (name, label, confidence), answer in zip(pictures, told, seen, strict=True):
        assert name == str(picture)
        first, second = sorted((answer.scores or {}).values())[:-3:-1]
        if first - second > (0.9 if kind in BUNDLES else 0.05):  # noise does not turn it
            sure += 1
            assert label == answer.label
            assert float(confidence) == pytest.approx(answer.confidence, abs=noise)
    assert sure > COUNT / 2


def test_path_that_is_missing_or_damaged_is_named(tmp_path: Path) -> None:
    bundle, (first, *_) = BUNDLE, draw(tmp_path / "pictures")
    with pytest.raises(TrainingError, match=r"gone\.png is missing"):
        predicted(bundle, first, tmp_path / "gone.png")
    first.write_bytes(first.read_bytes()[:60])
    with pytest.raises(TrainingError, match=rf"{first.name} is damaged"):
        predicted(bundle, first)
    (tmp_path / "empty").mkdir()
    with pytest.raises(TrainingError, match="empty holds no picture"):
        predicted(bundle, tmp_path / "empty")
