"""Classifiers as modules of torch, from layer records: what is fitted, and goes into bundles."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy.typing as npt
import torch
from torch import Tensor, nn

from veilcam_training.bundle import layers as records
from veilcam_training.bundle.classifier import check_weights
from veilcam_training.bundle.layers import LayerRecord


def build_untrained(layers: Sequence[LayerRecord]) -> nn.Sequential:
    """Return a new module with random parameters, in training mode."""
    return nn.Sequential(*(_module(layer) for layer in layers))


def build_classifier(
    layers: Sequence[LayerRecord], weights: Mapping[str, npt.NDArray[Any]]
) -> nn.Module:
    """Make the classifier that ``layers`` and ``weights`` describe, in evaluation mode.

    Args:
        layers: records in order.
        weights: weights by the names of the module's ``state_dict``; they are copied.

    Returns:
        A module from (batch, embedding.size) float32 to logits (batch, labels).

    Raises:
        BundleError: names, shapes, types or values that do not fit the layers.
    """
    check_weights(layers, weights)
    with torch.device("meta"):  # random numbers that nobody sees are not drawn
        module = build_untrained(layers)
    module.load_state_dict(
        {name: torch.tensor(array) for name, array in weights.items()}, assign=True
    )
    return module.requires_grad_(False).eval()


def weights_of(module: nn.Module) -> dict[str, npt.NDArray[Any]]:
    """Return copies of all that ``module`` has learned, as a bundle holds it."""
    return {name: tensor.numpy(force=True).copy() for name, tensor in module.state_dict().items()}


def _module(layer: LayerRecord) -> nn.Module:  # noqa: PLR0911 - one line for each kind of layer
    match layer:
        case records.Linear():
            return nn.Linear(layer.inputs, layer.outputs, bias=layer.bias)
        case records.BatchNorm():
            kind = nn.BatchNorm1d if layer.dimensions == 1 else nn.BatchNorm2d
            return kind(layer.features, eps=layer.epsilon)
        case records.LayerNorm():
            return nn.LayerNorm(layer.shape, eps=layer.epsilon, elementwise_affine=layer.affine)
        case records.Affine():
            return AffineModule(layer.scale, layer.offset)
        case records.Conv2d():
            return nn.Conv2d(
                layer.inputs,
                layer.outputs,
                layer.kernel,
                stride=layer.stride,
                padding=layer.padding,
                groups=layer.groups,
                bias=layer.bias,
            )
        case records.Residual():
            return ResidualModule(*(_module(inner) for inner in layer.layers))
        case _:
            return _without_parameters(layer)


def _without_parameters(layer: LayerRecord) -> nn.Module:  # noqa: PLR0911 - as above
    match layer:
        case records.ReLU():
            return nn.ReLU()
        case records.GELU():
            return nn.GELU(approximate="tanh")
        case records.Dropout():
            return nn.Dropout(layer.probability)
        case records.Flatten():
            return nn.Flatten()
        case records.Reshape():
            return nn.Unflatten(1, layer.shape)
        case records.Resize():
            return nn.Upsample((layer.rows, layer.columns), mode="bilinear")
        case records.MaxPool():
            return nn.MaxPool2d(layer.kernel)
        case records.GlobalMaxPool():
            return nn.Sequential(nn.AdaptiveMaxPool2d(1), nn.Flatten())
        case _:
            raise TypeError(f"no module is known for a layer of kind {layer.kind!r}")


class AffineModule(nn.Module):
    """``scale * x + offset``."""

    def __init__(self, scale: float, offset: float) -> None:
        super().__init__()
        self.scale, self.offset = scale, offset

    def forward(self, x: Tensor) -> Tensor:
        """Apply it to a tensor of any shape."""
        return torch.add(x * self.scale, self.offset)


class ResidualModule(nn.Module):
    """``x + layers(x)``."""

    def __init__(self, *layers: nn.Module) -> None:
        super().__init__()
        self.layers = nn.Sequential(*layers)

    def forward(self, x: Tensor) -> Tensor:
        """Apply it to a tensor of any shape that the layers take."""
        return torch.add(x, self.layers(x))
