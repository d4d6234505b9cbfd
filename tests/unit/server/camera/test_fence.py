"""The fence: which times can be kept, and which measurements are thrown away."""

from __future__ import annotations

import math

import numpy as np
import pytest

from veilcam_server.camera.capture import Fence, check_exposure
from veilcam_server.devices import Exposure
from veilcam_server.devices.base import Light
from veilcam_server.errors import FenceError

SHAPE = (4, 5)
MEASUREMENT = np.ones(SHAPE, np.float32)


def check(started: float, ended: float, measurement: np.ndarray = MEASUREMENT) -> None:
    """An exposure behind a mask that had settled at 10 s, given out at 12 s."""
    exposure = Exposure(measurement, started, ended, light=Light(1.0, 1e-4))
    check_exposure(exposure, not_before=10.0, ended=12.0, shape=SHAPE)


def test_times_to_start_from() -> None:
    assert (Fence().settle, Fence().timeout) == (0.1, 5.0)


@pytest.mark.parametrize(("settle", "timeout"), [(0.0, 5.0), (0.4, 1e-3), (10.0, 600.0)])
def test_times_that_can_be_kept(settle: float, timeout: float) -> None:
    assert Fence(settle, timeout).settle == settle
    assert Fence(settle, timeout).timeout == timeout


@pytest.mark.parametrize("settle", [-1e-9, -0.1, math.inf, math.nan])
def test_settling_time_that_cannot_be(settle: float) -> None:
    with pytest.raises(ValueError, match=r"settle = .* s is not valid: use a number >= 0"):
        Fence(settle=settle)


@pytest.mark.parametrize("timeout", [0.0, -1.0, math.inf, math.nan])
def test_timeout_that_cannot_be(timeout: float) -> None:
    with pytest.raises(ValueError, match=r"timeout = .* s is not valid: use a number > 0"):
        Fence(timeout=timeout)


@pytest.mark.parametrize(
    ("started", "ended"),
    [(10.5, 11.5), (10.0, 11.0), (11.0, 12.0), (10.0, 12.0), (11.0, 11.0)],
)
def test_exposure_within_the_fence_is_taken_up_to_its_ends(started: float, ended: float) -> None:
    check(started, ended)


@pytest.mark.parametrize(
    ("started", "ended"),
    [
        (math.nextafter(10.0, 0.0), 11.0),
        (11.0, math.nextafter(12.0, 13.0)),
        (11.5, 11.0),
        (12.5, 13.0),
        (9.0, 9.5),
        (math.nan, 11.0),
        (11.0, math.nan),
    ],
)
def test_exposure_that_leaves_the_fence_is_thrown_away(started: float, ended: float) -> None:
    with pytest.raises(FenceError, match="thrown away: try again"):
        check(started, ended)


def test_exposure_says_how_much_too_early_it_began() -> None:
    with pytest.raises(FenceError, match=r"began -0\.2500 s after the mask had settled"):
        check(9.75, 11.0)


@pytest.mark.parametrize("shape", [(5, 4), (4, 5, 1), (20,), ()])
def test_measurement_of_another_shape_is_refused(shape: tuple[int, ...]) -> None:
    with pytest.raises(FenceError, match="check that the bundle fits this device"):
        check(10.5, 11.5, np.ones(shape, np.float32))


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_one_number_that_is_not_finite_is_enough(value: float) -> None:
    measurement = MEASUREMENT.copy()
    measurement[2, 3] = value
    with pytest.raises(FenceError, match="not finite"):
        check(10.5, 11.5, measurement)
