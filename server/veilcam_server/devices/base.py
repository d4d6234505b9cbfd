"""The seam between the daemon and its hardware: a panel to show masks on, and a sensor.

Whatever stands behind it, simulated or real, keeps to these two protocols. All times are those of
``time.monotonic()`` [s]; on Linux that is the clock of camera timestamps too.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np
import numpy.typing as npt

from veilcam_client.wire.simulation import Faults

if TYPE_CHECKING:  # whoever only names devices need not wait for torch
    from veilcam_server.devices.simulated.scenes import Scenes

Levels = npt.NDArray[np.uint8]
Measurement = npt.NDArray[np.float32]
"""(rows, columns) of a gray camera, (3, rows, columns) R, G, B of one in colour."""


@dataclass(frozen=True, slots=True)
class Shown:
    """A mask that reached the panel; ``completed_at`` [s] is when its last byte was written."""

    completed_at: float


@dataclass(frozen=True, slots=True)
class Light:
    """Mean light of a frame, less the electronic black, over that of saturation.

    It is given for the exposure to begin with. In truth a saturated frame had more than ``mean``.
    """

    mean: float = field(repr=False)
    noise: float
    """By how much it may be off."""
    saturated: bool = False

    @property
    def dark(self) -> bool:
        """True where it tells nothing."""
        return self.mean < 5 * self.noise


@dataclass(frozen=True, slots=True)
class Exposure:
    """One measurement and the time in which all of its light was collected.

    ``started_at`` [s] is when the *first* sensor row began to integrate, ``ended_at`` [s] when the
    last one stopped: under a rolling shutter that is more than the exposure time.
    """

    embedding: Measurement = field(repr=False)
    """Binned on the device, shape of the embedding; the raw frame is gone."""
    started_at: float
    ended_at: float
    light: Light = field(repr=False, kw_only=True)
    """Of the raw frame: no calibration enters it."""
    integration: float = 0.0
    """How long each row collected light [s]: it may change from one measurement to the next."""


class OpenDisplay(Protocol):
    """A panel that was set up. After an error it must be closed, and opened again."""

    def show(self, levels: Levels) -> Shown:
        """Write a mask and return once its last byte is out.

        Args:
            levels: shape of the window, 0 (opaque) to ``panel.levels - 1`` (open).

        Raises:
            DisplayError: the panel did not take it, and what it shows now is unknown.
        """

    def blank(self) -> None:
        """Show opaque: the safe state, and the last thing shown before the daemon ends.

        Raises:
            DisplayError: the panel did not take it, and what it shows now is unknown.
        """

    def close(self) -> None:
        """Let go of the bus; the panel goes on showing what it shows."""


class Display(OpenDisplay, Protocol):
    """A panel in front of the sensor, which is set up anew after an error."""

    @property
    def name(self) -> str:
        """Name of the panel, e.g. ``ST7735R``."""

    @property
    def resets(self) -> int:
        """Number of times that it had to be set up anew: a self test holds until then."""


class Sensor(Protocol):
    """A camera without a lens."""

    @property
    def name(self) -> str:
        """Name of the sensor, e.g. ``IMX477``."""

    @property
    def full_scale(self) -> float:
        """Measurement of saturated pixels."""

    def capture(self, not_before: float, timeout: float) -> Exposure:
        """Expose once, starting no earlier than ``not_before``, and bin on the device.

        Args:
            not_before: monotonic time [s] at which the mask is settled.
            timeout: longest wait for the measurement after ``not_before`` [s].

        Raises:
            SensorError: no measurement in time.
            SaturatedError: there is too much light.
            LightError: the light is at fault.
            SensorError: no measurement. One that was started once must now be closed, and started
                again.
        """

    def light(self, not_before: float, timeout: float) -> Light:
        """Return the light of one frame, which may be saturated.

        Automatic exposure does not follow that frame, and the frame is taken at any exposure.

        Args:
            not_before: monotonic time [s] before which the frame does not begin.
            timeout: longest wait for the frame after ``not_before`` [s].

        Raises:
            SensorError: as :meth:`capture`.
        """

    def close(self) -> None:
        """Stop the sensor; twice does no harm.

        Raises:
            SensorHungError: it does not end.
        """


@dataclass(frozen=True, slots=True)
class Device:
    """A panel and the sensor behind it."""

    display: Display
    sensor: Sensor
    simulated: bool
    scenes: Scenes | None = None
    """In front of a simulated one."""
    set_faults: Callable[[Faults], None] | None = None
    """Breaks and mends a simulated one."""

    def close(self) -> None:
        """End safely: stop the sensor, show opaque, let go of both. The display stays on.

        Raises:
            DisplayError: the panel could not be made opaque; it was let go all the same.
        """
        with ExitStack() as stack:
            stack.callback(self.display.close)
            stack.callback(self.display.blank)
            self.sensor.close()
