"""Metrics give what their definitions say, on cases that can be worked out by hand."""

import math

import numpy as np
import pytest
import torch

from veilcam_training.attacks.metrics import (
    auc,
    mean_picture_advantage,
    psnr,
    ssim,
    true_accept_rate,
)
from veilcam_training.errors import TrainingError


def test_psnr_is_ten_times_the_logarithm_of_peak_over_error_of_each_picture() -> None:
    truth = torch.full((3, 12, 12), 0.5)
    estimate = truth + torch.tensor([0.1, 0.01, 0.0])[:, None, None]
    assert psnr(estimate, truth).tolist() == pytest.approx([20, 40, math.inf], abs=1e-3)
    assert psnr(estimate[:1], truth[:1], 2.0).item() == pytest.approx(20 + 20 * math.log10(2))
    # Pixels outside the range are shown at its ends.
    assert psnr(truth + 7, torch.ones(3, 12, 12)).tolist() == 3 * [math.inf]


def test_ssim_is_that_of_flat_pictures_in_closed_form() -> None:
    # Without structure only the term of means is left: (2 ab + c) / (a a + b b + c), c = .01^2.
    one, other = torch.full((2, 16, 16), 0.3), torch.full((2, 16, 16), 0.6)
    wanted = (2 * 0.18 + 1e-4) / (0.09 + 0.36 + 1e-4)
    assert ssim(one, other).tolist() == pytest.approx([wanted, wanted], rel=1e-3)
    assert ssim(one[:1], one[:1]).tolist() == pytest.approx([1.0])
    with pytest.raises(TrainingError, match="data_range"):
        ssim(one, other, 0)


def test_mean_picture_itself_has_no_advantage_and_the_truth_all_of_it() -> None:
    generator = torch.Generator().manual_seed(1)
    truth = torch.rand(4, 12, 12, generator=generator)
    mean = truth.mean(0)
    assert mean_picture_advantage(mean.expand_as(truth), truth, mean).abs().max() == 0
    assert (mean_picture_advantage(0.9 * truth + 0.1 * mean, truth, mean) > 15).all()


@pytest.mark.parametrize("shape", [(2, 12), (1, 12, 12), (0, 12, 12)])
def test_pictures_of_other_shapes_are_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(TrainingError, match="use the same three"):
        psnr(torch.zeros(shape), torch.zeros(2, 12, 12) if len(shape) > 1 else torch.zeros(shape))


def test_area_counts_ties_by_half() -> None:
    assert auc(torch.tensor([1.0, 1.0, 0.0, 2.0]), torch.tensor([0, 1, 0, 1])) == 0.875


def test_accept_rate_of_two_normals_is_that_of_their_distributions() -> None:
    random = np.random.default_rng(1)
    scores = torch.from_numpy(random.normal(np.repeat([2, 0], 40_000), 1))
    same = torch.arange(80_000) < 40_000
    # 1 - Phi(2.3263 - 2) = .3721; the quantile's error of 40,000 is .019 of a deviation.
    assert true_accept_rate(scores, same) == pytest.approx(0.3721, abs=0.03)
    assert true_accept_rate(torch.zeros(80_000), same) == 0


@pytest.mark.parametrize("far", [0.0, 1.0])
def test_rate_outside_its_range_is_refused(far: float) -> None:
    with pytest.raises(TrainingError, match="far"):
        true_accept_rate(torch.arange(4.0), torch.arange(4) < 2, far)
    with pytest.raises(TrainingError, match="either kind"):
        true_accept_rate(torch.arange(4.0), torch.arange(4) < 9)
