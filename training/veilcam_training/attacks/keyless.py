"""Keyless attacks: the share of released embeddings that is read without any key.

Attackers are judged by folds: masks are dealt into ``FOLDS`` of them, and whoever judges one
learned from the others, of which a share was set apart to choose settings by. So every mask is
judged once.
"""

from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from veilcam_optics.simulation.operator import LightOperator
from veilcam_training.attacks.intervals import (
    Gain,
    area_gain,
)
from veilcam_training.attacks.networks import (
    Attacker,
    Progress,
    Seen,
    judged,
)
from veilcam_training.encoders.fresh import FreshCamera, PreparedMask
from veilcam_training.seeding import stream

FOLDS = 4
CHECK = 0.2
"""Share of what could be learned from that settings are chosen by."""


class ReleasedMask(PreparedMask):
    """A mask whose holder releases measurements; who sees them has no decoder."""

    def decode(self, measurements: Tensor) -> Tensor:
        """Return released embeddings over their means, (batch, E)."""
        scale = measurements.mean(1, keepdim=True)
        return measurements / scale.clamp_min(torch.finfo(measurements.dtype).tiny)


class KeylessCamera(FreshCamera):
    """A camera that changes its mask all the time, seen by someone who has no key.

    Args:
        camera: camera whose embeddings leave raw and are attacked.
    """

    def __init__(self, camera: FreshCamera) -> None:
        super().__init__(camera.frame, camera.source, camera.setup, camera.schedule)

    def prepare(
        self, weights: Tensor, panels: Sequence[LightOperator], choice: torch.Generator
    ) -> ReleasedMask:
        """Return a mask behind one of ``panels``."""
        mask = super().prepare(weights, panels, choice)
        return ReleasedMask(mask.transfer, mask.decoder)


def presence_gain(scores: Tensor, labels: Tensor, folds: Tensor) -> Gain:
    """Return the mean of scores (masks, captures, 2) for the answers 0 and 1."""
    contrast = (scores[..., 1] - scores[..., 0]).double().flatten()
    spread = folds.repeat_interleave(labels.shape[1])
    return area_gain(contrast.numpy(), (labels == 1).flatten().numpy(), spread.numpy())


def cross_fit(
    attacker: Attacker,
    vectors: Tensor,
    labels: Tensor,
    classes: int,
    *,
    seed: int,
    progress: Progress | None = None,
) -> tuple[Tensor, Tensor]:
    """Scores of all captures, each from whoever never learned from its mask.

    Args:
        attacker: learns anew for each fold, of each mask from its first capture alone, as one who
            has no key would get it.
        vectors: (masks, captures of each, pixels).
        labels: (masks, captures of each).
        classes: number of answers.
        seed: deals masks into folds.
        progress: function that is called after every fold.

    Returns:
        Scores (masks, captures of each, classes), and the fold of each mask.
    """
    folds = torch.zeros(len(vectors), dtype=torch.int64)
    scores = torch.zeros(*labels.shape, classes)
    seen = Seen(vectors[:, 0], labels[:, 0])
    for fold, (learned, check, judging) in enumerate(dealt(len(vectors), seed)):
        found = attacker(seen.take(learned), seen.take(check), classes)
        given = judged(found, vectors[judging].flatten(0, 1)).float()
        scores[judging] = given.reshape(len(judging), -1, classes)
        folds[judging] = fold
        if progress is not None:
            progress(fold + 1, FOLDS)
    return scores, folds


def dealt(count: int, seed: int) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Places of masks to learn from, to choose settings by and to judge, for every fold."""
    folds = torch.randperm(count, generator=stream(seed, "folds")) % FOLDS
    for fold in range(FOLDS):
        others = (folds != fold).nonzero().flatten()
        mixed = others[torch.randperm(len(others), generator=stream(seed, "apart", fold))]
        held = max(1, round(CHECK * len(mixed)))
        yield mixed[held:], mixed[:held], (folds == fold).nonzero().flatten()
