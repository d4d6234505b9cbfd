"""Classifiers by name, as the layer records that a bundle holds.

``LR``, ``FC<width>`` and ``VGG11`` are the paper's (``FC800`` has 800 hidden units). A
``CNN<width>`` convolves a measurement. A ``Scene<width>`` reads the scene that is estimated from a
measurement, gray or in colour, behind one mask as behind fresh ones.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeVar

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
    PlainLayer,
    ReLU,
    Reshape,
    Residual,
    Resize,
)
from veilcam_training.errors import TrainingError, require

Layers = tuple[LayerRecord, ...]
PlainLayers = tuple[PlainLayer, ...]

VGG11 = (64, "pool", 128, "pool", 256, 256, "pool", 512, 512, "pool", 512, 512, "pool")
"""Output channels of the 3 x 3 convolutions (Simonyan and Zisserman 2015, configuration A)."""
VGG_SIDE = 32
LEAST_POOLED_SIDE = 6
"""A CNN halves the image while its shorter side is at least this long."""
WHITENING = 2
"""Side of the patches that a scene classifier's first layer takes."""


Normalisation = Literal["shared", "per_pixel", "white"]
"""What becomes of a measurement first: batch normalisation with one scale for all pixels of a
colour (``shared``, the paper's) or for each pixel (``per_pixel``), followed by ReLU where the
sensor is learned. With ``white`` nothing does: the hidden layer takes the measurement itself, and
is fitted in coordinates in which the measurement is decorrelated, see
:mod:`veilcam_training.models.whitening`."""

Exposure = Literal["fixed", "automatic"]
"""``automatic`` first brings every measurement to mean 0 and variance 1, as a camera that sets its
exposure by the scene would: a small object sends a hundredth of a large one's light."""
DARKEST = 1e-12
"""Added to that variance, where a white scene has about 1."""


@dataclass(frozen=True)
class Task:
    """Shape of a classifier's inputs and number of its outputs."""

    channels: int
    rows: int
    columns: int
    classes: int
    rectified: bool
    """True behind a learned sensor: batch normalisation is followed by ReLU, as in the paper."""
    normalisation: Normalisation
    gain: float = 1.0
    """What a measurement is multiplied by first, so that a white scene comes to about 1.

    Batch normalisation is not free of units: it adds 1e-5 to every variance.
    """
    exposure: Exposure = "fixed"
    estimate: "tuple[SceneTask, Layers] | None" = None
    """Estimated scenes, and the layers that estimate them; None if they cannot be estimated."""

    @property
    def inputs(self) -> int:
        """Number of inputs."""
        return self.channels * self.rows * self.columns

    @property
    def shape(self) -> tuple[int, int, int]:
        """Shape of the embedding as an image."""
        return self.channels, self.rows, self.columns


@dataclass(frozen=True)
class SceneTask:
    """Estimated scenes that go into a classifier, and what must come out."""

    channels: int
    """1 gray, 3 in colour."""
    rows: int
    columns: int
    classes: int


def reads_scenes(name: str) -> bool:
    """Return True if a classifier reads the estimate of the scene."""
    return name.startswith("Scene")


def make_layers(name: str, task: Task | SceneTask, *, dropout: float = 0.0) -> Layers:
    """Layers of classifier ``name``; the last gives logits.

    Args:
        name: one of ``OF_MEASUREMENTS``, with a number for ``<width>``; of estimated scenes it is
            ``Scene<width>`` alone.
        task: inputs and outputs.
        dropout: probability, for those that have hidden layers.

    Raises:
        TrainingError: an unknown name, or dropout that would have no effect.
    """
    if isinstance(task, SceneTask):
        _, width = _find({SCENE: _estimated}, name)
        return _scene(task, width, dropout)
    require(
        task.normalisation != "white" or name.startswith("FC"),
        f"normalisation 'white' needs a hidden layer that takes all of a measurement: use it "
        f"with FC, not with {name!r}",
    )
    make, width = _find(OF_MEASUREMENTS, name)
    return make(task, width, dropout)


MakerT = TypeVar("MakerT")


def _find(makers: Mapping[str, MakerT], name: str) -> tuple[MakerT, int]:
    """Return the maker of classifier ``name``, and its width."""
    match = re.fullmatch(r"(\D+)([1-9]\d{0,4})", name)
    of_any_width = match is not None and f"{match[1]}<width>" in makers
    kind, width = (f"{match[1]}<width>", int(match[2])) if match and of_any_width else (name, 0)
    require(
        kind in makers and (width != 0 or "<" not in kind),
        f"classifier {name!r} is unknown: use one of {', '.join(makers)}",
    )
    return makers[kind], width


def _sensor(task: Task) -> Layers:
    """Bring measurements to a handy range."""
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


def _linear(task: Task, _: int, dropout: float) -> Layers:
    require(not dropout, "LR has no hidden layer: use dropout 0")
    return (*_sensor(task), Linear(inputs=task.inputs, outputs=task.classes))


def _fully_connected(task: Task, width: int, dropout: float) -> Layers:
    """Return the paper's network: one hidden layer."""
    return (
        *_sensor(task),
        Linear(inputs=task.inputs, outputs=width, bias=False),
        BatchNorm(features=width),
        ReLU(),
        *_dropped(dropout),
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


def _vgg11(task: Task, _: int, dropout: float) -> Layers:
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


def _scene(task: SceneTask, width: int, dropout: float) -> Layers:
    """Return a narrow network of three groups (after Jordan, arXiv:2404.00498).

    Its first layer is a whitening of small patches, which is computed and not fitted. Each group
    halves the image, and the maximum over all places is classified.
    """
    require(not dropout, "a Scene classifier has no dropout: use dropout 0")
    patch = task.channels * WHITENING**2
    layers: list[LayerRecord] = [
        Reshape(shape=(task.channels, task.rows, task.columns)),
        BatchNorm(features=task.channels, dimensions=2),
        Conv2d(inputs=task.channels, outputs=2 * patch, kernel=WHITENING, padding=0),
        GELU(),
    ]
    inputs, side = 2 * patch, min(task.rows, task.columns) + 1 - WHITENING
    require(side >= 2, f"scenes of {task.rows} x {task.columns} pixels are too small: use 3 x 3")
    for outputs in (width, 4 * width, 4 * width):
        layers.append(Conv2d(inputs=inputs, outputs=outputs, bias=False))
        if side >= 2:
            layers.append(MaxPool(kernel=2))
            side //= 2
        layers += [*_normal(outputs), Conv2d(inputs=outputs, outputs=outputs, bias=False)]
        layers += _normal(outputs)
        inputs = outputs
    classify = Linear(inputs=inputs, outputs=task.classes, bias=False)
    return (*layers, GlobalMaxPool(), classify, Affine(scale=1 / 9))


def _normal(features: int) -> PlainLayers:
    return BatchNorm(features=features, dimensions=2, epsilon=1e-12), GELU()


def _estimated(task: Task, width: int, dropout: float) -> Layers:
    """Return the same behind the layers that estimate the scene, computed and never fitted."""
    if task.estimate is None:
        raise TrainingError(
            "a Scene classifier reads the estimated scene as it is: use it without change, or use "
            "CNN<width> instead"
        )
    scene, estimate = task.estimate
    return (*estimate, *_scene(scene, width, dropout))


SCENE = "Scene<width>"
OF_MEASUREMENTS: Mapping[str, Callable[[Task, int, float], Layers]] = {
    "LR": _linear,
    "FC<width>": _fully_connected,
    "CNN<width>": _convolutional,
    "VGG11": _vgg11,
    SCENE: _estimated,
}
"""Classifiers of measurements, by name."""
