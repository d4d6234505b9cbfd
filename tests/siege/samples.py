"""Bundles of a small window and sensor, whose light takes milliseconds, and a fresh one of any."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Sensor, Window
from veilcam_optics.decoding import MeasurementNoise, fit_statistics
from veilcam_optics.keys.masks import MaskDistribution
from veilcam_server.demo_data import load_digits
from veilcam_training.bundle import Bundle, Fresh, Pair, write_bundle
from veilcam_training.bundle.layers import (
    GELU,
    Affine,
    BatchNorm,
    Conv2d,
    Dropout,
    Flatten,
    GlobalMaxPool,
    LayerNorm,
    LayerRecord,
    Linear,
    MaxPool,
    ReLU,
    Reshape,
    Residual,
    Resize,
)
from veilcam_training.models.network import build_untrained, weights_of

CAMERA = Camera(window=Window(rows=9, columns=5), sensor=Sensor(rows=760, columns=1014))
SCENE, EMBEDDING = Scene(height=0.03), Embedding(4, 5)
FLAT: tuple[LayerRecord, ...] = (
    *(LayerNorm(shape=(20,)), Affine(scale=2.0, offset=0.1), Linear(inputs=20, outputs=16)),
    *(BatchNorm(features=16), GELU(), Dropout(), Linear(inputs=16, outputs=10)),
)
DEEP: tuple[LayerRecord, ...] = (
    *(Reshape(shape=(1, 4, 5)), Resize(rows=8, columns=8), Conv2d(inputs=1, outputs=4)),
    Residual(layers=(Conv2d(inputs=4, outputs=4), BatchNorm(features=4, dimensions=2), ReLU())),
    *(MaxPool(), GlobalMaxPool(), Linear(inputs=4, outputs=10)),
)
LINEAR = (Linear(inputs=20, outputs=10),)
POOLED: tuple[LayerRecord, ...] = (
    *(Reshape(shape=(1, *SCENE.shape)), MaxPool(kernel=7), Flatten()),
    Linear(inputs=16, outputs=10),
)
PAIRS = 3


def small_bundle(task: str = "mnist") -> Bundle:
    with torch.random.fork_rng():
        torch.manual_seed(len(task))

        def pair(layers: tuple[LayerRecord, ...]) -> Pair:
            levels = torch.randint(0, 64, CAMERA.mask_shape, dtype=torch.uint8).numpy()
            return Pair(levels, layers, weights_of(build_untrained(layers)))

        return Bundle(
            task=task,
            labels=tuple("0123456789"),
            camera=CAMERA,
            scene=SCENE,
            embedding=EMBEDDING,
            mode="pairs",
            pairs=tuple(map(pair, (FLAT, DEEP, LINEAR))),
            provenance={"seed": 1, "recipe": {"epochs": 2, "rates": [0.1, None]}},
        )


def fresh_bundle(
    camera: Camera = CAMERA, embedding: Embedding = EMBEDDING, basis: int = 8, snr_db: float = 40.0
) -> Bundle:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        fresh = Fresh(
            distribution=MaskDistribution.uniform(camera),
            statistics=fit_statistics([load_digits().images[:200] / np.float32(255)], basis),
            noise=MeasurementNoise(snr_db),
            layers=POOLED,
            weights=weights_of(build_untrained(POOLED)),
        )
    stored = small_bundle()
    return replace(stored, camera=camera, embedding=embedding, mode="fresh", pairs=(), fresh=fresh)


def written(path: Path, bundle: Bundle) -> Path:
    write_bundle(path, bundle)
    return path
