"""Drivers of panels and sensors: what each needs, how it is opened, and what stands in for it.

A driver is a file here with one of these two, and a line in ``registry.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt

from veilcam_client.wire.simulation import PanelFaults, SensorFaults
from veilcam_optics.camera.geometry import Camera
from veilcam_server.devices.base import Levels, OpenDisplay, Sensor
from veilcam_server.devices.raw import Raw, SensorMode
from veilcam_server.settings import Settings
from veilcam_server.wiring import Wiring

RawLight = Callable[[float, float], Raw]
"""Takes begin and end of an exposure [s, monotonic], gives a raw frame of (rows, columns)."""


class EmulatedPanel(Protocol):
    """Emulated panel; arrays have the shape of the whole panel."""

    faults: PanelFaults
    """What is wrong with it."""

    def framebuffer(self) -> Levels:
        """Return the levels that the panel was asked to show."""

    def visible(self, at: float) -> npt.NDArray[np.float32]:
        """Return the levels that it shows at a time [s, monotonic], also between two masks."""

    def settled(self, at: float) -> bool:
        """Return whether it shows its framebuffer from a time on [s], until that changes."""


class EmulateDisplay(Protocol):
    """Opens an emulated panel."""

    def __call__(
        self,
        camera: Camera,
        *,
        scan: float,
        settle: float,
        read_back: bool,
        clock: Callable[[], float],
    ) -> tuple[Callable[[], OpenDisplay], EmulatedPanel]:
        """Return what sets the panel up, and the panel as it is looked through.

        Args:
            camera: camera whose window is the mask.
            scan: time between two refreshes of a line [s].
            settle: time that a sub-pixel takes to turn after that [s].
            read_back: True: the panel is asked after each mask if it shows it.
            clock: monotonic time [s].
        """


class EmulateSensor(Protocol):
    """Starts a sensor before a simulated light."""

    def __call__(
        self,
        light: RawLight,
        mode: SensorMode,
        *,
        shape: tuple[int, ...],
        fill: float = 1.0,
        exposure: float,
        full_scale: float,
        clock: Callable[[], float],
        sleep: Callable[[float], None],
    ) -> tuple[Callable[[], Sensor], Callable[[SensorFaults], None]]:
        """Return what starts the sensor, and what breaks and mends it.

        Args:
            light: gives raw frames.
            mode: mode of these frames.
            shape: shape of a measurement.
            fill: side of the box that a value averages, as a share of its embedding pixel's.
            exposure: exposure of every frame [s].
            full_scale: measurement of saturated pixels.
            clock: monotonic time [s].
            sleep: waits so many seconds.
        """


@dataclass(frozen=True, slots=True, kw_only=True)
class DisplayDriver:
    """A kind of panel."""

    name: str
    """As settings and the API have it."""
    open: Callable[[Wiring, Camera], OpenDisplay]
    """Opens it, opaque, for the camera whose window is the mask; raises :class:`DeviceError`."""
    check: Callable[[Camera], None] = lambda _: None
    """Refuses a camera with another panel; raises :class:`DisplayError`."""
    identify: Callable[[Wiring], str] | None = None
    """Asks the panel who it is and changes nothing; raises :class:`DeviceError`. None for a panel
    that cannot be asked."""
    emulate: EmulateDisplay | None = None
    packages: tuple[str, ...] = ()
    """To import when it is opened."""
    needs: Mapping[str, str] = field(default_factory=dict)
    """Settings without which it cannot be opened, and what to give for each."""
    fastest: int | None = None
    """Fastest clock of its bus [Hz]; None for a panel that is not on SPI and two lines."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorDriver:
    """A kind of sensor."""

    name: str
    """As settings and the API have it."""
    model: str
    """Part of what libcamera calls it."""
    product: str
    """What to buy."""
    open: Callable[[Settings, tuple[int, ...], float], Sensor]
    """Starts it, for measurements of a shape and a fill; raises :class:`DeviceError`."""
    emulate: EmulateSensor | None = None
    packages: tuple[str, ...] = ()
    """To import when it is opened."""
