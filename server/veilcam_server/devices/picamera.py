"""What is used of picamera2: its shape, and how to open the real one, which is the system's."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from functools import partial
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from veilcam_server.devices.errors import DeviceMissingError
from veilcam_server.devices.extras import import_extra


class Request(Protocol):
    """A frame that was taken, for as long as it is held."""

    def make_array(self, name: str) -> npt.NDArray[np.uint8]:
        """Return a copy of a stream's buffer; of ``raw``, bytes of shape (rows, stride)."""

    def get_metadata(self) -> dict[str, Any]:
        """Return what the camera tells of it."""


class Picamera(Protocol):
    """The part of ``picamera2.Picamera2`` that is used; it raises whatever it likes."""

    def create_video_configuration(
        self,
        *,
        main: dict[str, Any],
        raw: dict[str, Any],
        sensor: dict[str, Any],
        buffer_count: int,
        queue: bool,
    ) -> dict[str, Any]:
        """Return a configuration for :meth:`configure`."""

    def configure(self, camera_config: dict[str, Any]) -> object:
        """Ask for a configuration; what is given may differ."""

    def camera_configuration(self) -> Mapping[str, Any]:
        """Return what was given; ``raw`` is None if the camera gives no raw frames."""

    def set_controls(self, controls: dict[str, Any]) -> None:
        """Change controls, some frames from now; from the first one on if it is not started."""

    def start(self) -> object:
        """Begin to take frames."""

    def captured_request(self, *, wait: float, flush: int) -> AbstractContextManager[Request]:
        """Wait for a frame whose exposure began at ``flush`` [ns, monotonic] or later.

        Raises:
            TimeoutError: there was none for ``wait`` seconds.
        """

    def cancel_all_and_flush(self) -> None:
        """Drop requests that were not answered."""

    def close(self) -> object:
        """Stop, and let go of the camera."""


def open_picamera2(number: int = 0) -> Picamera:
    """Open a camera of a Raspberry Pi.

    Raises:
        DeviceMissingError: it is not there or not to be had, or there is no picamera2 to import.
    """
    picamera2 = import_extra("picamera2")
    return opened(partial(picamera2.Picamera2, number), number)


def opened(make: Callable[[], Picamera], number: int) -> Picamera:
    """Return the camera that ``make`` opens; raises :class:`DeviceMissingError`."""
    try:
        return make()
    except (RuntimeError, IndexError, OSError) as error:
        if isinstance(error, OSError) or "dmaHeap" in str(error):
            reason = "its memory /dev/dma_heap cannot be opened: be in the group video"
        elif "did not complete" in str(error):
            reason = "end whatever else uses it, and be in the group video"
        else:
            raise DeviceMissingError(
                f"there is no camera {number}: check its cable, and see rpicam-hello --list-cameras"
            ) from None
        raise DeviceMissingError(f"camera {number} cannot be opened: {reason}") from None
