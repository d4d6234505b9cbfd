"""What looks like a thing."""

from __future__ import annotations

import math

import pytest
from tests.unit.server.watch.conftest import LABELS, Look

from veilcam_client.wire.calibration import EXAMPLES, CalibrationStatus, Quantity
from veilcam_server.masks.source import Evidence
from veilcam_server.watch.admission import Admission


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
    assert Admission(least_light=0.01, most_novelty=5.0).admits(evidence) is admitted


def test_black_level_that_is_hardly_known_asks_for_more_light() -> None:
    [status] = [each for each in EXAMPLES if isinstance(each, CalibrationStatus)]
    assert status.signed is not None
    known = status.signed.record.model_copy(
        update={
            "black_level": Quantity(value=0.1, uncertainty=0.0001, residual=0.0),
            "gain": Quantity(value=0.5, uncertainty=0.0, residual=0.0),
        }
    )
    before = Admission(least_light=0.001, most_novelty=5.0)
    # Ten deviations of 0.0002 each, through masks that let a third of the light pass.
    found = before.calibrated(known)
    assert found.least_light == pytest.approx(0.006)
    assert found.most_novelty == 5.0
    better = known.model_copy(
        update={"black_level": Quantity(value=0.1, uncertainty=1e-9, residual=0.0)}
    )
    assert before.calibrated(better) == before


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_thresholds_that_cannot_be_are_refused(value: float) -> None:
    with pytest.raises(ValueError, match="least_light"):
        Admission(least_light=value)
    with pytest.raises(ValueError, match="most_novelty"):
        Admission(most_novelty=value)


def test_label_s_evidence_is_admitted_and_darkness_is_not(look: Look) -> None:
    assert Admission().admits(look("a"))
    assert not Admission().admits(look(None))
