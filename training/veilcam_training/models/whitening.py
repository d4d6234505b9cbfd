"""Fitting a first layer in coordinates in which its inputs are decorrelated.

The pixels of an embedding show nearly the same blurred scene: what tells two objects apart is in
differences between them a hundred times smaller than what they share, and a gradient step hardly
moves the weights along these. So the layer's weights are fitted as ``V M``, where ``M`` is the
inverse root of the inputs' covariance (ZCA whitening; Huang et al., Decorrelated Batch
Normalization, 2018, have it as a layer). Afterwards ``V M`` is a matrix like any other: the
classifier that leaves in a bundle has no more layers than before.
"""

import copy
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn.utils import parametrize

MOMENTUM = 0.05
"""Weight of a batch in the running covariance, once there were enough of them."""
FLOOR = 1e-6
"""Added to every variance, as a share of their mean."""


class WhitenedWeights(nn.Module):
    """``V M`` from ``V``; ``M`` follows the inputs that it is shown.

    The whitening matrix is symmetric, so it changes steadily where eigenvectors swap their places.
    It is renewed after 1, 2, 4, ... batches, which choose the coordinates that ``V`` was drawn in,
    and then often enough for a mask that is being learned: every ``inputs / 3`` batches, as an
    eigendecomposition costs the cube of ``inputs``. From then on ``V`` changes with ``M``, so that
    the layer goes on computing what it has learned.

    Args:
        inputs: inputs of the layer.
    """

    covariance: Tensor
    matrix: Tensor
    batches: Tensor

    def __init__(self, inputs: int) -> None:
        super().__init__()
        self._every = max(1, inputs // 3)
        self.register_buffer("covariance", torch.zeros(inputs, inputs))
        self.register_buffer("matrix", torch.eye(inputs))
        self.register_buffer("batches", torch.zeros((), dtype=torch.long))

    def forward(self, weights: Tensor) -> Tensor:
        """Weights (outputs, inputs) of the layer, from those that are fitted."""
        return weights @ self.matrix

    def right_inverse(self, weights: Tensor) -> Tensor:
        """Make the layer to fit, which begins as the given one."""
        return weights

    @torch.no_grad()
    def observe(self, inputs: Tensor, weights: Tensor) -> None:
        """Take a batch of inputs (batch, inputs) into account.

        Args:
            inputs: inputs of the layer.
            weights: ``V`` (outputs, inputs), changed in place where ``M`` is.
        """
        number = int(self.batches) + 1
        self.batches.fill_(number)
        centred = inputs - inputs.mean(0)
        share = max(MOMENTUM, 1 / number)
        self.covariance.lerp_(centred.T @ centred / len(inputs), share)
        choosing = number < self._every and number & (number - 1) == 0
        if not choosing and number % self._every:
            return
        # In float64: the variances span more than the digits of a float32.
        covariance = self.covariance.double()
        floor = FLOOR * covariance.diagonal().mean().clamp_min(torch.finfo(torch.float32).tiny)
        variances, directions = torch.linalg.eigh(covariance)
        roots = (variances.clamp_min(0) + floor).sqrt()
        if number > self._every:
            before = weights.double() @ self.matrix.double()
            weights.copy_(before @ (directions * roots) @ directions.T)
        self.matrix.copy_((directions / roots) @ directions.T)


def whiten(classifier: nn.Sequential) -> None:
    """Have the first fully connected layer of ``classifier`` fitted in white coordinates."""
    layer = next(layer for layer in classifier if isinstance(layer, nn.Linear))
    parametrize.register_parametrization(layer, "weight", WhitenedWeights(layer.in_features))
    layer.register_forward_pre_hook(_observe)


def _observe(layer: nn.Module, inputs: tuple[Tensor]) -> None:
    if layer.training:
        # Asked for anew each time: a copy of the layer has coordinates of its own.
        fitted = cast(
            parametrize.ParametrizationList, layer.get_submodule("parametrizations.weight")
        )
        cast(WhitenedWeights, fitted[0]).observe(inputs[0], fitted.original)


def plain(classifier: nn.Module) -> nn.Module:
    """Return a copy of ``classifier`` in which every layer has the weights that it acts with."""
    copied = copy.deepcopy(classifier)
    for name, layer in copied.named_children():
        if isinstance(layer, nn.Linear) and parametrize.is_parametrized(layer):
            # Not remove_parametrizations, which changes the class that the original has too.
            simple = nn.Linear(layer.in_features, layer.out_features, bias=layer.bias is not None)
            simple.train(layer.training)
            simple.weight = nn.Parameter(layer.weight.detach().clone())
            simple.bias = layer.bias
            setattr(copied, name, simple)
    return copied
