"""Fine-tuning of a fitted classifier to a few labelled inputs, held back by what it was before.

What is minimised is the cross-entropy of the inputs plus ``strength`` times the squared distance of
the weights from those they had (L2-SP; Li, Grandvalet and Davoine, "Explicit inductive bias for
transfer learning with convolutional networks", ICML 2018), per input: the more of them there are,
the less the former weights count. Which weights may change, and how strongly they are held back, is
chosen by cross-validation among the inputs, and a classifier that no choice makes better is kept.
"""

import copy
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from veilcam_training.errors import require
from veilcam_training.seeding import stream

FEW = 20
"""Up to so many inputs, each is left out once."""
FOLDS = 5
"""Otherwise; each fifth is left out once."""
STEPS = 60
BATCH = 200
"""Largest of a step."""
RATE = 5e-3
"""Of Adam."""


@dataclass(frozen=True)
class Freedom:
    """Parameters of a classifier that may change.

    Attributes:
        weights: ``none``, those of the ``last`` layer that has any, or ``all``.
        strength: strength with which they are held where they were; >= 0.
    """

    weights: Literal["none", "last", "all"]
    strength: float = 0.0

    def __str__(self) -> str:
        return self.weights if self.weights == "none" else f"{self.weights}, held {self.strength:g}"


KEPT = Freedom("none")
LADDER = (KEPT, Freedom("last", 0.1), Freedom("all", 1.0))
"""From the least to the most."""


@dataclass(frozen=True)
class Trial:
    """Result of one freedom on inputs that were left out."""

    freedom: Freedom
    loss: float
    """Mean cross-entropy [nat]."""
    accuracy: float
    """Share of right labels, in [0, 1]."""


@dataclass(frozen=True)
class Adapted:
    """A classifier after it was adapted."""

    classifier: nn.Module
    trials: tuple[Trial, ...]
    """Of every freedom, in the order of :data:`LADDER`."""
    chosen: Trial
    """The one with the least loss."""


def adapt(classifier: nn.Module, inputs: Tensor, labels: Tensor, *, seed: int = 0) -> Adapted:
    """Fine-tune a copy of a classifier, as freely as the inputs themselves speak for.

    Args:
        classifier: a ``Sequential`` in evaluation mode; it stays as it is.
        inputs: float32 (count, inputs).
        labels: int64 (count,), from 0 on.
        seed: seed of the parts that are left out together, and of the order of steps.

    Raises:
        TrainingError: there are fewer than two inputs.
    """
    require(
        len(inputs) >= 2,
        f"{len(inputs)} measurements are too few to adapt with: collect at least 2",
    )
    trials = tuple(_trial(classifier, freedom, inputs, labels, seed) for freedom in LADDER)
    chosen = min(trials, key=lambda trial: trial.loss)
    tuned = fine_tune(classifier, chosen.freedom, inputs, labels, seed=seed)
    return Adapted(tuned, trials, chosen)


def fine_tune(
    classifier: nn.Module, freedom: Freedom, inputs: Tensor, labels: Tensor, *, seed: int = 0
) -> nn.Module:
    """Return a copy of ``classifier`` after its fit to inputs, in evaluation mode.

    Running statistics of batch normalisation stay: a few measurements have none to speak of.
    """
    tuned = copy.deepcopy(classifier).eval()
    free = list(_free(tuned, freedom))
    if not free:
        return tuned
    for weights in free:
        weights.requires_grad_(True)
    before = [weights.detach().clone() for weights in free]
    optimiser = torch.optim.Adam(free, RATE)
    batches = _batches(len(inputs), stream(seed, "adapt"))
    held = freedom.strength / len(inputs)
    for _ in range(STEPS):
        chosen = next(batches)
        loss = functional.cross_entropy(tuned(inputs[chosen]), labels[chosen])
        for weights, gradient, former in zip(
            free, torch.autograd.grad(loss, free), before, strict=True
        ):
            weights.grad = gradient.add_(weights.detach() - former, alpha=2 * held)
        optimiser.step()
    return tuned.requires_grad_(False)


def _free(classifier: nn.Module, freedom: Freedom) -> Iterator[nn.Parameter]:
    if freedom.weights == "all":
        yield from classifier.parameters()
    elif freedom.weights == "last":
        *_, last = (layer for layer in classifier.children() if list(layer.parameters()))
        yield from last.parameters()


def _batches(count: int, generator: torch.Generator) -> Iterator[Tensor]:
    """Places of inputs, all of them where they fit into a step."""
    while True:
        order = torch.randperm(count, generator=generator)
        if count <= BATCH:
            yield order
        else:
            yield from (part for part in torch.split(order, BATCH) if len(part) == BATCH)


def _trial(
    classifier: nn.Module, freedom: Freedom, inputs: Tensor, labels: Tensor, seed: int
) -> Trial:
    logits = torch.empty(0)
    for left_out in _left_out(labels, stream(seed, "folds")):
        tuned = fine_tune(classifier, freedom, inputs[~left_out], labels[~left_out], seed=seed)
        with torch.no_grad():
            found = tuned(inputs[left_out])
        if not len(logits):
            logits = found.new_empty(len(inputs), found.shape[1])
        logits[left_out] = found
    right = (logits.argmax(1) == labels).float().mean()
    return Trial(freedom, float(functional.cross_entropy(logits, labels)), float(right))


def _left_out(labels: Tensor, generator: torch.Generator) -> Sequence[Tensor]:
    """Masks of inputs that are left out together, each input once, and classes spread evenly."""
    count = len(labels)
    folds = count if count <= FEW else FOLDS
    order = torch.randperm(count, generator=generator)
    order = order[labels[order].argsort(stable=True)]
    fold = torch.empty(count, dtype=torch.int64)
    fold[order] = torch.arange(count) % folds
    return [fold == number for number in range(folds)]
