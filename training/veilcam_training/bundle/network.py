"""Classifiers computed in NumPy, from layer records and weights: what reads behind a mask."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from veilcam_training.bundle.classifier import check_weights
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

Values = npt.NDArray[Any]
Weights = Mapping[str, Values]


@dataclass(frozen=True, eq=False)
class Network:
    """Layers with their weights; as secret as the mask that they were learned with, if one."""

    layers: tuple[LayerRecord, ...]
    weights: Weights = field(repr=False)

    @classmethod
    def load(cls, layers: Sequence[LayerRecord], weights: Weights) -> Self:
        """Make the network that ``layers`` and ``weights`` describe.

        Args:
            layers: records in order.
            weights: weights by the names of torch's ``nn.Sequential.state_dict``; not copied.

        Raises:
            BundleError: names, shapes, types or values that do not fit the layers.
        """
        check_weights(layers, weights)
        return cls(tuple(layers), weights)

    def __call__(self, inputs: Values) -> Values:
        """Logits (batch, labels) of inputs (batch, inputs), float32."""
        with np.errstate(over="ignore", invalid="ignore"):  # who asks looks at the logits
            return _through(self.layers, inputs, self.weights)


def _through(
    layers: Sequence[LayerRecord], x: Values, weights: Weights, inside: str = ""
) -> Values:
    for index, layer in enumerate(layers):
        prefix = f"{inside}{index}."
        if isinstance(layer, Residual):
            x = x + _through(layer.layers, x, weights, f"{prefix}layers.")
        else:
            own = {name: weights[prefix + name] for name in layer.parameters}
            x = _COMPUTED[layer.kind](layer, x, own)
    return x


def _linear(_: Linear, x: Values, own: Weights) -> Values:
    product: Values = x @ own["weight"].T
    return product + own["bias"] if "bias" in own else product


def _batch_norm(layer: BatchNorm, x: Values, own: Weights) -> Values:
    scale = own["weight"] / np.sqrt(own["running_var"] + np.float32(layer.epsilon))
    each = (-1,) + (1,) * (x.ndim - 2)
    centred = x - own["running_mean"].reshape(each)
    normal: Values = centred * scale.reshape(each) + own["bias"].reshape(each)
    return normal


def _layer_norm(layer: LayerNorm, x: Values, own: Weights) -> Values:
    axes = tuple(range(1, x.ndim))
    centred = x - x.mean(axis=axes, keepdims=True)
    variance = np.square(centred).mean(axis=axes, keepdims=True)
    normal: Values = centred / np.sqrt(variance + np.float32(layer.epsilon))
    return normal * own["weight"] + own["bias"] if own else normal


def _affine(layer: Affine, x: Values, _: Weights) -> Values:
    # As torch does, in the type of what comes in.
    scaled: Values = x * x.dtype.type(layer.scale) + x.dtype.type(layer.offset)
    return scaled


def _relu(_: ReLU, x: Values, __: Weights) -> Values:
    return np.maximum(x, 0)


def _gelu(_: GELU, x: Values, __: Weights) -> Values:
    one = x.dtype.type
    curve = np.tanh(one(math.sqrt(2 / math.pi)) * (x + one(0.044715) * x * x * x))
    passed: Values = x * (one(0.5) + one(0.5) * curve)
    return passed


def _as_it_is(_: Dropout, x: Values, __: Weights) -> Values:
    return x


def _flatten(_: Flatten, x: Values, __: Weights) -> Values:
    return x.reshape(len(x), math.prod(x.shape[1:]))


def _reshape(layer: Reshape, x: Values, _: Weights) -> Values:
    return x.reshape(len(x), *layer.shape)


def _resize(layer: Resize, x: Values, _: Weights) -> Values:
    """Images whose rows and columns are each multiplied by a matrix of their own."""
    down, across = interpolation(layer.rows, x.shape[2]), interpolation(layer.columns, x.shape[3])
    result: Values = down.astype(x.dtype) @ x @ across.astype(x.dtype).T
    return result


def interpolation(new: int, old: int) -> Values:
    """Linear interpolation between pixels' centres, (new, old); what is outside is the edge."""
    place = np.clip((np.arange(new) + 0.5) * (old / new) - 0.5, 0, old - 1)
    shares: Values = np.maximum(0, 1 - np.abs(place[:, None] - np.arange(old)))
    return shares


def _conv2d(layer: Conv2d, x: Values, own: Weights) -> Values:
    """By unfolding: every pixel as often as a kernel sees it, then one product for each group."""
    side, groups = layer.kernel, layer.groups
    edge = (layer.padding, layer.padding)
    padded = np.pad(x, ((0, 0), (0, 0), edge, edge))
    seen = np.lib.stride_tricks.sliding_window_view(padded, (side, side), axis=(2, 3))
    seen = seen[:, :, :: layer.stride, :: layer.stride]
    rows, columns = seen.shape[2:4]
    taps = layer.inputs // groups * side**2
    unfolded = seen.transpose(0, 1, 4, 5, 2, 3).reshape(len(x), groups, taps, rows * columns)
    kernels = own["weight"].reshape(groups, layer.outputs // groups, taps)
    images: Values = (kernels @ unfolded).reshape(len(x), layer.outputs, rows, columns)
    if "bias" in own:
        images += own["bias"][:, None, None]
    return images


def _max_pool(layer: MaxPool, x: Values, _: Weights) -> Values:
    side = layer.kernel
    rows, columns = x.shape[2] // side, x.shape[3] // side
    whole = x[:, :, : rows * side, : columns * side]
    # One comparison of whole planes for each place in a square.
    places = itertools.product(range(side), repeat=2)
    largest: Values = reduce(np.maximum, (whole[:, :, y::side, z::side] for y, z in places))
    return largest


def _global_max_pool(_: GlobalMaxPool, x: Values, __: Weights) -> Values:
    largest: Values = x.max(axis=(2, 3))
    return largest


_COMPUTED: Mapping[str, Callable[[Any, Values, Weights], Values]] = {
    "linear": _linear,
    "batch_norm": _batch_norm,
    "layer_norm": _layer_norm,
    "affine": _affine,
    "relu": _relu,
    "gelu": _gelu,
    "dropout": _as_it_is,
    "flatten": _flatten,
    "reshape": _reshape,
    "resize": _resize,
    "conv2d": _conv2d,
    "max_pool": _max_pool,
    "global_max_pool": _global_max_pool,
}
"""What each kind of layer does to a batch, but for the residual one."""
