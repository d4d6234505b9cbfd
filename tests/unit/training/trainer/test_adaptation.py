"""Fine-tuning to a few inputs: what changes, how far, and who decides."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor, nn

from veilcam_training.errors import TrainingError
from veilcam_training.trainer.adaptation import FEW, KEPT, LADDER, Freedom, adapt, fine_tune

CLASSES, SIZE = 4, 12


@pytest.fixture
def classifier() -> nn.Sequential:
    """Reads inputs whose first four numbers say which class they are, and scales none of them."""
    torch.manual_seed(0)
    hidden, last = nn.Linear(SIZE, SIZE), nn.Linear(SIZE, CLASSES)
    with torch.no_grad():
        for layer in (hidden, last):
            layer.weight.copy_(3 * torch.eye(*layer.weight.shape))
            layer.bias.zero_()
    made = nn.Sequential(nn.BatchNorm1d(SIZE), hidden, nn.ReLU(), last)
    return made.requires_grad_(False).eval()


def inputs(count: int, seed: int = 1) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(seed)
    labels = torch.arange(count) % CLASSES
    noise = 0.3 * torch.randn(count, SIZE, generator=generator)
    return nn.functional.one_hot(labels, SIZE) + noise, labels


def accuracy(classifier: nn.Module, values: Tensor, labels: Tensor) -> float:
    return float((classifier(values).argmax(1) == labels).float().mean())


def distance(one: nn.Module, other: nn.Module) -> float:
    return sum(
        float((a - b).square().sum())
        for a, b in zip(one.parameters(), other.parameters(), strict=True)
    )


@pytest.mark.parametrize("count", [FEW, 40])
def test_camera_that_turns_numbers_around_is_learned(classifier: nn.Sequential, count: int) -> None:
    values, labels = inputs(count)
    others, truth = inputs(400, seed=2)
    assert accuracy(classifier, others, truth) > 0.9
    assert accuracy(classifier, others.flip(1), truth) < 0.5
    found = adapt(classifier, values.flip(1), labels)
    assert found.chosen.freedom != KEPT
    assert found.chosen.loss == min(trial.loss for trial in found.trials)
    assert [trial.freedom for trial in found.trials] == list(LADDER)
    assert accuracy(found.classifier, others.flip(1), truth) > 0.8


def test_classifier_that_reads_what_is_measured_is_kept(classifier: nn.Sequential) -> None:
    with torch.no_grad():
        for weights in classifier[3].parameters():
            weights.mul_(3)  # as sure as it may be
    values, labels = inputs(12)
    found = adapt(classifier, values + 0.5 * nn.functional.one_hot(labels, SIZE), labels)
    assert found.chosen.freedom == KEPT
    assert distance(found.classifier, classifier) == 0
    # The trial of what is kept is the classifier itself.
    values, labels = inputs(30)
    kept = adapt(classifier, values, labels).trials[0]
    assert kept.accuracy == pytest.approx(accuracy(classifier, values, labels))
    loss = nn.functional.cross_entropy(classifier(values), labels)
    assert kept.loss == pytest.approx(float(loss), rel=1e-5)
    for count in (0, 1):
        with pytest.raises(TrainingError, match="collect at least 2"):
            adapt(classifier, *inputs(count))
    assert adapt(classifier, *inputs(2)).trials


def test_captures_left_out_are_not_seen() -> None:
    # Nothing can be learned of one such input from the others, but each by heart.
    generator = torch.Generator().manual_seed(4)
    values, labels = torch.randn(60, 200, generator=generator), torch.arange(60) % CLASSES
    linear = nn.Linear(200, CLASSES).requires_grad_(False)
    classifier = nn.Sequential(linear).eval()
    whole = fine_tune(classifier, Freedom("all"), values, labels)
    assert accuracy(whole, values, labels) > 0.9
    found = adapt(classifier, values, labels)
    # Chance is 0.25; four standard deviations of 60 draws are 0.22.
    assert max(trial.accuracy for trial in found.trials) < 0.25 + 0.22


def test_what_is_held_moves_less_and_more_inputs_hold_less(classifier: nn.Sequential) -> None:
    values, labels = inputs(40)
    moved = [
        distance(fine_tune(classifier, Freedom("all", held), values.flip(1), labels), classifier)
        for held in (0.0, 1.0, 100.0)
    ]
    assert moved[0] > moved[1] > moved[2] > 0
    few = fine_tune(classifier, Freedom("all", 10.0), values[:8].flip(1), labels[:8])
    many = fine_tune(classifier, Freedom("all", 10.0), values.flip(1), labels)
    assert distance(few, classifier) < distance(many, classifier)


def test_last_layer_alone_changes_where_it_alone_may(classifier: nn.Sequential) -> None:
    before = {name: each.clone() for name, each in classifier.state_dict().items()}
    values, labels = inputs(20)
    # Means and variances stay: a few measurements have none to speak of.
    everything = {name for name, _ in classifier.named_parameters()}
    last, free = Freedom("last"), Freedom("all")
    for freedom, wanted in ((last, {"3.weight", "3.bias"}), (free, everything)):
        tuned = fine_tune(classifier, freedom, values.flip(1), labels)
        state = tuned.state_dict().items()
        assert {name for name, each in state if not torch.equal(each, before[name])} == wanted
    assert not any(each.requires_grad for each in tuned.parameters())
    for name, each in classifier.state_dict().items():
        assert torch.equal(each, before[name])


def test_seed_alone_decides_what_is_left_out_and_the_order(classifier: nn.Sequential) -> None:
    values, labels = inputs(250)  # more than a step takes
    first, same, other = (
        adapt(classifier, values.flip(1), labels, seed=seed) for seed in (5, 5, 6)
    )
    assert first.trials == same.trials
    assert distance(first.classifier, same.classifier) == 0
    assert first.trials != other.trials
    assert distance(first.classifier, other.classifier) > 0
