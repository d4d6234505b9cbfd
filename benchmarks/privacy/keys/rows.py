"""Rows: one question about white embeddings, put to one family of attackers."""

from __future__ import annotations

import torch
from benchmarks.privacy.keys.released import Released
from benchmarks.privacy.keys.scenes import Question

from veilcam_training.attacks.intervals import Gain
from veilcam_training.attacks.keyless import Asked, Kind, gain
from veilcam_training.attacks.networks import Family

KINDS: dict[Question, Kind] = {"presence": "presence", "linkage": "linkage"}
"""Of questions that do not ask for a class."""


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
    asked = Asked(
        KINDS.get(question, "class"),
        torch.from_numpy(released.vectors),
        torch.from_numpy(released.labels),
        classes,
        shape,
    )
    return gain(asked, family, epochs=epochs, seed=seed)
