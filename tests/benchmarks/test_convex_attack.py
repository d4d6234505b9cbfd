"""Convex recovery: its operator, its certificates, and that it wins where something is told."""

from __future__ import annotations

import pytest
import torch
from benchmarks.privacy.paper.convex_attack import (
    BinnedConvolution,
    Normal,
    descend,
    differences,
    psf_samples,
)
from torch import Tensor

SCENE, EMBEDDING, SIDE, BINNING = (8, 6), (10, 9), 2, (3, 2)


def random_psf(generator: torch.Generator, embedding: tuple[int, int] = EMBEDDING) -> Tensor:
    samples = psf_samples(SCENE, embedding, side=SIDE, binning=BINNING)
    return torch.rand(samples, generator=generator) ** 8


def camera(seed: int, embedding: tuple[int, int] = EMBEDDING) -> BinnedConvolution:
    psf = random_psf(torch.Generator().manual_seed(seed), embedding)
    return BinnedConvolution(psf, SCENE, embedding, side=SIDE, binning=BINNING)


def pictures(count: int, seed: int) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    scenes = torch.zeros(count, *SCENE)
    for scene in scenes:
        top, left = (int(torch.randint(4, (), generator=generator)) for _ in range(2))
        scene[top : top + 4, left : left + 3] = 1
    return scenes


@pytest.mark.slow
def test_measurement_is_a_convolution_of_the_inverted_scene_and_an_average() -> None:
    psf = random_psf(torch.Generator().manual_seed(1))
    taken = BinnedConvolution(psf, SCENE, EMBEDDING, side=SIDE, binning=BINNING)
    scene = torch.rand(1, *SCENE, generator=torch.Generator().manual_seed(2))
    # Every scene pixel is SIDE samples wide and lies upside down; sensor samples add up.
    plane = scene[0].flip(0, 1).repeat_interleave(SIDE, 0).repeat_interleave(SIDE, 1)
    rows, columns = (EMBEDDING[axis] * BINNING[axis] for axis in range(2))
    image = torch.zeros(rows, columns)
    for u in range(rows):
        for v in range(columns):
            # The sensor sample at u gets light of plane[t] through psf[u - t + R - 1].
            window = psf[u : u + plane.shape[0], v : v + plane.shape[1]].flip(0, 1)
            image[u, v] = (plane * window).sum()
    binned = image.reshape(EMBEDDING[0], BINNING[0], EMBEDDING[1], BINNING[1]).mean((1, 3))
    expected = binned / plane.numel()  # an all-white scene without a mask is 1
    torch.testing.assert_close(taken.forward(scene)[0], expected)
    torch.testing.assert_close(scene.flatten(1) @ taken.matrix(), expected.reshape(1, -1))


def objective(normal: Normal, embeddings: Tensor, scenes: Tensor, variation: float) -> Tensor:
    """As the module says it, in float64; a share of that of a black scene."""
    matrix = normal.camera.matrix().double()
    slope = (embeddings.flatten(1).double() @ matrix.T).amax(1)
    residual = embeddings.flatten(1).double() - scenes.flatten(1).double() @ matrix
    lengths = differences(scenes.double()).square().sum(0).sqrt().sum((1, 2))
    value = residual.square().sum(1) / 2 + variation * slope * lengths
    return value / (embeddings.double().square().sum((1, 2)) / 2)


@pytest.mark.slow
@pytest.mark.parametrize("variation", [0.0, 1e-2])
def test_gap_bounds_how_far_the_descent_is(variation: float) -> None:
    normal = Normal(camera(1))
    embeddings = normal.camera.forward(pictures(2, 1))
    noise = torch.randn(embeddings.shape, generator=torch.Generator().manual_seed(4))
    embeddings = embeddings + 0.05 * embeddings.mean() * noise
    found = list(descend(normal, embeddings, variation, (5, 50, 1000)))
    values = [objective(normal, embeddings, each.scenes, variation) for each in found]
    for value, each in zip(values, found, strict=True):
        # Both are of float32 numbers of size 1.
        assert bool((value - values[-1] <= each.gap.double() + 1e-5).all())
        assert bool((each.scenes >= 0).all())
    # An accelerated method's error falls as 1 / n^2: from 5 to 1,000 steps far more than tenfold.
    assert bool((found[-1].gap < found[0].gap / 10).all())
    assert bool((found[-1].gap < 1e-3).all())
