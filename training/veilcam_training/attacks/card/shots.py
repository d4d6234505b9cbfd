"""Attackers of one mask behind which many captures were taken, and what a row is kept as."""

from collections.abc import Callable, Mapping

import torch
from pydantic import BaseModel
from torch import Tensor

from veilcam_training.attacks.card.study import HELD, Shots, Study
from veilcam_training.attacks.intervals import Gain, accuracy_gain
from veilcam_training.attacks.known_pairs import FewNetwork, by_anchors, hits, readers
from veilcam_training.attacks.mask_recovery import (
    Evidence,
    KnownPictures,
    estimates,
    recover_mask,
)
from veilcam_training.attacks.networks import judged
from veilcam_training.seeding import stream

FEW = 4
"""Known pictures that a mask is looked for with."""
RIDGES = (0.1, float("inf"))
"""Of angles to known captures: freed of what these share, and as they are."""
EPOCHS = 8
"""Most that a network of such angles is fitted for."""


class Found(BaseModel, frozen=True, extra="forbid"):
    """Results of the attacks of one threat; a file of the work folder."""

    threat: str
    attack: str
    gain: Gain
    masks: int
    others: dict[str, float]
    """Figures of all attacks that were tried."""
    notes: tuple[str, ...] = ()


def known_pairs(study: Study, threat: str, known: int) -> Found:
    """All who know some captures of a mask, and those who know none.

    Which of them is used is chosen behind a third of the masks.
    """
    masks = [each.captures.of_first(known) for each in study.long]
    own = [each.of_first(known) for each in study.own_long]
    held = max(1, round(HELD * len(own)))
    tried = readers()
    if not study.plan.recovered:  # light attackers
        tried = {name: each for name, each in tried.items() if not isinstance(each, FewNetwork)}
    for ridge in RIDGES:
        name = "angles to known captures" + (", freed" if ridge < float("inf") else "")
        tried[name] = by_anchors(own[held:], own[:held], study.classes, ridge=ridge, epochs=EPOCHS)
    given = {name: hits(each, masks, study.classes) for name, each in tried.items()}
    given |= study.in_sets
    given[f"{study.blind.name}, one by one"] = _one_by_one(study)
    if study.plan.recovered and study.subject.form == "raw":
        few = min(known, FEW)
        given[f"mask by gradient from {few} known pictures"] = recovered(
            study,
            lambda shots: KnownPictures(
                study.subject.decoding,
                shots.scenes[:few],
                shots.captures.known.vectors[:few],
            ),
        )
    return of_masks(study, threat, given, f"{known} captures known")


def _one_by_one(study: Study) -> Tensor:
    """Return the captures that the attacker of T1 reads, bool (masks, captures)."""
    asked = [each.captures.asked for each in study.long]
    read = [judged(study.blind.answer, each.vectors).argmax(1) == each.labels for each in asked]
    return torch.stack(read)


def of_masks(study: Study, threat: str, given: Mapping[str, Tensor], note: str) -> Found:
    """Return the best attacker behind the first third of its masks, judged behind the others."""
    tuned = {name: max(1, len(each) // 3) for name, each in given.items()}
    name = max(given, key=lambda each: float(given[each][: tuned[each]].double().mean()))
    gains = {
        each: accuracy_gain(found[tuned[each] :].numpy(), study.classes, 0.0)
        for each, found in given.items()
    }
    return Found(
        threat=threat,
        attack=f"{name}; {note}",
        gain=gains[name],
        masks=len(given[name]) - tuned[name],
        others={each: gain.value for each, gain in gains.items()},
    )


def recovered(study: Study, evidence: Callable[[Shots], Evidence]) -> Tensor:
    """Return the captures read behind masks that were found by gradient, bool (masks, captures)."""
    decoding, random = study.subject.decoding, stream(study.seed, "recovered")
    shape, right = study.subject.bundle.camera.mask_shape, []
    for shots in study.long[: study.plan.recovered]:
        found = recover_mask(evidence(shots), shape, generator=random)
        asked = shots.captures.asked
        decoded = estimates(decoding, found.weights, asked.vectors)
        right.append(judged(study.read.answer, decoded.flatten(1)).argmax(1) == asked.labels)
        study.tell("masks by gradient", len(right), study.plan.recovered)
    return torch.stack(right)
