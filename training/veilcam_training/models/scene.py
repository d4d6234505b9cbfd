"""Start of a scene classifier: its computed first layer, and the weights it is fitted from.

After airbench (Jordan, "94% on CIFAR-10 in 3.29 seconds on a single GPU", arXiv:2404.00498).
"""

import torch
from torch import Tensor, nn
from torch.nn.functional import cross_entropy, unfold

SCENES = 5000
"""Scenes that the whitening is computed from, at most."""
FLOOR = 5e-4
"""Added to every variance of a patch, where a pixel's is 1."""
MOMENTUM = 0.4
"""Of the running means of batch normalisation, per step."""


@torch.no_grad()
def begin(classifier: nn.Sequential, scenes: Tensor) -> None:
    """Set the first weights of a ``Scene<width>``, in place.

    The first convolution decorrelates patches and is not fitted. The others begin as identities,
    as far as they have as many inputs. Batch normalisation is fitted in its biases alone.

    Args:
        classifier: layers from the ``Reshape`` on, fresh.
        scenes: estimated scenes, (count, values).
    """
    white = next(layer for layer in classifier if isinstance(layer, nn.Conv2d))
    images = classifier[0](scenes[:SCENES].float())
    deviation, mean = torch.std_mean(images, (0, 2, 3), keepdim=True)
    side = white.kernel_size[0]
    patches = unfold((images - mean) / deviation, side).transpose(1, 2).flatten(0, 1)
    variances, directions = torch.linalg.eigh(patches.T @ patches / len(patches))
    whitening = (directions.flip(1) / (variances.flip(0) + FLOOR).sqrt()).T
    whitening = whitening.reshape(-1, *white.weight.shape[1:])
    white.weight.copy_(torch.cat([whitening, -whitening]))
    white.weight.requires_grad_(False)
    if white.bias is not None:
        white.bias.zero_()
    for layer in classifier.children():
        if isinstance(layer, nn.Conv2d) and layer is not white:
            nn.init.dirac_(layer.weight[: layer.in_channels])
        elif isinstance(layer, nn.BatchNorm2d) and layer is not classifier[1]:
            layer.weight.requires_grad_(False)
            layer.momentum = MOMENTUM


def confidence_factor(logits: Tensor, labels: Tensor) -> float:
    """Return the factor on logits that makes their confidence right.

    A fit with smoothed labels is less sure than it is right. The factor has the least cross entropy
    (Guo et al., "On Calibration of Modern Neural Networks", ICML 2017), and changes no label.

    Args:
        logits: logits that were not fitted to, (count, classes).
        labels: int64 (count,).
    """
    factors = torch.logspace(-0.5, 1, 61, device=logits.device)
    losses = torch.stack([cross_entropy(factor * logits, labels) for factor in factors])
    return float(f"{factors[losses.argmin()].item():.3g}")
