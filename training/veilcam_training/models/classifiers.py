"""Classifiers by name, as the layer records that a bundle holds.

``LR``, ``FC<width>`` and ``VGG11`` are the paper's (``FC800`` has 800 hidden units); the others,
``MLP<width>``, ``CNN<width>`` and ``ResNet<width>``, are ours. A ``ResNet<width>`` reads the scene
that is estimated from a measurement, behind one mask as behind fresh ones; of decoded scenes there
is a ``CNN<width>``, too.
"""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeVar

from veilcam_training.bundle.classifier import output_shape
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
LEAST_SCENE_SIDE = 8
"""One of decoded scenes halves them until a side is shorter than twice this."""
SCENE_HIDDEN = 128
"""Hidden units after its convolutions."""


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
    scene: "SceneTask | None" = None
    """What the scene is estimated as, for classifiers that read that; None if it cannot be."""

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
    """Decoded scenes that go into a classifier, and what must come out."""

    channels: int
    """Each as large as the scene."""
    rows: int
    columns: int
    classes: int
    centred: bool
    """False averages over all places before the last layers, for objects anywhere."""


def reads_scenes(name: str) -> bool:
    """Return True if a classifier of measurements begins with the estimate of the scene."""
    return name.startswith("ResNet")


def make_layers(name: str, task: Task | SceneTask, *, dropout: float = 0.0) -> Layers:
    """Layers of classifier ``name``; the last gives logits.

    Args:
        name: one of ``OF_MEASUREMENTS`` or ``OF_SCENES``, with a number for ``<width>``.
        task: inputs and outputs.
        dropout: probability, for those that have hidden layers.

    Raises:
        TrainingError: an unknown name, or dropout that would have no effect.
    """
    if isinstance(task, SceneTask):
        make_for_scene, width = _find(OF_SCENES, name)
        return make_for_scene(task, width, dropout)
    require(
        task.normalisation != "white" or name.startswith(("FC", "MLP")),
        f"normalisation 'white' needs a hidden layer that takes all of a measurement: use it "
        f"with FC or MLP, not with {name!r}",
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


def _of_stages(task: SceneTask, width: int, dropout: float, blocks: int) -> Layers:
    """Return a residual network of stages.

    A convolution halves the image at the start of every stage, and ``blocks`` residual blocks
    follow. The first stage has ``width`` channels and each next one twice as many.
    """
    layers: list[LayerRecord] = [Reshape(shape=(task.channels, task.rows, task.columns))]
    inputs, kernel, side = task.channels, 5, min(task.rows, task.columns)
    while True:
        layers += _convolution(inputs, width, kernel=kernel, stride=2)
        block = (*_convolution(width, width), *_convolution(width, width)[:2])
        layers += [Residual(layers=block), ReLU()] * blocks
        side = math.ceil(side / 2)
        if side < LEAST_SCENE_SIDE:
            break
        inputs, width, kernel = width, 2 * width, 3
    if not task.centred:
        layers.append(AveragePool())
    layers.append(Flatten())
    (features,) = output_shape(layers, task.channels * task.rows * task.columns)
    return (
        *layers,
        *_dropped(dropout),
        Linear(inputs=features, outputs=SCENE_HIDDEN, bias=False),
        BatchNorm(features=SCENE_HIDDEN),
        ReLU(),
        Linear(inputs=SCENE_HIDDEN, outputs=task.classes),
    )


def _scene_convolutional(task: SceneTask, width: int, dropout: float) -> Layers:
    """One residual block a stage."""
    return _of_stages(task, width, dropout, blocks=1)


def _scene_residual(task: SceneTask, width: int, dropout: float) -> Layers:
    """Two residual blocks a stage: deeper, for what is told apart by a few pixels of a scene."""
    return _of_stages(task, width, dropout, blocks=2)


def _estimated(task: Task, width: int, dropout: float) -> Layers:
    """Return the same behind a first layer that estimates the scene, computed and never fitted."""
    scene = task.scene
    if scene is None:
        raise TrainingError(
            "a ResNet reads the estimated scene, which is gray and as it is: use it without "
            "colour and change, or use CNN<width> instead"
        )
    require(
        task.exposure == "fixed",
        "exposure 'automatic' would take from a ResNet what its estimate is made of: use 'fixed'",
    )
    outputs = scene.channels * scene.rows * scene.columns
    return (Linear(inputs=task.inputs, outputs=outputs), *_scene_residual(scene, width, dropout))


OF_MEASUREMENTS: Mapping[str, Callable[[Task, int, float], Layers]] = {
    "LR": _linear,
    "FC<width>": _fully_connected,
    "MLP<width>": _residual_mlp,
    "CNN<width>": _convolutional,
    "VGG11": _vgg11,
    "ResNet<width>": _estimated,
}
"""Classifiers of measurements, by name."""
OF_SCENES: Mapping[str, Callable[[SceneTask, int, float], Layers]] = {
    "CNN<width>": _scene_convolutional,
    "ResNet<width>": _scene_residual,
}
"""Classifiers of decoded scenes."""
