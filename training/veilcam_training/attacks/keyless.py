"""Keyless attacks: the share of released embeddings that is read without any key.

Attackers are judged by folds: masks are dealt into ``FOLDS`` of them, and whoever judges one
learned from the others, of which a share was set apart to choose settings by. So every mask is
judged once.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import torch
from torch import Tensor

from veilcam_optics.decoding.release import ReleaseForm, Whitening
from veilcam_optics.keys.masks import KEY_BYTES
from veilcam_optics.simulation.operator import LightOperator
from veilcam_training.attacks.intervals import (
    Gain,
    Verdict,
    accuracy_gain,
    area_gain,
    linkage_gain,
)
from veilcam_training.attacks.linkage import blocks_of, links
from veilcam_training.attacks.networks import (
    TRIALS,
    Attacker,
    Family,
    Progress,
    Seen,
    attackers,
    best_of,
    judged,
)
from veilcam_training.encoders.fresh import FreshCamera, PreparedMask
from veilcam_training.seeding import stream

FOLDS = 4
CHECK = 0.2
"""Share of what could be learned from that settings are chosen by."""

Kind = Literal["class", "presence", "linkage"]


@dataclass(frozen=True)
class ReleasedMask(PreparedMask):
    """A mask whose holder releases measurements; who sees them has no decoder."""

    whitening: Whitening | None = field(repr=False)
    """None: they leave raw."""

    def decode(self, measurements: Tensor) -> Tensor:
        """Return released embeddings, (batch, E): white times sqrt(E), or raw over their means."""
        if self.whitening is not None:
            # Of variance 1, as a network likes its inputs.
            return self.whitening.whiten(measurements) * math.sqrt(measurements[0].numel())
        scale = measurements.mean(1, keepdim=True)
        return measurements / scale.clamp_min(torch.finfo(measurements.dtype).tiny)


class KeylessCamera(FreshCamera):
    """A camera that changes its mask all the time, seen by someone who has no key.

    Args:
        camera: camera whose embeddings are attacked.
        form: form in which embeddings are released.
    """

    def __init__(self, camera: FreshCamera, form: ReleaseForm) -> None:
        super().__init__(camera.frame, camera.source, camera.setup, camera.schedule)
        self.form = form

    def prepare(
        self, weights: Tensor, panels: Sequence[LightOperator], choice: torch.Generator
    ) -> ReleasedMask:
        """Return a mask behind one of ``panels``, and a rotation of its own."""
        mask, whitening = super().prepare(weights, panels, choice), None
        if self.form is ReleaseForm.WHITE:
            key = torch.randint(256, (KEY_BYTES,), generator=choice, dtype=torch.uint8)
            whitening = Whitening(mask.decoder, key.numpy().tobytes())
        return ReleasedMask(mask.transfer, mask.decoder, whitening)


@dataclass(frozen=True)
class Asked:
    """A question about released captures of which no two masks are alike.

    Attributes:
        kind: question: the class, presence, or whether two captures show the same.
        vectors: float32 (masks, captures of each, numbers); with linkage (masks, 1, numbers), of
            which neighbours show the same.
        labels: the answers, int64 (masks, captures of each); every class is drawn with the same
            chance. Linkage needs none.
        classes: number of answers.
        shape: rows and columns of an embedding; None: what leaves is no picture.
    """

    kind: Kind
    vectors: Tensor = field(repr=False)
    labels: Tensor = field(repr=False)
    classes: int
    shape: tuple[int, int] | None


def gain(
    asked: Asked, family: Family, *, epochs: int, seed: int, progress: Progress | None = None
) -> Gain:
    """Return the gain of a family of attackers on a question.

    Args:
        asked: question to answer.
        family: family of attackers, of which the best on captures set apart is judged.
        epochs: most that a network is fitted for.
        seed: deals masks into folds.
        progress: function that is called after every fold.
    """
    if asked.kind == "linkage":
        return _link_gain(family, asked.vectors[:, 0], epochs, seed, progress)
    attacker = best_of(attackers(family, asked.shape, epochs))
    scores, folds = cross_fit(
        attacker, asked.vectors, asked.labels, asked.classes, seed=seed, progress=progress
    )
    if asked.kind == "presence":
        return presence_gain(scores, asked.labels, folds)
    return accuracy_gain((scores.argmax(2) == asked.labels).numpy(), asked.classes)


def worst_upper(verdicts: Mapping[str, Verdict]) -> float:
    """Return the highest upper end of all rows, in bars: at most 1 where every row passes.

    A row of classes has a bar of one point, so that its upper end in points is what it is in bars;
    one of an area has a bar of 0.02.
    """
    return max(each.upper / each.gain.bar for each in verdicts.values())


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


def _link_gain(
    family: Family, vectors: Tensor, epochs: int, seed: int, progress: Progress | None
) -> Gain:
    first, second = blocks_of(vectors)
    scores = torch.zeros(len(first), first.shape[1], first.shape[1], dtype=torch.float64)
    for fold, (learned, check, judging) in enumerate(dealt(len(first), seed)):
        link = links(
            family,
            (first[learned], second[learned]),
            (first[check], second[check]),
            trials=TRIALS,
            epochs=epochs,
        )
        with torch.no_grad():
            scores[judging] = link(first[judging], second[judging]).double()
        if progress is not None:
            progress(fold + 1, FOLDS)
    return linkage_gain(scores.numpy())


def dealt(count: int, seed: int) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
    """Places of masks to learn from, to choose settings by and to judge, for every fold."""
    folds = torch.randperm(count, generator=stream(seed, "folds")) % FOLDS
    for fold in range(FOLDS):
        others = (folds != fold).nonzero().flatten()
        mixed = others[torch.randperm(len(others), generator=stream(seed, "apart", fold))]
        held = max(1, round(CHECK * len(mixed)))
        yield mixed[held:], mixed[:held], (folds == fold).nonzero().flatten()
