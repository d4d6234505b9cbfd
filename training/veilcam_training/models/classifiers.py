"""Classifiers by name, as the layer records that a bundle holds.

``LR``, ``FC<width>`` and ``VGG11`` are the paper's (``FC800`` has 800 hidden units); ``MLP<width>``
and ``CNN<width>`` are ours.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from veilcam_training.bundle.layers import (
    GELU,
    Affine,
    BatchNorm,
    Conv2d,
    Dropout,
    Flatten,
    LayerNorm,
    LayerRecord,
    Linear,
    MaxPool,
    PlainLayer,
    ReLU,
    Reshape,
    Residual,
    Resize,
)
from veilcam_training.errors import TrainingError

Layers = tuple[LayerRecord, ...]
PlainLayers = tuple[PlainLayer, ...]

NAMES = ("LR", "FC<width>", "MLP<width>", "CNN<width>", "VGG11")
VGG11 = (64, "pool", 128, "pool", 256, 256, "pool", 512, 512, "pool", 512, 512, "pool")
"""Output channels of the 3 x 3 convolutions (Simonyan and Zisserman 2015, configuration A)."""
VGG_SIDE = 32
LEAST_POOLED_SIDE = 6
"""A CNN halves the image while its shorter side is at least this long."""


Normalisation = Literal["shared", "per_pixel", "white"]
"""What becomes of a reading first: batch normalisation with one scale for all pixels of a colour
(``shared``, the paper's) or for each pixel (``per_pixel``), followed by ReLU where the sensor is
learned. With ``white`` nothing does: the hidden layer takes the reading itself, and is fitted in
coordinates in which the reading is decorrelated, see :mod:`veilcam_training.models.whitening`."""

Exposure = Literal["fixed", "automatic"]
"""``automatic`` first brings every reading to mean 0 and variance 1, as a camera that sets its
exposure by the scene would: a small object sends a hundredth of a large one's light."""
DARKEST = 1e-12
"""Added to that variance, where a white scene has about 1."""


@dataclass(frozen=True)
class Task:
    """What goes into a classifier and what must come out."""

    channels: int
    rows: int
    columns: int
    classes: int
    rectified: bool
    """True behind a learned sensor: batch normalisation is followed by ReLU, as in the paper."""
    normalisation: Normalisation
    gain: float = 1.0
    """What a reading is multiplied by first, so that a white scene comes to about 1.

    Batch normalisation is not free of units: it adds 1e-5 to every variance.
    """
    exposure: Exposure = "fixed"

    @property
    def inputs(self) -> int:
        """How many numbers go in."""
        return self.channels * self.rows * self.columns

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of the embedding as an image."""
        return self.channels, self.rows, self.columns


def make_layers(name: str, task: Task, *, dropout: float = 0.0) -> Layers:
    """Layers of classifier ``name``; the last gives logits.

    Args:
        name: one of ``NAMES``, with a number for ``<width>``.
        task: inputs and outputs.
        dropout: probability, for those that have hidden layers.

    Raises:
        TrainingError: an unknown name, or dropout that would have no effect.
    """
    if task.normalisation == "white" and not name.startswith(("FC", "MLP")):
        raise TrainingError(
            f"normalisation 'white' needs a hidden layer that takes the whole reading: use it with "
            f"FC or MLP, not with {name!r}"
        )
    if name == "LR":
        if dropout:
            raise TrainingError("LR has no hidden layer: use dropout 0")
        return (*_sensor(task), Linear(inputs=task.inputs, outputs=task.classes))
    if name == "VGG11":
        return _vgg11(task, dropout)
    makers: dict[str, Callable[[Task, int, float], Layers]] = {
        "FC": _fully_connected,
        "MLP": _residual_mlp,
        "CNN": _convolutional,
    }
    match = re.fullmatch(r"(FC|MLP|CNN)([1-9]\d{0,4})", name)
    if match is None:
        raise TrainingError(f"classifier {name!r} is unknown: use one of {', '.join(NAMES)}")
    return makers[match[1]](task, int(match[2]), dropout)


def _sensor(task: Task) -> Layers:
    """Bring readings to a handy range."""
    gain: Layers = () if task.gain == 1 else (Affine(scale=task.gain),)
    if task.exposure == "automatic":
        gain = (*gain, LayerNorm(shape=(task.inputs,), affine=False, epsilon=DARKEST))
    if task.normalisation == "white":
        return gain
    rectifier: Layers = (ReLU(),) if task.rectified else ()
    if task.normalisation == "per_pixel":
        return (*gain, BatchNorm(features=task.inputs), *rectifier)
    normalise = BatchNorm(features=task.channels, dimensions=2)
    return (*gain, Reshape(shape=task.shape), normalise, *rectifier, Flatten())


def _dropped(dropout: float) -> PlainLayers:
    return (Dropout(probability=dropout),) if dropout else ()


def _fully_connected(task: Task, width: int, dropout: float) -> Layers:
    """The paper's network: one hidden layer."""
    return (
        *_sensor(task),
        Linear(inputs=task.inputs, outputs=width, bias=False),
        BatchNorm(features=width),
        ReLU(),
        *_dropped(dropout),
        Linear(inputs=width, outputs=task.classes),
    )


def _residual_mlp(task: Task, width: int, dropout: float) -> Layers:
    """One hidden layer and two residual ones."""
    block = Residual(
        layers=(
            Linear(inputs=width, outputs=width, bias=False),
            BatchNorm(features=width),
            GELU(),
            *_dropped(dropout),
            Linear(inputs=width, outputs=width),
        )
    )
    return (
        *_sensor(task),
        Linear(inputs=task.inputs, outputs=width, bias=False),
        BatchNorm(features=width),
        GELU(),
        *_dropped(dropout),
        block,
        block,
        BatchNorm(features=width),
        GELU(),
        Linear(inputs=width, outputs=task.classes),
    )


def _convolution(inputs: int, outputs: int, kernel: int = 3, stride: int = 1) -> PlainLayers:
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


def _convolutional(task: Task, width: int, dropout: float) -> Layers:
    """Convolutions straight on the embedding, without any reconstruction of the scene.

    The last layers see every place by itself: behind a mask, where light falls matters.
    """
    layers: list[LayerRecord] = [*_sensor(task), Reshape(shape=task.shape)]
    # A large embedding is halved at once: most of the time goes into the largest planes.
    stride = 2 if min(task.rows, task.columns) >= 2 * LEAST_POOLED_SIDE else 1
    layers += _convolution(task.channels, width, kernel=5, stride=stride)
    rows, columns, channels = -(-task.rows // stride), -(-task.columns // stride), width
    while True:
        block = (*_convolution(channels, channels), *_convolution(channels, channels)[:2])
        layers += [Residual(layers=block), ReLU()]
        if min(rows, columns) < LEAST_POOLED_SIDE:
            break
        layers += [*_convolution(channels, 2 * channels), MaxPool(kernel=2)]
        rows, columns, channels = rows // 2, columns // 2, 2 * channels
    hidden = 8 * width
    return (
        *layers,
        Flatten(),
        Linear(inputs=channels * rows * columns, outputs=hidden, bias=False),
        BatchNorm(features=hidden),
        ReLU(),
        *_dropped(dropout),
        Linear(inputs=hidden, outputs=task.classes),
    )


def _vgg11(task: Task, dropout: float) -> Layers:
    """VGG11 with batch normalisation for 32 x 32 images, to which the embedding is resized."""
    layers: list[LayerRecord] = [*_sensor(task), Reshape(shape=task.shape)]
    layers.append(Resize(rows=VGG_SIDE, columns=VGG_SIDE))
    channels = task.channels
    for step in VGG11:
        if isinstance(step, int):
            layers += _convolution(channels, step)
            channels = step
        else:
            layers.append(MaxPool(kernel=2))
    return (
        *layers,
        Flatten(),
        *_dropped(dropout),
        Linear(inputs=channels, outputs=task.classes),
    )
