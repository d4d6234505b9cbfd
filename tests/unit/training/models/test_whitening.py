"""A layer fitted in decorrelated coordinates is the same function, learned faster."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor, nn

from veilcam_training.errors import TrainingError
from veilcam_training.models.classifiers import Task, make_layers
from veilcam_training.models.whitening import WhitenedWeights, plain, whiten


def measurements(count: int = 4000) -> Tensor:
    """Twelve numbers that show nearly the same: differences are up to 100 times smaller."""
    generator = torch.Generator().manual_seed(0)
    shared = torch.randn(count, 1, generator=generator)
    own = torch.randn(count, 12, generator=generator) * torch.logspace(-2, 0, 12)
    return 5 + shared + own


def test_inputs_of_a_layer_are_decorrelated_also_when_they_change() -> None:
    coordinates, before = WhitenedWeights(12), measurements()
    after = before.flip(1)
    assert before.T.corrcoef()[0, 1] > 0.9
    # What was 10,000 times the variance of what is there now takes its time to be forgotten.
    for values, times, error in ((before, 1, 0.15), (after, 15, 0.3)):
        for batch in values.repeat(times, 1).reshape(-1, 200, 12):
            coordinates.observe(batch, torch.zeros(1, 12))
        white = torch.cov((values @ coordinates.matrix).T)
        torch.testing.assert_close(white, torch.eye(12), atol=error, rtol=0)


def test_weights_learned_stay_when_coordinates_are_renewed() -> None:
    torch.manual_seed(0)
    coordinates, values, fitted = WhitenedWeights(12), measurements(), torch.randn(5, 12)
    chosen, renewed = 0, 0
    for number, batch in enumerate(values.reshape(-1, 20, 12), 1):
        matrix, weights = coordinates.matrix.clone(), coordinates(fitted)
        coordinates.observe(batch, fitted)
        if coordinates.matrix.equal(matrix):
            torch.testing.assert_close(coordinates(fitted), weights, rtol=0, atol=0)
        elif number > 4:
            renewed += 1
            torch.testing.assert_close(coordinates(fitted), weights, rtol=1e-4, atol=1e-4)
        else:
            chosen += 1
            assert not torch.allclose(coordinates(fitted), weights, rtol=0.1, atol=0.1)
    assert (chosen, renewed) == (3, 49)


def test_inputs_that_do_not_vary_do_no_harm() -> None:
    coordinates = WhitenedWeights(3)
    coordinates.observe(torch.ones(10, 3), torch.zeros(1, 3))
    assert coordinates.matrix.isfinite().all()


def test_plain_copy_acts_the_same() -> None:
    torch.manual_seed(0)
    classifier = nn.Sequential(nn.Linear(12, 5, bias=False), nn.BatchNorm1d(5), nn.Linear(5, 2))
    values = measurements()
    names, untouched = set(classifier.state_dict()), classifier.eval()(values)
    whiten(classifier)
    torch.testing.assert_close(classifier(values), untouched)
    classifier.train()
    classifier(values)
    classifier.eval()
    copied = plain(classifier)
    assert set(copied.state_dict()) == names
    assert (classifier(values) - untouched).abs().max() > 0.1
    torch.testing.assert_close(copied(values), classifier(values))
    before = classifier.state_dict()
    before = {name: tensor.clone() for name, tensor in before.items()}
    copied.train()(values.flip(1))
    assert all(tensor.equal(before[name]) for name, tensor in classifier.state_dict().items())


@pytest.mark.parametrize("name", ["LR", "CNN8", "VGG11"])
def test_whitening_needs_a_hidden_layer_that_takes_all(name: str) -> None:
    task = Task(1, 12, 16, 10, rectified=True, normalisation="white")
    with pytest.raises(TrainingError, match="use it with FC, not"):
        make_layers(name, task)
