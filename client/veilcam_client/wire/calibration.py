"""Calibration of a camera, and its progress."""

from __future__ import annotations

from datetime import datetime
from typing import Literal

from pydantic import Field

from veilcam_client.wire.base import EXAMPLE_DIGEST, EXAMPLE_TIME, Answer, Question

SceneName = Literal["dark", "white card", "lamp"]
"""What is set before a camera that is being measured."""
Stage = Literal["waiting", "measuring", "fitting", "done", "failed", "cancelled"]
"""``waiting`` for somebody to set a scene; after the last three it has ended."""


class Quantity(Answer):
    """One measured number."""

    value: float = Field(allow_inf_nan=False)
    """Measured value, in the unit that its name ends with."""
    uncertainty: float = Field(ge=0, allow_inf_nan=False)
    """Standard uncertainty, in the unit of the value."""
    residual: float = Field(ge=0, allow_inf_nan=False)
    """Root mean square of what the fit left, relative to the measurements [1]."""


class CalibrationRecord(Answer):
    """A camera measured with itself. No mask and no measurement is in it."""

    version: Literal[2] = 2
    """Version of this record."""
    taken_at: datetime
    """Time of the measurement."""
    temperature_c: float | None = None
    """Temperature of the panel [degree Celsius]; None: there is no thermometer."""
    display: str
    """Name of the panel."""
    sensor: str
    """Name of the sensor."""
    simulated: bool
    """True: the camera is simulated."""
    tab: str | None = None
    """Place of the panel's glass in its controller's memory, where that was told."""
    exposure_s: float
    """Exposure that measurements are given for [s]."""
    geometry: str = Field(pattern=r"^[0-9a-f]{64}$")
    """SHA-256 digest of nominal camera, scene and embedding."""
    settling_s: Quantity
    """After a change, until measurements stay within 2 % of the step [s]."""
    black_level: Quantity
    """Measurement without light."""
    gain: Quantity
    """Measurement where a decoder expects 1: a white scene, no mask."""
    full_scale: Quantity
    """Value of saturated pixels to a decoder."""
    gamma: Quantity
    """A sub-pixel told ``w`` passes the amplitude ``floor + (1 - floor) w^gamma``."""
    contrast_floor: Quantity
    """Amplitude of a sub-pixel that is told to be dark."""
    dead_rows: tuple[int, ...] = ()
    """Rows of the mask that do not obey, from 0."""
    dead_columns: tuple[int, ...] = ()
    """Columns of the mask that do not obey, from 0."""
    dead_transmittance: Quantity
    """Amplitude that those pass."""
    shift_y_m: Quantity
    """Displacement of the mask along y, against the middle of the scene [m]."""
    shift_x_m: Quantity
    """Displacement of the mask along x [m]."""
    rotation_rad: Quantity
    """Rotation of the mask around the axis, from x towards y [rad]."""
    distance_error_m: Quantity
    """Distance of the sensor from the mask, minus the nominal one [m]."""
    stray_light: Quantity
    """Share of the light on the sensor that is spread evenly over it."""
    psf_residual: float = Field(ge=0, allow_inf_nan=False)
    """Relative error of the predicted response to a point behind masks that no fit has seen [1]."""
    drift: float = Field(allow_inf_nan=False)
    """Relative change of the light while it was measured [1]."""


class SignedCalibration(Answer):
    """A record and who vouches for it."""

    record: CalibrationRecord
    """Measured values."""
    public_key: str = Field(pattern=r"^[0-9a-f]{64}$")
    """Ed25519, of the daemon that measured."""
    signature: str = Field(pattern=r"^[0-9a-f]{128}$")
    """Ed25519, of the record as compact JSON in the order of its fields."""


class CalibrationRequest(Question):
    """Measure the camera with itself."""

    repeats: int = Field(default=2, ge=1, le=100)
    """Exposures for one measurement."""


class SceneConfirmation(Question):
    """The scene that is waited for is set."""

    scene: SceneName
    """Scene that somebody has set."""


class CalibrationRun(Answer):
    """Progress of a calibration, or its end."""

    stage: Stage
    """Present stage."""
    scene: SceneName | None
    """Scene in front of the camera, or that should be; None before the first and after the last."""
    instruction: str | None
    """Instruction for that scene, while it is waited for."""
    exposures: int
    """Taken so far."""
    total: int
    """Exposures that it takes."""
    detail: str | None
    """Why it failed, and what to do."""


class CalibrationStatus(Answer):
    """Calibration in use."""

    signed: SignedCalibration | None
    """The record in use; None: the camera is taken to be nominal."""
    run: CalibrationRun | None
    """The last calibration that was asked for; None since the daemon started."""


def _quantity(value: float) -> Quantity:
    return Quantity(value=value, uncertainty=0.01, residual=0.002)


def _record() -> CalibrationRecord:
    return CalibrationRecord(
        taken_at=EXAMPLE_TIME,
        temperature_c=23.5,
        display="ST7735R",
        sensor="IMX477",
        simulated=False,
        exposure_s=0.01,
        geometry=EXAMPLE_DIGEST,
        settling_s=_quantity(0.06),
        black_level=_quantity(0.0),
        gain=_quantity(1.0),
        full_scale=_quantity(4.0),
        gamma=_quantity(1.0),
        contrast_floor=_quantity(0.02),
        dead_transmittance=_quantity(0.5),
        shift_y_m=_quantity(1e-5),
        shift_x_m=_quantity(-2e-5),
        rotation_rad=_quantity(0.001),
        distance_error_m=_quantity(2e-5),
        stray_light=_quantity(0.01),
        psf_residual=0.01,
        drift=0.001,
    )


def _run() -> CalibrationRun:
    return CalibrationRun(
        stage="waiting",
        scene="lamp",
        instruction="Put a lamp behind a hole of 17.1 x 17.1 mm in black card.",
        exposures=290,
        total=330,
        detail=None,
    )


def examples() -> tuple[Answer | Question, ...]:
    """Return examples for documents."""
    return (
        CalibrationRequest(repeats=2),
        SceneConfirmation(scene="lamp"),
        _run(),
        CalibrationStatus(
            signed=SignedCalibration(
                record=_record(), public_key=EXAMPLE_DIGEST, signature=2 * EXAMPLE_DIGEST
            ),
            run=_run(),
        ),
    )
