"""A card that claims of `raw` what holds for `white` fails."""

from __future__ import annotations

from dataclasses import replace

import pytest
from tests.unit.training.attacks.card.conftest import TINY, make_fresh, make_images

from veilcam_training.attacks.card.report import judge
from veilcam_training.attacks.card.rows import linkage
from veilcam_training.attacks.card.study import Study
from veilcam_training.attacks.card.subject import make_subject
from veilcam_training.attacks.victim import ReleaseRule, raw, white
from veilcam_training.bundle import CardRow

PLAN = replace(TINY, own=60, seen=300, epochs=3)
"""150 blocks of ten pairs: an area of one half has a standard error of .096 / sqrt(150), .008. Its
upper end, 2.33 errors on, is within the bar of .05 unless the area errs by 4 errors."""


def linked(release: ReleaseRule) -> CardRow:
    """T9 of a quick card, of fresh masks whose captures leave in such a form."""
    subject = make_subject(make_fresh(), make_images().scenes(slice(0, 300)), seed=1)
    study = Study(
        replace(subject, release=release),
        make_images(),
        PLAN,
        seed=1,
        folder=None,
        tell=lambda *_: None,
    )
    return judge([linkage(study)], "white", quick=True)[0]


@pytest.mark.thorough
def test_card_of_raw_captures_fails_where_white_passes() -> None:
    leaking, present = linked(raw), linked(white)
    assert (leaking.threat, leaking.outcome) == ("T9", "FAIL")
    # Not for want of captures: what is found is itself beyond the bar.
    assert leaking.figure > leaking.threshold
    assert present.outcome == "PASS"
    assert present.threshold == leaking.threshold
