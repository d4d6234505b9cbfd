"""Generators learn pictures from pairs where embeddings tell them, and else nothing."""

from __future__ import annotations

import pytest
import torch
from benchmarks.privacy.paper.generator_attack import (
    PAPER,
    Design,
    GeneratorTrial,
    PlaintextPairs,
    build_generator,
    fit_generator,
    paper_trial,
)
from torch import Tensor

from veilcam_training.attacks.metrics import mean_picture_advantage

SHAPE = (8, 12)
SMALL = Design((32,), 4, 2)


def pictures(count: int, seed: int) -> tuple[Tensor, Tensor]:
    """Ramps of any direction and strength, and the two numbers that say which."""
    generator = torch.Generator().manual_seed(seed)
    slopes = torch.rand(count, 2, generator=generator) - 0.5
    y, x = (torch.linspace(-1, 1, side) for side in SHAPE)
    ramps = slopes[:, :1, None] * y[:, None] + slopes[:, 1:, None] * x
    return 0.5 + 0.5 * ramps, slopes


def telling(count: int, seed: int) -> PlaintextPairs:
    """Embeddings that are pictures behind one mask: a matrix."""
    scenes, _ = pictures(count, seed)
    transfer = torch.rand(scenes[0].numel(), 20, generator=torch.Generator().manual_seed(0))
    return PlaintextPairs(scenes.flatten(1) @ transfer, scenes)


@pytest.mark.slow
def test_network_of_the_paper_has_its_layers() -> None:
    with torch.device("meta"):
        network = build_generator(PAPER, 768, (218, 178))
        found = network(torch.zeros(2, 768))
    assert found.shape == (2, 1, 218, 178)
    full = [each for each in network if isinstance(each, torch.nn.Linear)]
    assert [each.out_features for each in full] == [10_000, 19_008]
    assert PAPER.start((218, 178)) == (27, 22)
    kinds = [type(each).__name__ for each in network]
    assert kinds.count("Conv2d") == kinds.count("BatchNorm2d") + 1 == 3
    assert kinds[-1] == "Sigmoid"
    assert [paper_trial(n, 5).batch for n in (100, 1000, 10_000, 100_000)] == [4, 16, 32, 32]
    assert (paper_trial(100, 5).optimiser, paper_trial(100, 5).rate) == ("sgd", 0.01)


@pytest.mark.slow
def test_generator_learns_pictures_from_telling_embeddings() -> None:
    """Two numbers make the picture, and both are in the embedding: the attack has to win."""
    test = telling(200, 3)
    trial = GeneratorTrial(rate=3e-3, batch=16, epochs=30)
    fitted = fit_generator(telling(300, 1), telling(50, 2), SMALL, trial)
    gained = mean_picture_advantage(
        fitted.estimate(test.embeddings), test.pictures, test.pictures.mean(0)
    )
    # 6 dB are a quarter of the mean picture's squared error.
    assert float(gained.mean()) > 6
    assert 1 <= fitted.epochs <= 30


@pytest.mark.slow
def test_generator_gains_nothing_from_silent_embeddings() -> None:
    """Embeddings are directions that have nothing to do with pictures.

    Of pictures that were drawn independently of what is estimated, the mean picture of their
    distribution has the least expected error; over 2,000 pictures the difference is normal, and
    four standard errors are passed once in 30,000 times.
    """

    def silent(count: int, seed: int) -> PlaintextPairs:
        scenes, _ = pictures(count, seed)
        drawn = torch.randn(count, 20, generator=torch.Generator().manual_seed(100 + seed))
        return PlaintextPairs(drawn / drawn.norm(dim=1, keepdim=True), scenes)

    fitted = fit_generator(
        silent(300, 1), silent(50, 2), SMALL, GeneratorTrial(batch=16, epochs=10)
    )
    test = silent(2000, 3)
    found = (fitted.estimate(test.embeddings) - test.pictures).square().mean((1, 2))
    mean = (torch.full(SHAPE, 0.5) - test.pictures).square().mean((1, 2))
    gained = mean - found
    assert float(gained.mean()) < 4 * float(gained.std()) / 2000**0.5
