"""Rows: one question, put to one family of attackers, judged on captures they never learned from.

Masks are dealt into ``FOLDS`` folds. Whoever judges one fold learned from the others, of which a
share was set apart to choose settings by. So every mask is judged once.
"""

from __future__ import annotations

import numpy as np
import torch
from benchmarks.privacy.keys.released import Released
from benchmarks.privacy.keys.scenes import Question
from torch import Tensor

from veilcam_training.attacks.intervals import Gain, accuracy_gain, area_gain, linkage_gain
from veilcam_training.attacks.linkage import blocks_of, links
from veilcam_training.attacks.networks import (
    TRIALS,
    Attacker,
    Family,
    Seen,
    attackers,
    best_of,
    judged,
)

FOLDS = 4
CHECK = 0.2
"""Share of what could be learned from that settings are chosen by."""


def attack(
    question: Question,
    family: Family,
    released: Released,
    classes: int,
    *,
    shape: tuple[int, int],
    epochs: int,
    seed: int,
) -> Gain:
    """What a family of attackers gains on a question.

    Args:
        question: that is asked.
        family: of attackers, of which the best on captures set apart is judged.
        released: captures of that question.
        classes: how many answers it has.
        shape: rows and columns of an embedding.
        epochs: most that a network is fitted for.
        seed: deals masks into folds.
    """
    if question == "linkage":
        return _attack_links(family, released, epochs=epochs, seed=seed)
    vectors, labels = torch.from_numpy(released.vectors), torch.from_numpy(released.labels)
    attacker = best_of(attackers(family, shape, epochs))
    scores, folds = cross_fit(attacker, vectors, labels, classes, seed=seed)
    if question == "presence":
        return presence_gain(scores, labels, folds)
    return accuracy_gain((scores.argmax(2) == labels).numpy(), classes)


def presence_gain(scores: Tensor, labels: Tensor, folds: Tensor) -> Gain:
    """Of scores (masks, captures, 2) for the answers 0 and 1."""
    contrast = (scores[..., 1] - scores[..., 0]).double().flatten()
    spread = folds.repeat_interleave(labels.shape[1])
    return area_gain(contrast.numpy(), (labels == 1).flatten().numpy(), spread.numpy())


def cross_fit(
    attacker: Attacker, vectors: Tensor, labels: Tensor, classes: int, *, seed: int
) -> tuple[Tensor, Tensor]:
    """Scores of all captures, each from whoever never learned from its mask.

    Args:
        attacker: learns anew for each fold, of each mask from its first capture alone, as one who
            has no key would get it.
        vectors: (masks, captures of each, pixels).
        labels: (masks, captures of each).
        classes: how many answers there are.
        seed: deals masks into folds.

    Returns:
        Scores (masks, captures of each, classes), and the fold of each mask.
    """
    folds = _dealt(len(vectors), seed)
    scores = torch.zeros(*labels.shape, classes)
    for fold in range(FOLDS):
        judging = folds == fold
        learned, check = _set_apart((~judging).nonzero().flatten(), seed + fold)
        seen = Seen(vectors[:, 0], labels[:, 0])
        found = attacker(seen.take(learned), seen.take(check), classes)
        given = judged(found, vectors[judging].flatten(0, 1)).float()
        scores[judging] = given.reshape(int(judging.sum()), -1, classes)
    return scores, folds


def _attack_links(family: Family, released: Released, *, epochs: int, seed: int) -> Gain:
    first, second = blocks_of(torch.from_numpy(released.vectors[:, 0]))
    folds = _dealt(len(first), seed)
    scores = torch.zeros(len(first), first.shape[1], first.shape[1], dtype=torch.float64)
    for fold in range(FOLDS):
        judging = folds == fold
        learned, check = _set_apart((~judging).nonzero().flatten(), seed + fold)
        link = links(
            family,
            (first[learned], second[learned]),
            (first[check], second[check]),
            trials=TRIALS,
            epochs=epochs,
        )
        with torch.no_grad():
            scores[judging] = link(first[judging], second[judging]).double()
    return linkage_gain(scores.numpy())


def _dealt(count: int, seed: int) -> Tensor:
    order = np.random.default_rng(seed).permutation(count)
    return torch.from_numpy(order % FOLDS)


def _set_apart(chosen: Tensor, seed: int) -> tuple[Tensor, Tensor]:
    order = np.random.default_rng([seed, 1]).permutation(len(chosen))
    held = max(1, round(CHECK * len(chosen)))
    mixed = chosen[torch.from_numpy(order)]
    return mixed[held:], mixed[:held]
