"""The page of the manual has the table of the code."""

from __future__ import annotations

import re
from pathlib import Path

from veilcam_training.attacks.card.threats import AREA, CLAIMED, KNOWN, PERCENT, POINTS, THREATS

PAGE = (Path(__file__).parents[5] / "docs" / "privacy-card.md").read_text()
ROWS = re.findall(r"^\| (T\d) .*\| ([^|]+) \| ([^|]+) \|$", PAGE, re.MULTILINE)


def test_thresholds_are_those_of_the_code() -> None:
    assert [threat for threat, _, _ in ROWS] == list(THREATS)
    claimed = frozenset.union(*CLAIMED.values())
    for name, full, quick in ROWS:
        threat = THREATS[name]
        for said, value in ((full, threat.threshold), (quick, threat.quick)):
            if name not in claimed and name != "T0":
                assert said == "none"
            else:
                assert threat.unit in (POINTS, AREA, PERCENT)
                found = re.search(r"[\d.]+", said)
                assert found is not None
                assert float(found[0]) == value


def test_claims_and_known_pairs_are_those_of_the_code() -> None:
    assert CLAIMED["sealed"] == {"T1", "T2", "T3", "T4", "T5", "T9"}
    assert "Claimed are T1 to T5 and T9, of `sealed`" in PAGE
    assert f"{KNOWN} labelled captures of the very mask" in PAGE
