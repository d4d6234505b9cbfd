"""Intervals hold as often as they say, and Holm's procedure is what the paper says."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import mannwhitneyu, norm

from veilcam_training.attacks.intervals import (
    Gain,
    accuracy_gain,
    area,
    area_gain,
    holm,
    linkage_gain,
)


def test_area_is_mann_whitneys_and_its_error_delongs() -> None:
    random = np.random.default_rng(1)
    scores = random.integers(6, size=80).astype(float)
    positive = random.random(80) < 0.4
    scores[positive] += 1
    value, error = area(scores, positive)
    high, low = scores[positive], scores[~positive]
    assert value == pytest.approx(mannwhitneyu(high, low).statistic / (len(high) * len(low)))
    psi = (high[:, None] > low) + 0.5 * (high[:, None] == low)
    variance = psi.mean(1).var(ddof=1) / len(high) + psi.mean(0).var(ddof=1) / len(low)
    assert error == pytest.approx(variance**0.5)
    # An area below one half is turned round.
    positive = np.arange(100) < 50
    gain = area_gain(-positive.astype(float), positive, np.zeros(100, np.int64))
    assert (gain.shown, gain.value) == (0, 0.5)


@pytest.mark.thorough
def test_errors_are_those_of_repeated_experiments() -> None:
    random = np.random.default_rng(2)
    gains = []
    for _ in range(300):
        scores, positive = random.standard_normal(60), random.random(60) < 0.5
        gains.append(area_gain(scores, positive, np.arange(60) % 2))
    spread = np.std([gain.shown for gain in gains])
    # The spread of 300 has a standard error of 4 %.
    assert np.mean([gain.error for gain in gains]) == pytest.approx(spread, rel=0.15)
    blocks = [linkage_gain(random.standard_normal((20, 4, 4))) for _ in range(300)]
    spread = np.std([gain.shown for gain in blocks])
    assert np.mean([gain.error for gain in blocks]) == pytest.approx(spread, rel=0.15)


def test_captures_of_one_mask_count_as_what_they_are() -> None:
    random = np.random.default_rng(3)
    alone = random.random((4000, 1)) < 0.3
    # The same capture four times over is no more than one.
    assert accuracy_gain(alone.repeat(4, axis=1), 4).error == accuracy_gain(alone, 4).error
    gain = accuracy_gain(alone, 4)
    assert gain.shown == pytest.approx(100 * alone.mean())
    assert gain.value == pytest.approx(gain.shown - 25)
    assert gain.error == pytest.approx(100 * (0.21 / 4000) ** 0.5, rel=0.05)


def test_upper_end_is_at_the_bar_where_the_doubt_is_its_level() -> None:
    gain = Gain(0.4, 0.25, 1.0, 100, 10.4)
    assert gain.upper(gain.doubt) == pytest.approx(gain.bar)
    assert gain.upper(0.01) == pytest.approx(0.4 + 2.326348 * 0.25)


def _with_doubt(doubt: float) -> Gain:
    return Gain(1 + float(norm.ppf(doubt)), 1.0, 1.0, 100, 0.0)


def test_holms_procedure_stops_at_the_first_row_that_is_in_doubt() -> None:
    # Levels .0025, .0033, .005, .01: the third is above its own, so the fourth falls with it.
    rows = {"a": 0.001, "c": 0.006, "b": 0.003, "d": 0.007}
    verdicts = holm({name: _with_doubt(each) for name, each in rows.items()}, alpha=0.01)
    assert {name for name, each in verdicts.items() if each.holds} == {"a", "b"}
    for each in verdicts.values():
        assert each.holds == (each.upper <= each.gain.bar)


def test_rows_that_are_sure_get_the_level_of_their_place() -> None:
    verdicts = holm({"a": _with_doubt(1e-6), "b": _with_doubt(1e-5)}, alpha=0.01)
    assert verdicts["a"].upper == pytest.approx(verdicts["a"].gain.upper(0.005))
    assert verdicts["b"].upper == pytest.approx(verdicts["b"].gain.upper(0.01))
    assert all(each.holds for each in verdicts.values())
