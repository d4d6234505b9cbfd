"""The status tells what a bundle's card says, of a card of these masks alone."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from veilcam_server.bundles.loader import bundle_info
from veilcam_training.bundle import CardRow, PrivacyCard, add_card, read_bundle


def make_card(subject: str) -> PrivacyCard:
    row = CardRow(
        threat="T0",
        title="a title",
        given="the key",
        attack="a network",
        metric="digits",
        figure=93.5,
        end=92.1,
        unit="%",
        chance=10.0,
        threshold=60.0,
        reason="because",
        samples=1000,
        masks=100,
        outcome="PASS",
    )
    failed = row.model_copy(update={"threat": "T1", "outcome": "FAIL", "unit": "points"})
    return PrivacyCard(
        subject=subject,
        mode="pairs3",
        form="raw",
        quick=True,
        data="digits",
        seed=1,
        made_at=datetime(2026, 1, 2, tzinfo=UTC),
        minutes=2.5,
        rows=(row, failed),
    )


def test_bundle_is_told_with_its_card(bundle_file: Path) -> None:
    bundle = read_bundle(bundle_file)
    assert bundle_info(bundle).card is None
    add_card(bundle_file, make_card(bundle.subject))
    found = bundle_info(read_bundle(bundle_file)).card
    assert found is not None
    assert found.model_dump() == {
        "outcome": "FAIL",
        "mode": "pairs3",
        "form": "raw",
        "quick": True,
        "made_at": datetime(2026, 1, 2, tzinfo=UTC),
        "rows": (
            {"threat": "T0", "outcome": "PASS", "figure": 93.5, "end": 92.1, "unit": "%"},
            {"threat": "T1", "outcome": "FAIL", "figure": 93.5, "end": 92.1, "unit": "points"},
        ),
    }
