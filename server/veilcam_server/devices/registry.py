"""From settings to a panel and a sensor, and no other ones than the settings name."""

from __future__ import annotations

from contextlib import ExitStack
from functools import partial

from veilcam_server.devices.base import Device
from veilcam_server.devices.errors import DeviceMissingError
from veilcam_server.devices.imx477 import IMX477, ExposureRange
from veilcam_server.devices.picamera import open_picamera2
from veilcam_server.devices.simulated.device import Conditions, planned_light, simulated_device
from veilcam_server.devices.simulated.imperfections import AsBuilt, read_as_built
from veilcam_server.devices.simulated.panel import REFRESH
from veilcam_server.devices.simulated.scene_files import open_scenes
from veilcam_server.devices.spi import LinuxLines, LinuxSpi
from veilcam_server.devices.st7735r import ST7735R, TABS
from veilcam_server.settings import Settings
from veilcam_training.bundle import Bundle


def open_device(settings: Settings, bundle: Bundle) -> Device:
    """Return the device that the settings name; its panel is opaque.

    Raises:
        DeviceError: it is not there, or there is nothing in front of a simulated one.
        StartError: how the simulated one was built cannot be read.
    """
    return (_simulated if settings.device == "simulated" else _pi)(settings, bundle)


def _pi(settings: Settings, bundle: Bundle) -> Device:
    if settings.panel_tab is None:
        raise DeviceMissingError(
            "the panel is not known: say the colour of its film's tab with --panel-tab red, black "
            "or green (see docs/device.md), or use --simulate"
        )
    with ExitStack() as undo:
        spi = LinuxSpi.open(str(settings.spi), settings.spi_hz, allow_fast=settings.allow_fast_spi)
        undo.callback(spi.close)
        lines = LinuxLines.open(
            settings.gpio_chip, data=settings.data_line, reset=settings.reset_line
        )
        undo.callback(lines.close)
        # The panel first: it is opaque before there is anybody to see through it.
        display = ST7735R(spi, lines, camera=bundle.camera, tab=TABS[settings.panel_tab])
        sensor = IMX477(
            partial(open_picamera2, settings.camera_number),
            shape=bundle.embedding.shape,
            exposures=ExposureRange(settings.exposure, settings.exposure_factor),
        )
        undo.pop_all()
    return Device(display, sensor, simulated=False)


def _simulated(settings: Settings, bundle: Bundle) -> Device:
    built = AsBuilt() if settings.as_built is None else read_as_built(settings.as_built)
    built.require_lines(*bundle.camera.mask_shape)
    return simulated_device(
        planned_light(bundle.camera, bundle.scene, bundle.embedding, built.conditions),
        *open_scenes(settings, bundle.scene.shape),
        camera=bundle.camera,
        embedding=bundle.embedding,
        # The panel scans and turns in less than the time that the fence grants it.
        conditions=Conditions(
            settle=0.8 * settings.settle,
            scan=min(REFRESH, 0.1 * settings.settle),
            exposure=settings.exposure,
            snr_db=settings.snr_db,
            dead_rows=built.dead_rows,
            dead_columns=built.dead_columns,
            dead_level=built.dead_level,
        ),
    )
