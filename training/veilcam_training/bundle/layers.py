"""Layer records: a classifier as data, so that loading one runs no code of its author.

Every record knows the arrays that it needs and the shape that comes out of it; shapes are those of
one sample, without the batch. :mod:`veilcam_training.bundle.network` computes it, and
:mod:`veilcam_training.models.network` has the module that learns.
"""

import math
from collections.abc import Mapping
from typing import Annotated, Literal, TypeAlias

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

Shape = tuple[int, ...]
Needs: TypeAlias = Mapping[str, tuple[Shape, "np.dtype[np.generic]"]]
"""Shape and type of arrays, by name."""
Width = Annotated[int, Field(ge=1, le=2**16)]
Side = Annotated[int, Field(ge=1, le=4096)]
Small = Annotated[int, Field(ge=1, le=64)]

MAX_VALUES = 2**24
"""Most numbers that one sample may occupy between two layers, or within a convolution."""
_PER_VALUE = 16
"""What any layer is taken to cost for each number that it gives: as much as so many products."""


_FLOAT, _WHOLE = np.dtype(np.float32), np.dtype(np.int64)


class LayerShapeError(ValueError):
    """A layer that cannot take what the layer before it gives."""


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    def output_shape(self, shape: Shape) -> Shape:
        """Return the shape after this layer: by default the same."""
        return shape

    @property
    def parameters(self) -> Needs:
        """Shape and type of the arrays that it needs, by name: by default none."""
        return {}


def _require(condition: bool, shape: Shape, wants: str) -> None:
    if not condition:
        raise LayerShapeError(f"gets shape {shape} but wants {wants}")


def _with_bias(shape: Shape, *, bias: bool) -> Needs:
    weight: Needs = {"weight": (shape, _FLOAT)}
    return {**weight, "bias": (shape[:1], _FLOAT)} if bias else weight


class Linear(_Record):
    """Fully connected layer."""

    kind: Literal["linear"] = "linear"
    inputs: Annotated[int, Field(ge=1, le=2**20)]
    outputs: Width
    bias: bool = True

    @property
    def parameters(self) -> Needs:
        """Shape and type of the arrays that it needs, by name."""
        return _with_bias((self.outputs, self.inputs), bias=self.bias)

    def output_shape(self, shape: Shape) -> Shape:
        """Return the shape after this layer, or raise :class:`LayerShapeError`."""
        _require(shape == (self.inputs,), shape, f"({self.inputs},)")
        return (self.outputs,)


class BatchNorm(_Record):
    """Batch normalisation of vectors (``dimensions`` 1) or images (``dimensions`` 2)."""

    kind: Literal["batch_norm"] = "batch_norm"
    features: Annotated[int, Field(ge=1, le=2**20)]
    dimensions: Literal[1, 2] = 1
    epsilon: Annotated[float, Field(gt=0, le=1)] = 1e-5

    @property
    def parameters(self) -> Needs:
        """Shape and type of the arrays that it needs, by name."""
        names = ("weight", "bias", "running_mean", "running_var")
        counted = {"num_batches_tracked": ((), _WHOLE)}  # torch writes it, and nobody reads it
        return dict.fromkeys(names, ((self.features,), _FLOAT)) | counted

    def output_shape(self, shape: Shape) -> Shape:
        """Return the shape after this layer, or raise :class:`LayerShapeError`."""
        ranks = (1,) if self.dimensions == 1 else (3,)
        _require(
            len(shape) in ranks and shape[0] == self.features,
            shape,
            f"{self.features} features of rank {ranks[0]}",
        )
        return shape


class LayerNorm(_Record):
    """Normalisation of one sample over all its numbers: it takes out the exposure."""

    kind: Literal["layer_norm"] = "layer_norm"
    shape: Annotated[tuple[Side, ...], Field(min_length=1, max_length=3)]
    affine: bool = True
    epsilon: Annotated[float, Field(gt=0, le=1)] = 1e-5

    @property
    def parameters(self) -> Needs:
        """Shape and type of the arrays that it needs, by name."""
        return {name: (self.shape, _FLOAT) for name in ("weight", "bias") if self.affine}

    def output_shape(self, shape: Shape) -> Shape:
        """Return the shape after this layer, or raise :class:`LayerShapeError`."""
        _require(shape == self.shape, shape, f"{self.shape}")
        return shape


class Affine(_Record):
    """``scale * x + offset``, two constants: brings a measurement to a handy range."""

    kind: Literal["affine"] = "affine"
    scale: Annotated[float, Field(allow_inf_nan=False)] = 1.0
    offset: Annotated[float, Field(allow_inf_nan=False)] = 0.0


class ReLU(_Record):
    """max(x, 0)."""

    kind: Literal["relu"] = "relu"


class GELU(_Record):
    """``x / 2 (1 + tanh(sqrt(2 / pi) (x + 0.044715 x^3)))`` (Hendrycks and Gimpel 2016)."""

    kind: Literal["gelu"] = "gelu"


class Dropout(_Record):
    """Dropout in training; nothing at all in use."""

    kind: Literal["dropout"] = "dropout"
    probability: Annotated[float, Field(ge=0, lt=1)] = 0.5


class Flatten(_Record):
    """All numbers of a sample in one row."""

    kind: Literal["flatten"] = "flatten"

    def output_shape(self, shape: Shape) -> Shape:
        """Return the shape after this layer."""
        return (math.prod(shape),)


class Reshape(_Record):
    """A vector as an image of shape (channels, rows, columns)."""

    kind: Literal["reshape"] = "reshape"
    shape: tuple[Side, Side, Side]

    def output_shape(self, shape: Shape) -> Shape:
        """Return the shape after this layer, or raise :class:`LayerShapeError`."""
        _require(shape == (math.prod(self.shape),), shape, f"({math.prod(self.shape)},)")
        return self.shape


class Resize(_Record):
    """Bilinear resizing of an image to ``rows x columns``."""

    kind: Literal["resize"] = "resize"
    rows: Side
    columns: Side

    def output_shape(self, shape: Shape) -> Shape:
        """Return the shape after this layer, or raise :class:`LayerShapeError`."""
        _require(len(shape) == 3, shape, "(channels, rows, columns)")
        return (shape[0], self.rows, self.columns)


class Conv2d(_Record):
    """Two-dimensional convolution with a square kernel."""

    kind: Literal["conv2d"] = "conv2d"
    inputs: Side
    outputs: Side
    kernel: Small = 3
    stride: Small = 1
    padding: Annotated[int, Field(ge=0, le=64)] = 1
    groups: Side = 1
    bias: bool = True

    @property
    def parameters(self) -> Needs:
        """Shape and type of the arrays that it needs, by name."""
        kernels = (self.outputs, self.inputs // self.groups, self.kernel, self.kernel)
        return _with_bias(kernels, bias=self.bias)

    def output_shape(self, shape: Shape) -> Shape:
        """Return the shape after this layer, or raise :class:`LayerShapeError`."""
        _require(
            len(shape) == 3 and shape[0] == self.inputs, shape, f"({self.inputs}, rows, columns)"
        )
        _require(
            self.inputs % self.groups == 0 and self.outputs % self.groups == 0,
            shape,
            f"channels that {self.groups} groups divide",
        )
        rows, columns = (
            (side + 2 * self.padding - self.kernel) // self.stride + 1 for side in shape[1:]
        )
        _require(min(rows, columns) >= 1, shape, f"an image that holds a kernel of {self.kernel}")
        # On the way it is unfolded: every pixel as often as a kernel sees it.
        unfolded = self.inputs * self.kernel**2 * rows * columns
        _require(unfolded <= MAX_VALUES, shape, f"at most {MAX_VALUES} numbers under its kernels")
        return (self.outputs, rows, columns)


class MaxPool(_Record):
    """Maximum over squares of ``kernel`` pixels, one every ``kernel`` pixels."""

    kind: Literal["max_pool"] = "max_pool"
    kernel: Small = 2

    def output_shape(self, shape: Shape) -> Shape:
        """Return the shape after this layer, or raise :class:`LayerShapeError`."""
        _require(
            len(shape) == 3 and min(shape[1:]) >= self.kernel,
            shape,
            f"an image of at least {self.kernel} x {self.kernel}",
        )
        return (shape[0], shape[1] // self.kernel, shape[2] // self.kernel)


class GlobalMaxPool(_Record):
    """Maximum of each channel of an image."""

    kind: Literal["global_max_pool"] = "global_max_pool"

    def output_shape(self, shape: Shape) -> Shape:
        """Return the shape after this layer, or raise :class:`LayerShapeError`."""
        _require(len(shape) == 3, shape, "(channels, rows, columns)")
        return shape[:1]


PlainLayer = (
    Linear
    | BatchNorm
    | LayerNorm
    | Affine
    | ReLU
    | GELU
    | Dropout
    | Flatten
    | Reshape
    | Resize
    | Conv2d
    | MaxPool
    | GlobalMaxPool
)


class Residual(_Record):
    """``x + layers(x)``."""

    kind: Literal["residual"] = "residual"
    layers: Annotated[
        tuple[Annotated[PlainLayer, Field(discriminator="kind")], ...],
        Field(min_length=1, max_length=16),
    ]

    @property
    def parameters(self) -> Needs:
        """Shape and type of the arrays that it needs, by name."""
        return {
            f"layers.{index}.{name}": needed
            for index, layer in enumerate(self.layers)
            for name, needed in layer.parameters.items()
        }

    def output_shape(self, shape: Shape) -> Shape:
        """Return the shape after this layer, or raise :class:`LayerShapeError`."""
        after = shape
        for layer in self.layers:
            after = checked_shape(layer, after)
        _require(after == shape, shape, "layers that keep the shape")
        return shape


LayerRecord = Annotated[PlainLayer | Residual, Field(discriminator="kind")]
"""Any layer record; ``kind`` tells which."""


def checked_shape(layer: _Record, shape: Shape) -> Shape:
    """Return the shape after ``layer``; raise :class:`LayerShapeError` where it grows too large."""
    after = layer.output_shape(shape)
    _require(math.prod(after) <= MAX_VALUES, shape, f"at most {MAX_VALUES} numbers after it")
    return after


def operations(layer: PlainLayer | Residual, shape: Shape) -> int:
    """Products that ``layer`` takes for one sample of ``shape``, which it fits."""
    if isinstance(layer, Residual):
        total = 0
        for inner in layer.layers:
            total += operations(inner, shape)
            shape = inner.output_shape(shape)
        return total + _PER_VALUE * math.prod(shape)
    values = math.prod(layer.output_shape(shape))
    if isinstance(layer, Linear):
        return values * (layer.inputs + _PER_VALUE)
    if isinstance(layer, Conv2d):
        return values * (layer.inputs // layer.groups * layer.kernel**2 + _PER_VALUE)
    # Pooling looks at every number that goes in.
    return max(values, math.prod(shape)) * _PER_VALUE
