"""Metrics of attacks: likeness of pictures, and separation of two kinds by scores.

Peak signal-to-noise ratio and structural similarity are torchmetrics', so that their numbers stand
beside those of others. The data range is always said: 1.0 is that of scenes in [0, 1].
"""

import torch
from torch import Tensor
from torchmetrics.functional.image import (
    peak_signal_noise_ratio,
    structural_similarity_index_measure,
)

from veilcam_training.attacks.intervals import area
from veilcam_training.errors import require


def psnr(estimate: Tensor, truth: Tensor, data_range: float = 1.0) -> Tensor:
    """Peak signal-to-noise ratio of every picture [dB], (count,); infinite where they are equal.

    Args:
        estimate: (count, rows, columns); clamped to the data range, as whoever shows it would.
        truth: true pictures of the same shape, from 0 to the data range.
        data_range: range of a pixel, from 0.

    Raises:
        TrainingError: pictures of different shapes, or none.
    """
    one, other = _pictures(estimate, truth, data_range)
    # A range as a pair has torchmetrics clamp both.
    found: Tensor = peak_signal_noise_ratio(
        one, other, data_range=(0.0, data_range), reduction="none", dim=(1, 2, 3)
    )
    return found


def ssim(estimate: Tensor, truth: Tensor, data_range: float = 1.0) -> Tensor:
    """Structural similarity of every picture, (count,) up to 1 (Wang et al. 2004).

    The window is the paper's, Gaussian with a deviation of 1.5 pixels. Arguments and errors are
    those of :func:`psnr`.
    """
    one, other = _pictures(estimate, truth, data_range)
    found = structural_similarity_index_measure(
        one, other, data_range=(0.0, data_range), reduction="none"
    )
    return torch.as_tensor(found).reshape(len(truth))


def mean_picture_advantage(
    estimate: Tensor, truth: Tensor, mean: Tensor, data_range: float = 1.0
) -> Tensor:
    """By how many dB every estimate is nearer to the truth than a picture known beforehand.

    Args:
        estimate: (count, rows, columns).
        truth: true pictures of the same shape.
        mean: (rows, columns), the best guess without any capture: the mean of such scenes.
        data_range: range of a pixel, from 0.

    Returns:
        (count,): 0 or below where the attack told nothing.
    """
    known = mean.expand_as(truth)
    return psnr(estimate, truth, data_range) - psnr(known, truth, data_range)


def auc(scores: Tensor, positive: Tensor) -> float:
    """Area under the curve of scores (count,) that are to be higher where ``positive`` is true.

    Raises:
        ValueError: fewer than two of either kind.
    """
    return area(scores.double().cpu().numpy(), positive.bool().cpu().numpy())[0]


def true_accept_rate(scores: Tensor, same: Tensor, far: float = 1e-2) -> float:
    """Share of same pairs that are accepted where a share ``far`` of others is.

    Args:
        scores: (pairs,), higher for more alike.
        same: bool (pairs,).
        far: false accept rate, in (0, 1).

    Raises:
        TrainingError: pairs of one kind alone, or a rate that is none.
    """
    require(0 < far < 1, f"far = {far} is not valid: use a share between 0 and 1")
    high, low = scores[same.bool()].double(), scores[~same.bool()].double()
    require(min(len(high), len(low)) > 0, "a rate needs pairs of either kind: give both")
    bar = torch.quantile(low, 1 - far)
    # At the bar itself as many are accepted as keep the rate: none that ties helps.
    return float((high > bar).double().mean())


def _pictures(estimate: Tensor, truth: Tensor, data_range: float) -> tuple[Tensor, Tensor]:
    require(
        estimate.shape == truth.shape and truth.ndim == 3 and truth.numel() > 0,
        f"pictures of {tuple(estimate.shape)} and {tuple(truth.shape)}: use the same three",
    )
    require(data_range > 0, f"data_range = {data_range} is not valid: use a number above 0")
    one, other = estimate[:, None].double(), truth[:, None].double()
    return one.clamp(0, data_range), other.clamp(0, data_range)
