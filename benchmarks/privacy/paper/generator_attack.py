"""Pictures from embeddings by a network that was fitted to pairs of both: a plaintext attack.

An attacker who holds some embeddings with the pictures that belong to them fits a generator, and
needs to know neither optics nor masks: E. Bezzam, M. Vetterli and M. Simeoni (2022), whose network
is ``PAPER``. ``LIGHT`` is the same with fewer numbers, for a processor without an accelerator.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn.functional import mse_loss

from veilcam_training.attacks.networks import Progress, judged
from veilcam_training.errors import require
from veilcam_training.seeding import seeded

Estimator = Callable[[Tensor], Tensor]
"""From embeddings (count, numbers) to pictures (count, rows, columns) in [0, 1]."""
Optimiser = Literal["sgd", "adam"]


@dataclass(frozen=True)
class PlaintextPairs:
    """Embeddings, and the pictures that belong to them."""

    embeddings: Tensor
    """(count, numbers)."""
    pictures: Tensor
    """(count, rows, columns), in [0, 1]."""

    def __post_init__(self) -> None:
        require(
            len(self.embeddings) == len(self.pictures) > 0,
            f"{len(self.embeddings)} embeddings but {len(self.pictures)} pictures: use one each",
        )

    def take(self, chosen: Tensor) -> "PlaintextPairs":
        """Return some of the pairs."""
        return PlaintextPairs(self.embeddings[chosen], self.pictures[chosen])


@dataclass(frozen=True)
class Design:
    """Layers of a generator.

    Fully connected ones, a reshape to ``channels`` small pictures, then ``stages`` times: twice as
    large, a convolution of 3 x 3, and batch normalisation with ReLU, or a sigmoid at the end.
    """

    hidden: tuple[int, ...]
    """Units of the fully connected layers but the last."""
    channels: int
    stages: int

    def start(self, shape: tuple[int, int]) -> tuple[int, int]:
        """Rows and columns of the small pictures, for pictures of ``shape``."""
        rows, columns = (max(1, round(side / 2**self.stages)) for side in shape)
        return rows, columns


PAPER = Design((10_000,), 32, 3)
"""218 x 178 pixels start at 27 x 22 in 32 channels: 19,008 numbers."""
LIGHT = Design((512,), 8, 2)


@dataclass(frozen=True)
class GeneratorTrial:
    """One way to fit a generator."""

    seed: int = 1
    """Of the first weights and the order of pairs."""
    optimiser: Optimiser = "adam"
    rate: float = 1e-3
    batch: int = 32
    epochs: int = 20


def paper_trial(pairs: int, epochs: int) -> GeneratorTrial:
    """Return the paper's trial: SGD at 0.01, and batches that grow with the pairs."""
    return GeneratorTrial(
        1, "sgd", 0.01, 4 if pairs <= 100 else 16 if pairs <= 1000 else 32, epochs
    )


def build_generator(design: Design, numbers: int, shape: tuple[int, int]) -> nn.Sequential:
    """Make the network, from (count, numbers) to (count, 1, rows, columns).

    Args:
        design: design of the layers.
        numbers: number of values of an embedding.
        shape: shape of a picture; the output is resized to it where doubling does not end at it.
    """
    rows, columns = design.start(shape)
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise((numbers, *design.hidden, design.channels * rows * columns)):
        layers += [nn.Linear(inputs, outputs, bias=False), nn.BatchNorm1d(outputs), nn.ReLU()]
    layers.append(nn.Unflatten(1, (design.channels, rows, columns)))
    for stage in range(design.stages):
        last = stage == design.stages - 1
        layers += [
            nn.Upsample(scale_factor=2),
            nn.Conv2d(design.channels, 1 if last else design.channels, 3, padding=1, bias=last),
        ]
        if not last:
            layers += [nn.BatchNorm2d(design.channels), nn.ReLU()]
    if (rows * 2**design.stages, columns * 2**design.stages) != shape:
        layers.append(nn.Upsample(shape, mode="bilinear"))
    return nn.Sequential(*layers, nn.Sigmoid())


@dataclass(frozen=True)
class FittedGenerator:
    """A generator, and how well it did on pairs that it did not learn from."""

    estimate: Estimator
    error: float
    """Mean squared error of the pairs that were set apart."""
    trial: GeneratorTrial
    epochs: int
    """After which it did best."""


def fit_generator(
    learned: PlaintextPairs,
    check: PlaintextPairs,
    design: Design,
    trial: GeneratorTrial,
    progress: Progress | None = None,
) -> FittedGenerator:
    """Fit a generator by the squared error; the epoch that does best on ``check`` counts.

    Args:
        learned: pairs that it is fitted to.
        check: pairs that tell when to stop.
        design: design of the layers.
        trial: settings of the fit. The rate falls to 0 as a half cosine.
        progress: function that is told the number of epochs done, and of all.

    Raises:
        TrainingError: fewer than two pairs to fit to.
    """
    require(len(learned.embeddings) > 1, "1 pair cannot be normalised: use two or more")
    centre = learned.embeddings.mean(0)
    scale = (learned.embeddings - centre).square().mean().sqrt().clamp_min(1e-12)
    shape = (learned.pictures.shape[1], learned.pictures.shape[2])
    steps = -(-len(learned.embeddings) // trial.batch) * trial.epochs
    with seeded(trial.seed, "generator"):
        network = build_generator(design, learned.embeddings.shape[1], shape)
        # Channels last halve the time of a step on a processor.
        network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

        def estimate(embeddings: Tensor) -> Tensor:
            network.eval()
            return judged(lambda part: network((part - centre) / scale)[:, 0], embeddings)

        optimiser = _optimiser(network, trial)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, steps)
        best, at, kept = float("inf"), 0, network.state_dict()
        for epoch in range(1, trial.epochs + 1):
            network.train()
            for part in torch.split(torch.randperm(len(learned.embeddings)), trial.batch):
                # A batch of one has no variance to normalise by.
                chosen = part if len(part) > 1 else part.expand(2)
                inputs = (learned.embeddings[chosen] - centre) / scale
                optimiser.zero_grad()
                loss = mse_loss(network(inputs)[:, 0], learned.pictures[chosen])
                loss.backward()  # type: ignore[no-untyped-call]
                optimiser.step()
                schedule.step()
            found = float(mse_loss(estimate(check.embeddings), check.pictures))
            if found < best:
                best, at = found, epoch
                kept = {name: value.clone() for name, value in network.state_dict().items()}
            if progress is not None:
                progress(epoch, trial.epochs)
    network.load_state_dict(kept)
    return FittedGenerator(estimate, best, trial, at)


def _optimiser(network: nn.Module, trial: GeneratorTrial) -> torch.optim.Optimizer:
    if trial.optimiser == "sgd":
        return torch.optim.SGD(network.parameters(), trial.rate)
    return torch.optim.Adam(network.parameters(), trial.rate, fused=True)


def best_generator(
    learned: PlaintextPairs,
    check: PlaintextPairs,
    design: Design,
    trials: Sequence[GeneratorTrial],
    progress: Progress | None = None,
) -> FittedGenerator:
    """Choose the trial that does best on ``check``; ``progress`` is told of trials.

    Raises:
        TrainingError: no trial.
    """
    require(len(trials) > 0, "there is no trial: use one or more")
    fitted = []
    for number, trial in enumerate(trials):
        fitted.append(fit_generator(learned, check, design, trial))
        if progress is not None:
            progress(number + 1, len(trials))
    return min(fitted, key=lambda each: each.error)
