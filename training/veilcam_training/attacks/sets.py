"""Attackers who hold several captures of one mask, or of one still scene, and no key.

Which captures share a mask is public: every answer names its epoch. Nothing else of the mask is
known; networks learn from sets behind masks of the attacker's own. No answer depends on the order
of a set. Sets are (sets, captures, pixels), their labels (sets, captures).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import cross_entropy

from veilcam_training.attacks.networks import Attacker, Progress, Scores, Seen, Trial
from veilcam_training.seeding import seeded

View = Callable[[Tensor], Tensor]
"""From sets (sets, captures, pixels) to features of each capture, (sets, captures, features)."""
_BATCH = 16
"""Sets of one step."""
_FLOOR = 1e-6
"""Least variance beside the largest that whitening divides by."""


@dataclass(frozen=True)
class SeenSets:
    """Captures (sets, captures, pixels) float32 and their answers (sets, captures) int64."""

    captures: Tensor
    labels: Tensor

    def take(self, chosen: Tensor) -> SeenSets:
        """Return some of the sets."""
        return SeenSets(self.captures[chosen], self.labels[chosen])


def as_read(sets: Tensor) -> Tensor:
    """Return captures in units of their set's root mean square."""
    return sets / _size(sets)


def centred(sets: Tensor) -> Tensor:
    """Return the departure of a capture from the others of its set."""
    apart = sets - sets.mean(1, keepdim=True)
    return apart / _size(apart)


def _size(sets: Tensor) -> Tensor:
    return sets.square().mean((1, 2), keepdim=True).sqrt().clamp_min(torch.finfo(sets.dtype).tiny)


def decorrelated(sets: Tensor, *, components: int = 32) -> Tensor:
    """Principal components of each set, of variance 1, the largest first.

    A component has no sign; it is given the one that makes its third moment positive.

    Args:
        sets: (sets, captures, pixels).
        components: most that are kept.

    Returns:
        (sets, captures, components): fewer where a set has fewer captures or pixels.
    """
    apart = (sets - sets.mean(1, keepdim=True)).double()
    left, spread, _ = torch.linalg.svd(apart, full_matrices=False)
    found = (spread > _FLOOR**0.5 * spread[:, :1])[:, None]
    white = (left * found)[..., :components] * sets.shape[1] ** 0.5
    return _signed(white).to(sets.dtype)


def _signed(components: Tensor) -> Tensor:
    skew = components.pow(3).sum(1, keepdim=True)
    return components * torch.where(skew < 0, -1.0, 1.0).to(components.dtype)


def independent(sets: Tensor, *, components: int = 12, steps: int = 50) -> Tensor:
    """Independent components of each set, the least Gaussian first.

    FastICA with all components at once and the contrast log cosh (Hyvarinen 1999, equations 20 and
    45). Mixing by a mask is undone up to order and sign; these are set by the fourth and the third
    moment.

    Args:
        sets: (sets, captures, pixels).
        components: principal components that are unmixed.
        steps: number of steps of the iteration.

    Returns:
        (sets, captures, components), of variance 1.
    """
    white = decorrelated(sets, components=components).double()
    count = white.shape[2]
    unmixing = torch.eye(count, dtype=white.dtype).expand(len(white), -1, -1)
    for _ in range(steps):
        bent = torch.tanh(white @ unmixing.mT)
        moved = bent.mT @ white / white.shape[1]
        moved = moved - (1 - bent.square()).mean(1)[..., None] * unmixing
        left, _, right = torch.linalg.svd(moved)
        unmixing = left @ right
    found = white @ unmixing.mT
    order = (found.pow(4).mean(1) - 3).abs().argsort(dim=1, descending=True)
    ordered = found.gather(2, order[:, None].expand(-1, found.shape[1], -1))
    return _signed(ordered).to(sets.dtype)


def gram(sets: Tensor, *, neighbours: int = 64) -> Tensor:
    """Cosines of each capture with the others of its set, the largest first: angles alone.

    A rotation of the pixels changes none of them.

    Args:
        sets: (sets, captures, pixels).
        neighbours: most that are kept, of the largest and of the smallest half each.

    Returns:
        (sets, captures, features).
    """
    unit = sets / sets.norm(dim=2, keepdim=True).clamp_min(torch.finfo(sets.dtype).tiny)
    cosines = unit @ unit.mT
    count = cosines.shape[1]
    others = cosines[:, ~torch.eye(count, dtype=torch.bool)].reshape(len(sets), count, count - 1)
    sorted_ = others.sort(dim=2, descending=True).values
    half = min(neighbours // 2, sorted_.shape[2])
    return torch.cat([sorted_[..., :half], sorted_[..., -half:]], dim=2)


def moments(sets: Tensor, *, eigenvalues: int = 16) -> Tensor:
    """Mean and covariance of a set alone, the same for each of its captures.

    Of the covariance: its diagonal and its largest eigenvalues.

    Args:
        sets: (sets, captures, pixels).
        eigenvalues: most that are kept; 0 where there are fewer.

    Returns:
        (sets, captures, 2 x pixels + eigenvalues).
    """
    scaled = as_read(sets)
    mean = scaled.mean(1)
    apart = scaled - mean[:, None]
    variance = apart.square().mean(1)
    spread = torch.linalg.svdvals(apart.double())[:, :eigenvalues].square() / sets.shape[1]
    largest = torch.zeros(len(sets), eigenvalues, dtype=sets.dtype)
    largest[:, : spread.shape[1]] = (spread + _FLOOR).log().to(sets.dtype)
    features = torch.cat([mean, (variance + _FLOOR).log(), largest], dim=1)
    return features[:, None].expand(-1, sets.shape[1], -1)


VIEWS: tuple[View, ...] = (as_read, centred, decorrelated, independent, gram, moments)


class SetNetwork(nn.Module):
    """Answers for each capture of a set, by itself and by what the set is like.

    Deep sets (Zaheer et al. 2017): features of each capture, their mean over the set beside them.

    Args:
        typical: features (sets, captures, features), which say what each is like on average.
        classes: number of answers.
        width: width of each layer.
    """

    def __init__(self, typical: Tensor, classes: int, width: int = 128) -> None:
        super().__init__()
        self.mean, self.deviation = typical.mean((0, 1)), typical.std((0, 1)) + _FLOOR
        self.each = nn.Sequential(
            *(nn.Linear(typical.shape[2], width), nn.ReLU()),
            *(nn.Linear(width, width), nn.ReLU()),
        )
        self.answer = nn.Sequential(
            *(nn.Linear(3 * width, width), nn.ReLU(), nn.Dropout(0.2), nn.Linear(width, classes))
        )

    def forward(self, sets: Tensor) -> Tensor:
        """Logits (sets, captures, classes) of (sets, captures, features)."""
        each = self.each((sets - self.mean) / self.deviation)
        of_set = torch.cat([each.mean(1), each.amax(1)], dim=1)[:, None]
        logits: Tensor = self.answer(torch.cat([each, of_set.expand(-1, each.shape[1], -1)], dim=2))
        return logits


def by_sets(
    learned: SeenSets,
    check: SeenSets,
    classes: int,
    *,
    view: View,
    trial: Trial,
    epochs: int,
    progress: Progress | None = None,
) -> Scores:
    """Fit a network on sets; the epoch that does best on ``check`` counts.

    Returns:
        From sets (sets, captures, pixels) to logits (sets, captures, classes).
    """
    features, checked = view(learned.captures), view(check.captures)
    with seeded(trial.seed, "sets"):
        network = SetNetwork(features, classes)
        optimiser = torch.optim.AdamW(network.parameters(), trial.rate, weight_decay=trial.decay)
        best, kept = float("inf"), network.state_dict()
        for epoch in range(epochs):
            network.train()
            for part in torch.split(torch.randperm(len(features)), _BATCH):
                optimiser.zero_grad()
                logits = network(features[part])
                loss = cross_entropy(logits.flatten(0, 1), learned.labels[part].flatten())
                loss.backward()  # type: ignore[no-untyped-call]
                optimiser.step()
            network.eval()
            with torch.no_grad():
                logits = network(checked)
            found = float(cross_entropy(logits.flatten(0, 1), check.labels.flatten()))
            if found < best:
                best, kept = found, {k: v.clone() for k, v in network.state_dict().items()}
            if progress is not None:
                progress(epoch + 1, epochs)
    network.load_state_dict(kept)
    return lambda sets: network(view(sets))


def by_average(learned: SeenSets, check: SeenSets, classes: int, *, attacker: Attacker) -> Scores:
    """Average captures of a still scene, then attack the average.

    Behind one mask noise goes; behind many masks goes what is theirs, and what they have in common
    stays.

    Args:
        learned: sets of which each shows one scene; the first label of a set counts.
        check: sets that tell when to stop.
        classes: number of answers.
        attacker: attacker of one vector.

    Returns:
        From sets (sets, captures, pixels) to scores (sets, classes).
    """
    means = [Seen(each.captures.mean(1), each.labels[:, 0]) for each in (learned, check)]
    scores = attacker(means[0], means[1], classes)
    return lambda sets: scores(sets.mean(1))
