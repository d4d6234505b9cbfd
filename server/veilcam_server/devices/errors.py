"""What can go wrong with a panel or a sensor. No message ever holds a level or a measurement."""

from __future__ import annotations

from veilcam_server.errors import ProblemError


class DeviceError(Exception):
    """Base: a panel or sensor that did not do what it was asked."""


class DeviceMissingError(DeviceError):
    """A device that the configuration names and that is not there."""


class DisplayError(
    DeviceError,
    ProblemError,
    code="display_failed",
    status=503,
    title="The panel failed",
    retryable=True,
    remedy="check_panel_wiring",
):
    """The panel did not take a mask; what it shows now is unknown."""


class SensorError(
    DeviceError,
    ProblemError,
    code="sensor_failed",
    status=503,
    title="The sensor failed",
    retryable=True,
    remedy="check_camera_cable",
):
    """The sensor gave no measurement."""


class SensorTimeoutError(
    SensorError,
    code="sensor_timeout",
    status=503,
    title="The sensor gave no measurement in time",
    retryable=True,
):
    """The sensor gave no measurement in time."""


class LightError(SensorError, remedy="adjust_light"):
    """There is too much light, or nothing that it could come from."""


class SaturatedError(LightError):
    """There is too much light for the shortest exposure."""


class SensorHungError(SensorError, remedy="restart"):
    """The sensor's driver does not let go of it: only another process may have it."""
