"""Small cameras to be attacked: their scenes are bars, and each class has a place of its own."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy.typing as npt
import torch

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Window
from veilcam_optics.decoding import MeasurementNoise, fit_statistics
from veilcam_optics.keys.masks import MaskDistribution
from veilcam_training.attacks.card.study import Plan, Study
from veilcam_training.attacks.card.subject import make_subject
from veilcam_training.attacks.networks import TRIALS
from veilcam_training.attacks.victim import ReleaseRule
from veilcam_training.bundle import Bundle, Fresh, LayerRecord, Pair
from veilcam_training.bundle.layers import Linear
from veilcam_training.data import Images
from veilcam_training.models.network import build_untrained, weights_of

CLASSES = 4
CAMERA = Camera(panel=Panel(), window=Window(rows=24, columns=11))
SCENE = Scene(8, 8)
EMBEDDING = Embedding(6, 8)
SIZES: dict[str, int] = {"own": 40, "seen": 80, "long": 3, "own_long": 5, "known": 40, "epochs": 8}
TINY = Plan(**SIZES, trials=TRIALS[1:2], recovered=0, quick=True)
"""800 captures: at chance, one in four, a share has a standard error of 1.5 points."""


def make_images(count: int = 600) -> Images:
    """Bars of one of four places, of any brightness and length, on a ground of noise."""
    random = torch.Generator().manual_seed(3)
    labels = torch.randint(CLASSES, (count,), generator=random)
    pixels = 20 * torch.rand(count, *SCENE.shape, generator=random)
    bright = 120 + 135 * torch.rand(count, generator=random)
    ends = torch.randint(4, 9, (count,), generator=random)
    for row, label, light, end in zip(pixels, labels, bright, ends, strict=True):
        row[2 * label : 2 * label + 2, :end] = light
    return Images(pixels.round().byte(), labels)


def _classifier(
    inputs: int, seed: int
) -> tuple[tuple[LayerRecord, ...], dict[str, npt.NDArray[Any]]]:
    layers: tuple[LayerRecord, ...] = (Linear(inputs=inputs, outputs=CLASSES),)
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        return layers, weights_of(build_untrained(layers))


def make_pairs(count: int = 3) -> Bundle:
    """Random masks with classifiers that know nothing."""
    random, pairs = torch.Generator().manual_seed(5), []
    for number in range(count):
        layers, weights = _classifier(EMBEDDING.size, number)
        levels = torch.randint(0, 64, CAMERA.mask_shape, generator=random, dtype=torch.uint8)
        pairs.append(Pair(levels.numpy(), layers, weights))
    return Bundle(
        task="mnist",
        labels=tuple("abcd"),
        camera=CAMERA,
        scene=SCENE,
        embedding=EMBEDDING,
        mode="pairs",
        pairs=tuple(pairs),
        subject="ab" * 32,
    )


def make_fresh() -> Bundle:
    """Uniform masks, statistics of bars, and a classifier that knows nothing."""
    layers, weights = _classifier(64, 7)
    return Bundle(
        task="mnist",
        labels=tuple("abcd"),
        camera=CAMERA,
        scene=SCENE,
        embedding=EMBEDDING,
        mode="fresh",
        fresh=Fresh(
            distribution=MaskDistribution.uniform(CAMERA),
            statistics=fit_statistics([make_images().scenes()], 30).in_numpy(),
            noise=MeasurementNoise(40.0),
            layers=layers,
            weights=weights,
        ),
        subject="cd" * 32,
    )


def make_study(
    bundle: Bundle, plan: Plan = TINY, form: str | None = None, release: ReleaseRule | None = None
) -> Study:
    """Attack a camera with such a bundle, before bars; ``release`` takes its form's place."""
    images = make_images()
    subject = make_subject(bundle, images.scenes(slice(0, 300)), form=form, seed=1)
    if release is not None:
        subject = replace(subject, release=release)
    return Study(subject, images, plan, seed=1, folder=None, tell=lambda *_: None)
