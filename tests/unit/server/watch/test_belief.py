"""Filter against its differential equations and Bayes' rule, and thresholds of captures."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest
from scipy.linalg import expm
from tests.unit.server.watch.conftest import LABELS, Look

from veilcam_client.wire.calibration import CalibrationStatus, Quantity, examples
from veilcam_server.masks.source import Evidence
from veilcam_server.watch.belief import FRESH, PAIRS, Dynamics, Sensing, Thresholds, fuse

Values = npt.NDArray[np.float64]


def generator(dynamics: Dynamics, classes: int) -> Values:
    """Rates from each state (column) to each (row), as the equations have them."""
    rates = np.zeros((1 + classes, 1 + classes))
    rates[1:, 0] = dynamics.arrival / classes
    rates[0, 1:] = dynamics.departure
    for old in range(1, 1 + classes):
        for new in range(1, 1 + classes):
            if new != old:
                rates[new, old] = dynamics.exchange / (classes - 1)
    return rates - np.diag(rates.sum(0))


@pytest.mark.parametrize("classes", [1, 2, 3, 10])
@pytest.mark.parametrize("seconds", [0.0, 0.1, 0.5, 7.0, 1e4])
def test_prediction_solves_the_equations(classes: int, seconds: float) -> None:
    dynamics = Dynamics(arrival=0.3, departure=0.7, exchange=0.2)
    belief = np.random.default_rng(classes).dirichlet(np.ones(1 + classes))
    wanted = expm(seconds * generator(dynamics, classes)) @ belief
    assert dynamics.predict(belief, seconds) == pytest.approx(wanted, abs=1e-11)


@pytest.mark.parametrize("classes", [1, 4])
def test_prior_is_what_time_does_not_change(classes: int) -> None:
    dynamics = Dynamics()
    prior = dynamics.prior(classes)
    assert prior.sum() == pytest.approx(1)
    assert dynamics.predict(prior, 3.0) == pytest.approx(prior)
    belief = np.eye(1 + classes)[1]
    assert dynamics.predict(belief, 1e4) == pytest.approx(prior)


def test_nothing_becomes_impossible() -> None:
    dynamics, sure = Dynamics(), np.array([1.0, 0.0, 0.0])
    for _ in range(200):
        sure = fuse(dynamics.predict(sure, 1e-9), np.array([1.0, 1e-9, 1e-9]))
    assert (dynamics.predict(sure, 0.0) > 0).all()
    sensing = Sensing(temperature=1.0)
    for _ in range(3):
        sure = fuse(dynamics.predict(sure, 0.5), sensing.likelihood((0, 900), admitted=True))
    assert np.argmax(sure) == 2
    assert np.isfinite(sure).all()


def test_capture_that_is_admitted_tells_of_classes_as_the_classifier_does() -> None:
    sensing = Sensing(temperature=2.0, missed=0.02, mistaken=0.1)
    logits = np.array([1.0, 3.0, -2.0])
    scores = np.exp(logits / 2) / np.exp(logits / 2).sum()
    wanted = np.array([0.1, *(0.98 * 3 * scores)])
    assert sensing.likelihood(tuple(logits), admitted=True) == pytest.approx(wanted)
    # Whether there is a thing is told by the thresholds alone.
    assert wanted[1:].mean() == pytest.approx(0.98)


def test_capture_that_is_not_admitted_tells_of_nothing_but_that() -> None:
    sensing = Sensing(temperature=2.0, missed=0.02, mistaken=0.1)
    found = sensing.likelihood((1.0, 900.0, -2.0), admitted=False)
    assert found.tolist() == [0.9, 0.02, 0.02, 0.02]


@pytest.mark.parametrize("logits", [(3e38, -3e38), (-3e38, -3e38), (0.0, 0.0), (750.0, 0.0)])
def test_no_logits_overflow(logits: tuple[float, ...]) -> None:
    found = Sensing(temperature=1.0).likelihood(logits, admitted=True)
    assert np.isfinite(found).all()
    assert found.sum() > 0


def test_bayes_rule() -> None:
    found = fuse(np.array([0.5, 0.3, 0.2]), np.array([0.1, 0.2, 0.4]))
    assert found == pytest.approx(np.array([0.05, 0.06, 0.08]) / 0.19)


def test_belief_leaves_room_for_scenes_that_read_as_another_class() -> None:
    sensing = Sensing(temperature=1.0, misread=0.04)
    told = sensing.told(np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0]))
    assert told == pytest.approx([0, 0.96, 0.01, 0.01, 0.01, 0.01])
    some = np.random.default_rng(0).dirichlet(np.ones(5))
    assert sensing.told(some).sum() == pytest.approx(1)
    assert sensing.told(some)[0] == some[0]
    alone = np.array([0.3, 0.7])
    assert sensing.told(alone) == pytest.approx(alone)


@pytest.mark.parametrize("sensing", [FRESH, PAIRS])
def test_however_many_captures_of_one_scene_tell_no_more_than_it_may(sensing: Sensing) -> None:
    dynamics = Dynamics()
    belief = dynamics.prior(10)
    logits = (9.0, *(9 * [0.0]))
    for _ in range(1000):
        belief = fuse(dynamics.predict(belief, 0.1), sensing.likelihood(logits, admitted=True))
    assert 0.9 < np.max(sensing.told(belief)) <= 1 - sensing.misread


@pytest.mark.parametrize(
    ("light", "novelty", "admitted"),
    [
        (0.02, 1.0, True),
        (0.01, 5.0, True),
        (0.02, 5.1, False),
        (0.0099, 1.0, False),
        (0.02, None, True),
        (0.0, None, False),
        (0.02, math.inf, False),
        (0.02, math.nan, False),
        (math.nan, 1.0, False),
        (-0.02, 1.0, False),
    ],
)
def test_thing_is_bright_enough_and_familiar(
    light: float, novelty: float | None, admitted: bool
) -> None:
    evidence = Evidence(LABELS, (0.0, 0.0, 0.0), light, novelty)
    assert Thresholds(least_light=0.01, most_novelty=5.0).admits(evidence) is admitted


def test_black_level_that_is_hardly_known_asks_for_more_light() -> None:
    [status] = [each for each in examples() if isinstance(each, CalibrationStatus)]
    assert status.signed is not None
    known = status.signed.record.model_copy(
        update={
            "black_level": Quantity(value=0.1, uncertainty=0.0001, residual=0.0),
            "gain": Quantity(value=0.5, uncertainty=0.0, residual=0.0),
        }
    )
    before = Thresholds(least_light=0.001, most_novelty=5.0)
    # Ten deviations of 0.0002 each, through masks that let a third of the light pass.
    found = before.calibrated(known)
    assert found.least_light == pytest.approx(0.006)
    assert found.most_novelty == 5.0
    better = known.model_copy(
        update={"black_level": Quantity(value=0.1, uncertainty=1e-9, residual=0.0)}
    )
    assert before.calibrated(better) == before


def test_label_s_evidence_is_admitted_and_darkness_is_not(look: Look) -> None:
    assert Thresholds().admits(look("a"))
    assert not Thresholds().admits(look(None))
