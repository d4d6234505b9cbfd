"""Cards: attackers win where something leaks, gain nothing where nothing does, and go on."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.unit.training.attacks.card.conftest import (
    CLASSES,
    TINY,
    make_fresh,
    make_images,
    make_pairs,
    make_study,
)

from veilcam_training.attacks.card import rows
from veilcam_training.attacks.card.report import Work, figures_of, judge, make_card
from veilcam_training.attacks.card.rows import ROWS
from veilcam_training.attacks.card.shots import Found
from veilcam_training.attacks.card.study import FULL, QUICK, Plan, Study
from veilcam_training.attacks.card.threats import CLAIMED, THREATS
from veilcam_training.attacks.intervals import Gain
from veilcam_training.attacks.victim import FORMS
from veilcam_training.bundle import Bundle, PrivacyCard
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.card_page import draw_pictures, write_page

Made = tuple[PrivacyCard, Study]


def made(bundle: Bundle, work: Work | None = None, **changes: Any) -> Made:
    options: dict[str, Any] = {"form": None, "data": "bars", "plan": TINY, "seed": 1, **changes}
    images = options.pop("images", None) or make_images()
    return make_card(bundle, images, work=work or Work(None), tell=lambda *_: None, **options)


@pytest.fixture(scope="module")
def leaking() -> Made:
    """Masks that come again, in the open."""
    return made(make_pairs())


@pytest.fixture(scope="module")
def closed() -> Made:
    """Fresh masks, sealed."""
    return made(make_fresh())


def figure(card: PrivacyCard, threat: str) -> float:
    return next(row.figure for row in card.rows if row.threat == threat)


@pytest.mark.thorough
def test_every_attack_wins_behind_masks_that_come_again(leaking: Made) -> None:
    card, _ = leaking
    assert (card.mode, card.form, card.outcome) == ("pairs3", "raw", "NOT CLAIMED")
    assert [row.threat for row in card.rows] == list(THREATS)
    # 75 points is every capture; 800 of them have a standard error of 1.5 at chance.
    least = {
        "T0": 80,
        "T6": 3,
        "T9": 0.2,
        **dict.fromkeys(("T1", "T2", "T3", "T4", "T5", "T7"), 30),
    }
    for threat, value in least.items():
        assert figure(card, threat) > value, threat
    assert {row.outcome for row in card.rows[1:]} == {"NOT CLAIMED"}


@pytest.mark.thorough
def test_no_attack_beats_chance_behind_fresh_sealed_ones(closed: Made) -> None:
    card, _ = closed
    assert (card.mode, card.form) == ("fresh", "sealed")
    assert figure(card, "T0") > 80
    # Four standard errors, of scenes that pairs of masks share: 800 captures count as 400.
    bound = 4 * 100 * math.sqrt(0.25 * 0.75 / 400)
    for threat in ("T1", "T2", "T3", "T5"):
        assert abs(figure(card, threat)) < bound, threat
    # 40 blocks of 10 and 90: a block's area has an error of .096.
    assert figure(card, "T9") < 4 * 0.096 / math.sqrt(40)
    # 1,000 captures behind two masks.
    assert max(abs(figure(card, threat)) for threat in ("T4", "T7")) < 4 * 1.4
    # With the key there is something to find.
    assert figure(card, "T6") > 3


@pytest.mark.slow
def test_page_needs_nothing_else_and_shows_every_row(leaking: Made, closed: Made) -> None:
    for card, study in (leaking, closed):
        pictures = draw_pictures(study)
        page = write_page(card, pictures)
        assert not re.search(r"(src|href)=[\"'](?!data:)", page)
        assert "http" not in page.replace("http-equiv", "")
        for row in card.rows:
            assert f"<span>{row.threat}</span>{row.title}" in page
        assert card.outcome in page
        assert 'name="viewport"' in page
        assert write_page(card, pictures) == page
    assert draw_pictures(study) == pictures


@pytest.mark.slow
def test_card_that_was_broken_off_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def watched(threat: str, attack: Callable[[Study], Found]) -> Callable[[Study], Found]:
        def attacked(study: Study) -> Found:
            asked.append(threat)
            if threat == "T6" and asked.count("T6") == 1:
                raise KeyboardInterrupt
            return attack(study)

        return attacked

    few = {threat: watched(threat, ROWS[threat]) for threat in ("T0", "T4", "T6")}
    monkeypatch.setattr("veilcam_training.attacks.card.report.ROWS", few)
    work, hasty = Work(tmp_path / "work"), replace(TINY, own=20, seen=20, epochs=1)
    with pytest.raises(KeyboardInterrupt):
        made(make_fresh(), work, plan=hasty)
    with pytest.raises(TrainingError, match="give --resume"):
        made(make_fresh(), work, plan=hasty)
    with pytest.raises(TrainingError, match="holds another card"):
        made(make_fresh(), Work(work.folder, resume=True), seed=2, plan=hasty)
    parts = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "work").glob("*.pt")}
    again, _ = made(make_fresh(), Work(work.folder, resume=True), plan=hasty)
    assert asked == ["T0", "T4", "T6", "T6"]
    assert parts
    for path in (tmp_path / "work").glob("*.pt"):
        assert path.stat().st_mtime_ns == parts[path.name]
    # What is resumed is what would have been found at once.
    asked.append("T6")
    straight, _ = made(make_fresh(), plan=hasty)
    assert straight.rows == again.rows
    (tmp_path / "work" / "T4.json").write_text("{}")
    with pytest.raises(TrainingError, match="remove it to attack T4 again"):
        made(make_fresh(), Work(work.folder, resume=True), plan=hasty)


def found(threat: str, value: float, error: float = 0.1) -> Found:
    gain = Gain(value, error, 0.0, 100, value)
    return Found(threat=threat, attack="any", gain=gain, masks=10, others={"any": value})


def outcomes(form: str, values: dict[str, float], *, quick: bool = False) -> dict[str, str]:
    given = {"T0": 90.0} | {threat: 0.0 for threat in THREATS if threat != "T0"} | values
    judged = judge([found(name, value, 0.001) for name, value in given.items()], form, quick=quick)
    return {row.threat: row.outcome for row in judged}


def test_row_passes_within_its_threshold_and_fails_beyond() -> None:
    assert set(outcomes("sealed", {}).values()) == {"PASS", "NOT CLAIMED"}
    for form, values, threat, outcome in (
        ("sealed", {"T1": 1.2}, "T1", "FAIL"),
        ("sealed", {"T9": 0.03}, "T9", "FAIL"),
        ("sealed", {"T6": 9.0, "T7": 60.0, "T8": 0.4}, "T7", "NOT CLAIMED"),
        ("raw", {"T1": 60.0}, "T1", "NOT CLAIMED"),
        ("sealed", {"T5": 60.0}, "T5", "FAIL"),
        ("sealed", {"T0": 59.0}, "T0", "FAIL"),
    ):
        assert outcomes(form, values)[threat] == outcome
    assert outcomes("sealed", {"T1": 1.2}, quick=True)["T1"] == "PASS"
    # What is not proven fails.
    unsure = {
        r.threat: r for r in judge([found(name, 0, 1) for name in THREATS], "sealed", quick=False)
    }
    assert unsure["T1"].outcome == "FAIL"
    assert unsure["T1"].end > unsure["T1"].threshold
    # The end of sanity is the lower one.
    sane = judge([found("T0", 80.0, 1.0)], "sealed", quick=True)[0]
    assert sane.end == pytest.approx(80 - 2.3263, abs=1e-3)


def test_figures_are_those_that_thresholds_are_on() -> None:
    judged = judge([found(name, 5.0, 1.0) for name in THREATS], "sealed", quick=True)
    card = PrivacyCard.model_validate(
        {
            "subject": "ab" * 32,
            "mode": "fresh",
            "form": "sealed",
            "quick": True,
            "data": "bars",
            "seed": 1,
            "made_at": "2026-01-02T00:00:00Z",
            "minutes": 1.0,
            "rows": json.loads(json.dumps([row.model_dump() for row in judged])),
        },
        strict=False,
    )
    figures = figures_of(card)
    assert set(figures) == {f"card_fresh_{threat}" for threat in THREATS}
    assert figures["card_fresh_T0"] < 5 < figures["card_fresh_T1"]
    assert figures["card_fresh_T7"] == 5


def test_table_is_whole() -> None:
    assert set(ROWS) == set(THREATS)
    assert set(CLAIMED) == set(FORMS)
    for threat in THREATS.values():
        assert threat.quick >= threat.threshold
        assert threat.reason
    assert QUICK.quick
    assert not FULL.quick
    assert not CLAIMED["raw"]
    assert len(make_pairs().labels) == CLASSES
    assert rows.FOLDS >= 2


@pytest.mark.parametrize(
    ("bundle", "mode", "form", "reason"),
    [
        (make_pairs, "fresh", None, "wants one of fresh masks"),
        (make_pairs, "pairs9", None, "wants 9 masks"),
        (make_pairs, "any", None, "is not valid"),
        (make_fresh, None, "white", "form 'white' is not valid: use one of raw, sealed"),
        (make_fresh, "pairs1", None, "wants 1 masks"),
    ],
)
def test_camera_that_cannot_be_is_refused(
    bundle: Callable[[], Bundle], mode: str | None, form: str | None, reason: str
) -> None:
    with pytest.raises(TrainingError, match=reason):
        made(bundle(), mode=mode, form=form)


def test_full_card_has_more_attackers_of_pictures() -> None:
    def names(form: str, plan: Plan) -> set[str]:
        return set(make_study(make_fresh(), plan, form).of_release())

    assert "correlations" not in names("raw", QUICK)
    assert {f"correlations, start {each.seed}" for each in FULL.trials} < names("raw", FULL)
    # Ciphertext is no picture.
    pictures = ("convolutions", "correlations")
    assert not any(name.startswith(pictures) for name in names("sealed", FULL))


def test_other_data_is_refused() -> None:
    images = make_images()
    for bad, reason in (
        (images.take(images.labels.argsort()[:50]), "too few"),
        (type(images)(images.pixels[:, :4], images.labels), "the bundle's scenes"),
        (type(images)(images.pixels, images.labels + 3), "7 classes and the bundle 4"),
    ):
        with pytest.raises(TrainingError, match=reason):
            made(make_fresh(), images=bad)
