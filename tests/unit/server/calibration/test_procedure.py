"""A camera that was built badly finds out how, or refuses to say."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch

from veilcam_client.wire.calibration import CalibrationRecord
from veilcam_optics.camera import imperfections as optical
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_server.calibration.measurements import SETTLED
from veilcam_server.calibration.record import imperfections_of
from veilcam_server.devices.corrected import CalibratedSensor
from veilcam_server.devices.simulated.device import Conditions
from veilcam_server.errors import CalibrationError

from .camera import BUDGET, GEOMETRY, QUIET, SCAN, SETTLE, Built

Image = npt.NDArray[np.float32]
BADLY = optical.Imperfections(
    shift_y=30e-6,
    shift_x=-50e-6,
    rotation=4e-3,
    distance_error=80e-6,
    gamma=1.5,
    contrast_floor=0.1,
)


@pytest.fixture(scope="module")
def badly() -> tuple[Built, CalibrationRecord]:
    built = Built(BADLY)
    return built, built.calibrate().record


@pytest.mark.thorough
def test_calibration_finds_how_the_camera_was_built(badly: tuple[Built, CalibrationRecord]) -> None:
    built, record = badly
    assert built.presented == ["dark", "white card", "lamp"]
    assert built.captures == BUDGET.captures(GEOMETRY)
    for quantity, true, tolerance in (
        (record.shift_y_m, 30e-6, 1e-6),
        (record.shift_x_m, -50e-6, 1e-6),
        (record.rotation_rad, 4e-3, 1e-3),
        (record.distance_error_m, 80e-6, 20e-6),
        (record.gamma, 1.5, 0.01),
        (record.contrast_floor, 0.1, 0.005),
        (record.stray_light, 0.0, 0.003),
        (record.gain, 1.0, 0.01),
        (record.black_level, 0.0, 1e-3),
    ):
        assert quantity.value == pytest.approx(true, abs=tolerance)
        assert quantity.uncertainty < tolerance
    assert (record.dead_rows, record.dead_columns, record.temperature_c) == ((), (), None)
    full_scale = built.device.sensor.full_scale
    assert record.full_scale.value == pytest.approx(full_scale, rel=0.01)
    assert 0 < record.psf_residual < 0.03
    assert abs(record.drift) < 0.01


@pytest.mark.slow
def test_decoders_for_what_was_found_expect_what_is_read(
    badly: tuple[Built, CalibrationRecord],
) -> None:
    built, record = badly
    found = imperfections_of(record)
    camera, scene, embedding = GEOMETRY.camera, GEOMETRY.scene, GEOMETRY.embedding
    levels = np.random.default_rng(9).integers(0, 64, camera.mask_shape).astype(np.uint8)
    built.image = np.random.default_rng(8).random(scene.shape, np.float32)
    shown = built.device.display.show(levels)
    seen = built.device.sensor.capture(shown.completed_at + 0.1, 1.0).embedding.ravel()
    errors = []
    for known in (found, optical.NOMINAL):
        weights = known.shown(torch.from_numpy(levels / np.float32(63)))
        transfer = TransferOperator(camera, scene, embedding, imperfections=known)(weights)
        expected = torch.from_numpy(built.image).reshape(1, -1) @ transfer
        errors.append(np.linalg.norm(expected.numpy()[0] - seen) / np.linalg.norm(seen))
    assert errors[0] < 0.03
    assert errors[1] > 10 * errors[0]


@pytest.mark.thorough
def test_calibration_finds_stray_light_and_puts_it_back() -> None:
    built = Built(replace(BADLY, stray_light=0.1))
    record = built.calibrate().record
    assert record.stray_light.value == pytest.approx(0.1, abs=0.003)
    assert record.stray_light.uncertainty < 0.003
    assert record.shift_y_m.value == pytest.approx(30e-6, abs=1e-6)
    assert record.distance_error_m.value == pytest.approx(80e-6, abs=20e-6)
    assert record.psf_residual < 0.03
    seen = []
    levels = np.full(GEOMETRY.camera.mask_shape, 40, np.uint8)
    for each in (built, Built(BADLY)):
        each.image = np.random.default_rng(8).random(GEOMETRY.scene.shape, np.float32)
        shown = each.device.display.show(levels)
        seen.append(each.device.sensor.capture(shown.completed_at + 0.1, 1.0).embedding)
    corrected = CalibratedSensor.of(built.device.sensor, record).corrected(seen[0])
    for measurement, low, high in ((corrected, 0.0, 0.03), (seen[0], 0.03, 1.0)):
        difference = np.linalg.norm(measurement - seen[1]) / np.linalg.norm(seen[1])
        assert low < difference < high


@pytest.mark.thorough
def test_calibration_finds_stuck_lines_and_what_they_pass() -> None:
    imperfections = optical.Imperfections(
        gamma=1.3, dead_rows=(4,), dead_columns=(5,), dead_transmittance=1.0
    )
    record = Built(imperfections).calibrate().record
    assert (record.dead_rows, record.dead_columns) == ((4,), (5,))
    assert record.dead_transmittance.value == pytest.approx(1.0, abs=0.02)
    assert record.contrast_floor.value < 0.05
    assert record.gamma.value == pytest.approx(1.3, abs=0.02)
    assert record.shift_y_m.value == pytest.approx(0.0, abs=1e-6)
    assert record.psf_residual < 0.03


@pytest.mark.thorough
def test_dead_lines_do_not_hide_the_floor() -> None:
    """A dark dead row shows what every dark sub-pixel does."""
    imperfections = optical.Imperfections(
        gamma=1.4, contrast_floor=0.08, dead_rows=(4,), dead_transmittance=0.08
    )
    record = Built(imperfections).calibrate().record
    assert record.dead_rows == (4,)
    assert record.contrast_floor.value == pytest.approx(0.08, abs=0.01)
    assert record.dead_transmittance.value == pytest.approx(0.08, abs=0.05)
    assert record.gamma.value == pytest.approx(1.4, abs=0.03)


@pytest.mark.slow
def test_settling_is_that_of_the_slowest_line() -> None:
    built = Built()
    settling = built.calibrate(budget=replace(BUDGET, samples=9)).record.settling_s
    # A linear turn is 2 % short of its end a little before it; light goes with its square.
    assert settling.value > SETTLE * (1 - SETTLED)
    assert settling.value <= SETTLE + SCAN + settling.uncertainty
    assert 0 < settling.uncertainty < 0.005


def test_panel_is_opaque_afterwards_come_what_may() -> None:
    built = Built()
    blanks = []
    built.device.display.blank = lambda: blanks.append(built.captures)  # type: ignore[method-assign]
    with pytest.raises(CalibrationError, match="longer --settle"):
        built.calibrate(longest=0.02)
    assert blanks == [built.captures]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda _, image: image * np.float32(0.004), "too little light"),
        (lambda _, image: np.full_like(image, 0.8), "cover it"),
        pytest.param(
            lambda name, image: np.roll(image, 2, axis=0) if name == "lamp" else image,
            "where they should be",
            marks=pytest.mark.thorough,
        ),
    ],
    ids=["dim card", "light in the dark", "lamp elsewhere"],
)
def test_scene_that_is_not_as_asked_is_refused(
    change: Callable[[str, Image], Image], told: str
) -> None:
    built = Built()
    present = built.present
    built.present = lambda scene: present(  # type: ignore[method-assign]
        replace(scene, image=change(scene.name, scene.image))
    )
    with pytest.raises(CalibrationError, match=told):
        built.calibrate()


@pytest.mark.parametrize(
    ("darkest", "told"),
    [(0, "does not hide"), (32, "no power law")],
    ids=["always open", "two levels"],
)
def test_panel_that_shows_something_else_is_refused(darkest: int, told: str) -> None:
    """Everything from the darkest on is shown as open."""
    built = Built()
    show = built.device.display.show
    built.device.display.show = lambda levels: show(  # type: ignore[method-assign]
        np.where(levels >= darkest, 63, 0).astype(np.uint8)
    )
    with pytest.raises(CalibrationError, match=told):
        built.calibrate()


@pytest.mark.parametrize(
    ("imperfections", "hardware", "told"),
    [
        ({}, replace(QUIET, warm_up=0.3, warm_up_time=5.0), "warm up"),
        ({"dead_rows": (0, 1, 2, 3)}, QUIET, "4 of 15 rows"),
        pytest.param(
            {"rotation": 40e-3},
            QUIET,
            "turned by|where they should be",
            marks=pytest.mark.slow,
        ),
    ],
    ids=["drift", "dead lines", "turned mask"],
)
def test_camera_that_cannot_be_measured_is_refused(
    imperfections: dict[str, Any], hardware: Conditions, told: str
) -> None:
    with pytest.raises(CalibrationError, match=told):
        Built(optical.Imperfections(**imperfections), hardware).calibrate()
