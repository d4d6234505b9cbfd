"""The ten threats, and what was said of each before anything was attacked.

Thresholds stand here and nowhere else. They were fixed before the first card was made; whoever
changes one changes what PASS means.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from veilcam_training.attacks.intervals import Gain, Verdict
from veilcam_training.bundle import Outcome

POINTS, AREA, PERCENT, DECIBEL = "points", "|AUC - 1/2|", "%", "dB"


@dataclass(frozen=True)
class Threat:
    """One row of the table."""

    title: str
    given: str
    """What the attacker holds, beside optics, code and data, which all of them know."""
    metric: str
    unit: str
    chance: float
    """The figure of an attacker who sees nothing."""
    threshold: float
    quick: float
    """Threshold of a quick card, which has too few captures to prove the other one."""
    reason: str


_CHANCE = (
    "a point is below what is noticed in use, and what some 20,000 captures can prove; "
    "2,000 prove three"
)
_AREA = "4 % of the way from chance to certainty; a quick card proves a tenth of it"

THREATS: Mapping[str, Threat] = {
    "T0": Threat(
        "sanity: with the key",
        "what leaves, and the key of its epoch",
        "digits read, of all",
        *(PERCENT, 10.0, 60.0, 60.0),
        "six times chance: where the same attackers fail with the key, what they fail at without "
        "it says nothing, and the card is void",
    ),
    "T1": Threat(
        "ciphertext only",
        "what leaves, and captures of cameras of their own, whose keys they know",
        "digits read, above chance",
        *(POINTS, 0.0, 1.0, 3.0),
        _CHANCE,
    ),
    "T2": Threat(
        "wrong key",
        "what leaves, and the key of another mask of the same camera, to decode with",
        "digits read, above chance",
        *(POINTS, 0.0, 1.0, 3.0),
        _CHANCE,
    ),
    "T3": Threat(
        "pairs of other epochs",
        "what leaves, and what other epochs of this camera saw, picture by picture",
        "digits read, above chance",
        *(POINTS, 0.0, 1.0, 3.0),
        _CHANCE,
    ),
    "T4": Threat(
        "known pairs of this mask",
        "30 labelled captures of the mask",
        "digits read, above chance",
        *(POINTS, 0.0, 1.0, 3.0),
        _CHANCE,
    ),
    "T5": Threat(
        "leaked list",
        "what leaves, and a list of masks and keys: all that are stored, or those of past epochs",
        "digits read, above chance",
        *(POINTS, 0.0, 1.0, 3.0),
        _CHANCE,
    ),
    "T6": Threat(
        "full leak",
        "what leaves, and mask and key of that very epoch",
        "nearer to the picture than the mean picture is",
        *(DECIBEL, 0.0, 0.0, 0.0),
        "nothing is claimed against whoever has the key: the figure says how much there is to lose",
    ),
    "T7": Threat(
        "many shots",
        "hundreds of labelled captures behind one mask, whatever its budget",
        "digits read, above chance",
        *(POINTS, 0.0, 1.0, 3.0),
        "nothing is claimed beyond the budget: the figure says what the budget is for",
    ),
    "T8": Threat(
        "attributes and scores",
        "the scores of every answer, which a scope of its own lets out",
        "more ink than half of the digits, told from the scores",
        *(AREA, 0.0, 0.02, 0.05),
        "nothing is claimed of scores: who may read them learns more than the label",
    ),
    "T9": Threat(
        "linkage",
        "what leaves behind two masks",
        "the same scene told from another one",
        *(AREA, 0.0, 0.02, 0.05),
        _AREA,
    ),
}

CLAIMED: Mapping[str, frozenset[str]] = {
    "raw": frozenset(),
    "sealed": frozenset({"T1", "T2", "T3", "T4", "T5", "T9"}),
}
"""Rows that have to be at chance, by form. ``raw`` is measured, and claims nothing."""
KNOWN = 30
"""Labelled captures of the current mask in T4."""


def outcome_of(
    threat: str, form: str, gain: Gain, verdict: Verdict | None, level: float
) -> Outcome:
    """Return the text of a row.

    Args:
        threat: threat of :data:`THREATS`.
        form: form in which embeddings left.
        gain: gain of the worst attacker.
        verdict: beside all rows that are claimed; None for one that is not.
        level: level of the interval of T0 [share]: its lower end has to reach the threshold.
    """
    if threat == "T0":
        return "PASS" if lower(gain, level) >= gain.bar else "FAIL"
    if threat not in CLAIMED[form] or verdict is None:
        return "NOT CLAIMED"
    return "PASS" if verdict.holds else "FAIL"


def lower(gain: Gain, level: float) -> float:
    """Lower end of the one-sided interval of level ``1 - level``, of the statistic itself."""
    return 2 * gain.value - gain.upper(level)
