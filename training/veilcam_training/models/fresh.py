"""A small residual network for decoded scenes, as the layer records that a bundle holds."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from veilcam_optics.camera.geometry import Scene
from veilcam_training.bundle import LayerRecord
from veilcam_training.bundle.layers import (
    AveragePool,
    BatchNorm,
    Conv2d,
    Dropout,
    Flatten,
    Linear,
    ReLU,
    Reshape,
    Residual,
    checked_shape,
)
from veilcam_training.errors import TrainingError

SMALLEST_SIDE = 8
"""Stages halve the image until a side is shorter than twice this."""
HIDDEN = 128


def make_fresh_layers(
    name: str, channels: int, scene: Scene, classes: int, *, centred: bool
) -> tuple[LayerRecord, ...]:
    """Layers of classifier ``CNN<width>``; the last gives logits.

    A convolution halves the image at the start of every stage, and one residual block follows. The
    first stage has ``width`` channels and each next one twice as many.

    Args:
        name: of the classifier.
        channels: of its input, each the size of the scene.
        scene: what is decoded.
        classes: how many labels there are.
        centred: False averages over all places before the last layers, for objects anywhere.

    Raises:
        TrainingError: an unknown name.
    """
    match = re.fullmatch(r"CNN([1-9]\d{0,2})", name)
    if match is None:
        raise TrainingError(f"classifier {name!r} is unknown: use CNN<width>, e.g. CNN32")
    width, kernel, side = int(match[1]), 5, min(scene.shape)
    layers: list[LayerRecord] = [Reshape(shape=(channels, *scene.shape))]
    inputs = channels
    while True:
        layers += _convolution(inputs, width, kernel=kernel, stride=2)
        layers += [
            Residual(
                layers=(
                    *_convolution(width, width),
                    Conv2d(inputs=width, outputs=width, bias=False),
                    BatchNorm(features=width, dimensions=2),
                )
            ),
            ReLU(),
        ]
        side = math.ceil(side / 2)
        if side < SMALLEST_SIDE:
            break
        inputs, width, kernel = width, 2 * width, 3
    if not centred:
        layers.append(AveragePool())
    layers.append(Flatten())
    (features,) = shape_after(layers, channels * scene.rows * scene.columns)
    return (
        *layers,
        Dropout(probability=0.2),
        Linear(inputs=features, outputs=HIDDEN, bias=False),
        BatchNorm(features=HIDDEN),
        ReLU(),
        Linear(inputs=HIDDEN, outputs=classes),
    )


def _convolution(
    inputs: int, outputs: int, *, kernel: int = 3, stride: int = 1
) -> tuple[Conv2d, BatchNorm, ReLU]:
    return (
        Conv2d(
            inputs=inputs,
            outputs=outputs,
            kernel=kernel,
            stride=stride,
            padding=kernel // 2,
            bias=False,
        ),
        BatchNorm(features=outputs, dimensions=2),
        ReLU(),
    )


def shape_after(layers: Sequence[LayerRecord], inputs: int) -> tuple[int, ...]:
    """Shape of one sample after ``layers``."""
    shape: tuple[int, ...] = (inputs,)
    for layer in layers:
        shape = checked_shape(layer, shape)
    return shape


def multiplications(layers: Sequence[LayerRecord], inputs: int) -> int:
    """Multiply-accumulate operations for one sample, in convolutions and linear layers."""
    total = 0
    shape: tuple[int, ...] = (inputs,)
    for layer in layers:
        after = checked_shape(layer, shape)
        inner = layer.layers if isinstance(layer, Residual) else (layer,)
        total += sum(_own(each, after) for each in inner)
        shape = after
    return total


def _own(layer: LayerRecord, after: tuple[int, ...]) -> int:
    if isinstance(layer, Conv2d):
        return math.prod(after) * layer.inputs // layer.groups * layer.kernel**2
    if isinstance(layer, Linear):
        return layer.inputs * layer.outputs
    return 0
