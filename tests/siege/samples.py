"""Bundles that stress tests start from."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch

from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Window
from veilcam_optics.decoding import MeasurementNoise, fit_statistics
from veilcam_optics.keys.masks import MaskDistribution
from veilcam_server.demo_data import load_digits
from veilcam_training.bundle import Bundle, Fresh, Pair
from veilcam_training.bundle.layers import (
    GELU,
    Affine,
    AveragePool,
    BatchNorm,
    Conv2d,
    Dropout,
    Flatten,
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

CAMERA, SCENE, EMBEDDING = Camera(window=Window(rows=9, columns=5)), Scene(), Embedding(4, 5)
LABELS = tuple("0123456789")


def make_bundles() -> list[Bundle]:
    """Two that fit one camera, with every kind of layer between them: stored masks and fresh."""
    torch.manual_seed(0)
    flat: tuple[LayerRecord, ...] = (
        LayerNorm(shape=(20,)),
        Affine(scale=2.0, offset=0.1),
        Linear(inputs=20, outputs=16),
        BatchNorm(features=16),
        GELU(),
        Dropout(),
        Linear(inputs=16, outputs=10),
    )
    deep: tuple[LayerRecord, ...] = (
        Reshape(shape=(1, 4, 5)),
        Resize(rows=8, columns=8),
        Conv2d(inputs=1, outputs=4),
        Residual(layers=(Conv2d(inputs=4, outputs=4), BatchNorm(features=4, dimensions=2), ReLU())),
        MaxPool(),
        AveragePool(rows=2, columns=2),
        Flatten(),
        Linear(inputs=16, outputs=10),
    )
    fresh: tuple[LayerRecord, ...] = (
        Reshape(shape=(2, *SCENE.shape)),
        AveragePool(rows=4, columns=4),
        Flatten(),
        Linear(inputs=32, outputs=10),
    )

    def pair(layers: tuple[LayerRecord, ...]) -> Pair:
        levels = torch.randint(0, 64, CAMERA.mask_shape, dtype=torch.uint8).numpy()
        return Pair(levels, layers, weights_of(build_untrained(layers)))

    digits = load_digits().images[:100] / np.float32(255)
    pairs = Bundle(
        task="mnist",
        labels=LABELS,
        camera=CAMERA,
        scene=SCENE,
        embedding=EMBEDDING,
        mode="pairs",
        pairs=(pair(flat), pair(deep)),
        provenance={"seed": 1, "recipe": {"epochs": 2, "rates": [0.1, None]}},
    )
    keyed = Fresh(
        distribution=MaskDistribution.uniform(CAMERA),
        statistics=fit_statistics([digits], 8),
        noise=MeasurementNoise(40.0),
        layers=fresh,
        weights=weights_of(build_untrained(fresh)),
    )
    return [pairs, dataclasses.replace(pairs, mode="fresh", pairs=(), fresh=keyed)]
