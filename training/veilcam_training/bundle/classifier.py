"""From layer records and weights to a torch module, with every mismatch found first."""

import math
from collections.abc import Mapping, Sequence

import torch
from torch import Tensor, nn

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


def build_untrained(layers: Sequence[LayerRecord]) -> nn.Sequential:
    """A new module with random parameters, in training mode."""
    return nn.Sequential(*(layer.module() for layer in layers))


def build_classifier(layers: Sequence[LayerRecord], weights: Mapping[str, Tensor]) -> nn.Module:
    """The classifier that ``layers`` and ``weights`` describe, in evaluation mode.

    Args:
        layers: records in order.
        weights: by the names of the module's ``state_dict``; they are copied.

    Returns:
        A module from (batch, embedding.size) float32 to logits (batch, labels).

    Raises:
        BundleError: names, shapes, types or values that do not fit the layers.
    """
    # On the meta device a module has shapes but no numbers: a lying record costs no memory.
    with torch.device("meta"):
        module = build_untrained(layers)
    check_weights(module, weights)
    module.load_state_dict(
        {name: tensor.detach().clone() for name, tensor in weights.items()}, assign=True
    )
    return module.requires_grad_(False).eval()


def check_weights(module: nn.Module, weights: Mapping[str, Tensor]) -> None:
    """Raise :class:`BundleError` unless ``weights`` are exactly what ``module`` needs.

    Messages name tensors but hold no number of theirs.
    """
    expected = module.state_dict()
    total = sum(math.prod(tensor.shape) for tensor in expected.values())
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
    for name, wanted in expected.items():
        tensor = weights[name]
        require(
            tensor.shape == wanted.shape and tensor.dtype == wanted.dtype,
            f"weight {name!r} is {tensor.dtype} {tuple(tensor.shape)}: "
            f"use {wanted.dtype} {tuple(wanted.shape)}",
        )
        require(
            bool(torch.isfinite(tensor).all()),
            f"weight {name!r} holds NaN or infinity: train it again",
        )
        require(
            not (name.endswith("running_var") and (tensor < 0).any()),
            f"weight {name!r} holds a negative variance: train it again",
        )
