"""Panels and sensors by name, and from settings to one of each: no other ones than they name."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, TypeVar

import structlog

from veilcam_server.devices import imx477, st7735r
from veilcam_server.devices.base import Device
from veilcam_server.devices.driver import DisplayDriver, SensorDriver
from veilcam_server.devices.errors import DeviceMissingError, DisplayError
from veilcam_server.devices.reopening import ReopeningDisplay, ReopeningSensor
from veilcam_server.settings import Settings
from veilcam_server.wiring import Wiring

if TYPE_CHECKING:
    from veilcam_training.bundle import Bundle

DISPLAYS = {
    driver.name: driver
    for driver in (
        st7735r.DRIVER,
        # Another panel: a file with its driver, and a line here.
    )
}
SENSORS = {
    driver.name: driver
    for driver in (
        imx477.DRIVER,
        # Another sensor likewise.
    )
}

SHARE = 1.0
"""What saturated pixels of a real sensor give before it is calibrated: shares of saturation."""

log = structlog.get_logger()

_Driver = TypeVar("_Driver", DisplayDriver, SensorDriver)


def drivers(wiring: Wiring) -> tuple[DisplayDriver, SensorDriver]:
    """Return those of the panel and the sensor that are named; raises DeviceMissingError."""
    return (
        _named("panel", wiring.panel, DISPLAYS),
        _named("sensor", wiring.sensor, SENSORS),
    )


def open_device(settings: Settings, bundle: Bundle) -> Device:
    """Return the device that the settings name; it is opened when it is needed.

    Raises:
        DeviceError: there can be none as the settings say, or nothing is in front of a simulated
            one.
        StartError: how the simulated one was built cannot be read.
    """
    display, sensor = drivers(settings)
    if settings.panel_read_back is not None and display.identify is None:
        raise DisplayError(f"{display.name} cannot be asked: leave out --panel-read-back")
    if settings.device == "simulated":
        return _simulated(settings, bundle, display, sensor)
    for name, what in display.needs.items():
        if getattr(settings, name) is None:
            raise DeviceMissingError(
                f"the panel is not known: give --{name.replace('_', '-')} {what}, or use --simulate"
            )
    display.check(bundle.camera)
    if display.fastest is not None and settings.spi_hz > display.fastest:
        log.warning("fast panel bus", speed=settings.spi_hz, most=display.fastest)
    return Device(
        ReopeningDisplay(display.name, partial(display.open, settings, bundle.camera)),
        ReopeningSensor(
            sensor.name,
            SHARE,
            partial(sensor.open, settings, bundle.measurement_shape, bundle.embedding.fill),
        ),
        simulated=False,
    )


def _named(kind: str, name: str, known: Mapping[str, _Driver]) -> _Driver:
    if name not in known:
        raise DeviceMissingError(f"--{kind} {name} has no driver: use {' or '.join(known)}")
    return known[name]


def _simulated(
    settings: Settings, bundle: Bundle, display: DisplayDriver, sensor: SensorDriver
) -> Device:
    # Late: whoever asks for real devices needs no torch.
    from veilcam_optics.camera.imperfections import NOMINAL  # noqa: PLC0415

    try:
        from veilcam_server.devices.simulated.device import Conditions, simulated_device  # noqa: PLC0415
        from veilcam_server.devices.simulated.light import (  # noqa: PLC0415
            planned_light,
            read_imperfections,
            use_torch_sparingly,
        )
        from veilcam_server.devices.simulated.panel import REFRESH  # noqa: PLC0415
        from veilcam_server.devices.simulated.scene_files import open_scenes  # noqa: PLC0415
    except ModuleNotFoundError as missing:
        raise DeviceMissingError(
            f"simulated light needs {missing.name}: "
            "run pip install -e '.[simulate]' in the checkout"
        ) from None
    use_torch_sparingly()
    given = settings.imperfections
    imperfections = NOMINAL if given is None else read_imperfections(given, bundle.camera)
    colour = bundle.channels == 3
    return simulated_device(
        planned_light(bundle.camera, bundle.scene, bundle.embedding, imperfections, colour=colour),
        *open_scenes(settings, (3, *bundle.scene.shape) if colour else bundle.scene.shape),
        camera=bundle.camera,
        embedding=bundle.embedding,
        # The panel scans and turns in less than the time that the fence grants it.
        conditions=Conditions(
            settle=0.8 * settings.settle,
            scan=min(REFRESH, 0.1 * settings.settle),
            exposure=settings.exposure,
            snr_db=settings.snr_db,
            read_back=settings.panel_read_back is not None,
        ),
        display=display,
        sensor=sensor,
    )
