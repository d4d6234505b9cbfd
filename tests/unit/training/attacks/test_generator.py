"""Generators learn pictures from pairs where embeddings tell them, and else nothing."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from veilcam_training.attacks.generator import (
    LIGHT,
    PAPER,
    Design,
    GeneratorTrial,
    PlaintextPairs,
    best_generator,
    build_generator,
    fit_generator,
    paper_trial,
)
from veilcam_training.attacks.metrics import mean_picture_advantage
from veilcam_training.errors import TrainingError

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
def test_the_papers_network_has_its_layers() -> None:
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


def test_pictures_of_any_size_come_out() -> None:
    for shape in ((64, 52), (28, 28), (7, 5)):
        found = build_generator(LIGHT, 12, shape)(torch.zeros(2, 12)).detach()
        assert found.shape == (2, 1, *shape)
        assert 0 <= float(found.min()) <= float(found.max()) <= 1


@pytest.mark.slow
def test_a_generator_learns_what_embeddings_tell() -> None:
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
def test_a_generator_gains_nothing_where_nothing_is_told() -> None:
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


def test_settings_change_the_fit_and_the_best_trial_is_taken() -> None:
    learned, check = telling(33, 1), telling(20, 2)  # batches of 16, 16 and 1
    slow = GeneratorTrial(rate=1e-7, batch=16, epochs=2)
    quick = GeneratorTrial(rate=1e-2, batch=16, epochs=4)
    told: list[tuple[int, int]] = []
    best = best_generator(learned, check, SMALL, [slow, quick], lambda *each: told.append(each))
    assert best.trial == quick
    assert told == [(1, 2), (2, 2)]
    again = fit_generator(learned, check, SMALL, quick, lambda *each: told.append(each))
    assert again.error == best.error
    assert told[-1] == (4, 4)
    for other in (replace(quick, seed=2), replace(quick, optimiser="sgd"), replace(quick, batch=8)):
        assert fit_generator(learned, check, SMALL, other).error != best.error
    with pytest.raises(TrainingError, match="no trial"):
        best_generator(learned, check, SMALL, [])
    with pytest.raises(TrainingError, match="1 pair cannot"):
        fit_generator(learned.take(torch.tensor([0])), check, SMALL, quick)
    with pytest.raises(TrainingError, match="2 embeddings but 1 pictures"):
        PlaintextPairs(torch.zeros(2, 3), torch.zeros(1, *SHAPE))
