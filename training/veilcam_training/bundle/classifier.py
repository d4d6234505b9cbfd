"""Layer records that follow one another, and weights for them: every mismatch is found first."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from veilcam_training.bundle.errors import BundleError, require
from veilcam_training.bundle.layers import (
    LayerRecord,
    LayerShapeError,
    Shape,
    checked_shape,
    operations,
)

MAX_LAYERS = 128
MAX_PARAMETERS = 2**27


def output_shape(layers: Sequence[LayerRecord], inputs: int) -> Shape:
    """Shape of one sample after ``layers``, for ``inputs`` numbers going in.

    Raises:
        BundleError: two layers do not fit together.
    """
    require(
        1 <= len(layers) <= MAX_LAYERS,
        f"a classifier has {len(layers)} layers: use 1 to {MAX_LAYERS}",
    )
    shape: Shape = (inputs,)
    for index, layer in enumerate(layers):
        try:
            shape = checked_shape(layer, shape)
        except LayerShapeError as error:
            raise BundleError(f"layer {index} ({layer.kind}) {error}: train it again") from None
    return shape


def count_operations(layers: Sequence[LayerRecord], inputs: int) -> int:
    """Products that checked layers take for one sample of ``inputs`` numbers."""
    shape: Shape = (inputs,)
    total = 0
    for layer in layers:
        total += operations(layer, shape)
        shape = layer.output_shape(shape)
    return total


def check_weights(layers: Sequence[LayerRecord], weights: Mapping[str, npt.NDArray[Any]]) -> None:
    """Raise :class:`BundleError` unless ``weights`` are exactly what ``layers`` need.

    Messages name arrays but hold no number of theirs.
    """
    expected = {
        f"{index}.{name}": needed
        for index, layer in enumerate(layers)
        for name, needed in layer.parameters.items()
    }
    total = sum(math.prod(shape) for shape, _ in expected.values())
    require(
        total <= MAX_PARAMETERS,
        f"a classifier has {total} parameters: use at most {MAX_PARAMETERS}",
    )
    missing, unknown = (
        sorted(expected.keys() - weights.keys()),
        sorted(weights.keys() - expected.keys()),
    )
    if missing:
        raise BundleError(f"weights lack {missing[0]!r}: export the bundle again")
    if unknown:
        raise BundleError(f"weights hold unknown {unknown[0]!r}: export the bundle again")
    for name, (shape, dtype) in expected.items():
        array = weights[name]
        require(
            array.shape == shape and array.dtype == dtype,
            f"weight {name!r} is {array.dtype} {array.shape}: use {dtype} {shape}",
        )
        require(
            bool(np.isfinite(array).all()),
            f"weight {name!r} holds NaN or infinity: train it again",
        )
        require(
            not (name.endswith("running_var") and bool((array < 0).any())),
            f"weight {name!r} holds a negative variance: train it again",
        )
