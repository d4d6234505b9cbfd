"""Interface of picamera2 as used here, and how to open the real one, which is the system's."""

from __future__ import annotations

import gc
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from functools import partial
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from veilcam_server.devices.errors import DeviceMissingError, Refused, in_one_line
from veilcam_server.devices.extras import import_extra, reinstall


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
    return opened(lambda: picamera2.Picamera2(number), number)


def opened(make: Callable[[], Picamera], number: int) -> Picamera:
    """Return the camera that ``make`` opens; raises :class:`DeviceMissingError`."""
    try:
        with Refused(partial(_not_opened, number)):
            return make()
    except DeviceMissingError:
        # A half-made camera refers to itself, and has the camera until it is collected.
        gc.collect()
        raise


def _not_opened(number: int, error: Exception) -> DeviceMissingError:
    told = in_one_line(error)
    if "did not complete" in told or "busy" in told:
        reason = "end whatever else uses it, and be in the group video"
    elif isinstance(error, OSError) or "dmaHeap" in told:
        reason = "its memory /dev/dma_heap cannot be opened: be in the group video"
    elif isinstance(error, IndexError) or "No camera" in told:
        return DeviceMissingError(
            f"there is no camera {number}: check its cable, and see rpicam-hello --list-cameras"
        )
    elif isinstance(error, RuntimeError):
        reason = "check its cable, and see rpicam-hello --list-cameras"
    else:
        reason = reinstall("picamera2")
    return DeviceMissingError(f"camera {number} cannot be opened ({told}): {reason}")
