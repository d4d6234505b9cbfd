"""Panels and sensors by name, and from settings to one of each: no other ones than they name."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from typing import TypeVar

from veilcam_optics.camera.imperfections import NOMINAL
from veilcam_server.devices import imx477, st7735r
from veilcam_server.devices.base import Device
from veilcam_server.devices.driver import DisplayDriver, SensorDriver
from veilcam_server.devices.errors import DeviceMissingError
from veilcam_server.devices.simulated.device import Conditions, planned_light, simulated_device
from veilcam_server.devices.simulated.imperfections import read_imperfections
from veilcam_server.devices.simulated.panel import REFRESH
from veilcam_server.devices.simulated.scene_files import open_scenes
from veilcam_server.settings import Settings, Wiring
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

_Driver = TypeVar("_Driver", DisplayDriver, SensorDriver)


def drivers(wiring: Wiring) -> tuple[DisplayDriver, SensorDriver]:
    """Return those of the panel and the sensor that are named; raises DeviceMissingError."""
    return (
        _named("panel", wiring.panel, DISPLAYS),
        _named("sensor", wiring.sensor, SENSORS),
    )


def open_device(settings: Settings, bundle: Bundle) -> Device:
    """Return the device that the settings name; its panel is opaque.

    Raises:
        DeviceError: it is not there, or there is nothing in front of a simulated one.
        StartError: how the simulated one was built cannot be read.
    """
    display, sensor = drivers(settings)
    if settings.device == "simulated":
        return _simulated(settings, bundle, display, sensor)
    for name, what in display.needs.items():
        if getattr(settings, name) is None:
            raise DeviceMissingError(
                f"the panel is not known: give --{name.replace('_', '-')} {what}, or use --simulate"
            )
    with ExitStack() as undo:
        # The panel first: it is opaque before there is anybody to see through it.
        panel = display.open(settings, bundle.camera)
        undo.callback(panel.close)
        device = Device(panel, sensor.open(settings, bundle.embedding.shape), simulated=False)
        undo.pop_all()
    return device


def _named(kind: str, name: str, known: Mapping[str, _Driver]) -> _Driver:
    if name not in known:
        raise DeviceMissingError(f"--{kind} {name} has no driver: use {' or '.join(known)}")
    return known[name]


def _simulated(
    settings: Settings, bundle: Bundle, display: DisplayDriver, sensor: SensorDriver
) -> Device:
    given = settings.imperfections
    imperfections = NOMINAL if given is None else read_imperfections(given, bundle.camera)
    return simulated_device(
        planned_light(bundle.camera, bundle.scene, bundle.embedding, imperfections),
        *open_scenes(settings, bundle.scene.shape),
        camera=bundle.camera,
        embedding=bundle.embedding,
        # The panel scans and turns in less than the time that the fence grants it.
        conditions=Conditions(
            settle=0.8 * settings.settle,
            scan=min(REFRESH, 0.1 * settings.settle),
            exposure=settings.exposure,
            snr_db=settings.snr_db,
        ),
        display=display,
        sensor=sensor,
    )
