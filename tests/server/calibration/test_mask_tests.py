"""What captures are tested with: for the camera as it was measured, or as it was drawn."""

from __future__ import annotations

from typing import Any

import pytest
from tests.server.calibration.test_record import make_record
from tests.server.conftest import make_bundle

from veilcam_client.wire.calibration import Quantity, SignedCalibration
from veilcam_server.calibration import loading
from veilcam_server.calibration.record import imperfections_of

BUNDLE = make_bundle()


def made(
    monkeypatch: pytest.MonkeyPatch, signed: SignedCalibration | None
) -> tuple[object, dict[str, Any]]:
    """The camera, and with what else tests are made."""
    made: Any = object()
    given: list[tuple[object, dict[str, Any]]] = []

    def make(camera: object, **rest: Any) -> object:
        given.append((camera, rest))
        return made

    monkeypatch.setattr(loading, "MaskTests", make)
    assert loading.mask_tests(BUNDLE, signed, full_scale=0.25) is made
    return given[0]


def signed_with(black_level: float) -> SignedCalibration:
    """A record whose black level is known so well, of a camera with a full scale of 4."""
    known = Quantity(value=0.02, uncertainty=black_level, residual=0.0)
    half = known.model_copy(update={"value": 0.5})
    whole = known.model_copy(update={"value": 4.0})
    record = make_record().model_copy(
        update={"black_level": known, "gain": half, "full_scale": whole}
    )
    return SignedCalibration(record=record, public_key="0" * 64, signature="0" * 128)


def test_a_camera_without_a_record_is_as_it_was_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    assert made(monkeypatch, None) == (BUNDLE.camera, {"dark": 0.25e-4})


@pytest.mark.parametrize(("black_level", "dark"), [(1e-5, 2e-5), (1.0, 4e-4)])
def test_of_a_measured_camera_its_dark_is_known_no_worse(
    monkeypatch: pytest.MonkeyPatch, black_level: float, dark: float
) -> None:
    signed = signed_with(black_level)
    camera, rest = made(monkeypatch, signed)
    assert camera is BUNDLE.camera
    assert rest.pop("dark") == pytest.approx(dark)
    assert rest == {"imperfections": imperfections_of(signed.record)}
