"""What stands in for a Raspberry Pi below the real picamera2, on libcamera's virtual pipeline.

That pipeline gives one stream, NV12, as fast as it is asked, and of a frame it tells
``SensorTimestamp`` alone: when it was asked for. There is no DMA heap either. So buffers are in
ordinary shared memory, and :class:`RawPicamera2` takes the bytes of an NV12 frame as raw pixels of
16 bits, knows the controls of an IMX477, and tells exposure and gain as they were asked. All else
is picamera2's own: configuring and measurement back, controls and their types, threads, jobs,
requests, waiting, flushing, stopping and closing.
"""

# ruff: noqa: E402 - what picamera2 imports must be there before

from __future__ import annotations

import mmap
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock, patch

# Bindings for a screen, which picamera2 imports and nobody uses.
sys.modules.setdefault("kms", MagicMock(name="kms"))

import libcamera
import picamera2.picamera2 as module
from libcamera import controls
from picamera2 import CompletedRequest, Picamera2
from picamera2.allocators.allocator import Allocator
from picamera2.previews import NullPreview

from veilcam_server.devices.raw import SensorMode

MODE = SensorMode(96, 96, line_time=0.0, frame_duration=0.002)
"""Of the raw frames: as many bytes as NV12 has for the 128 x 96 pixels of virtual.yaml."""
BUFFERS = 4
"""The virtual pipeline has so many, whatever is asked."""
ROUND = 0.002
"""Least time between two rounds of picamera2's event loop [s]. Frames come 12,000 times a second
otherwise, and leave little of the processor to whoever waits for one."""
ADVERTISED = {
    control.name: (control, SimpleNamespace(min=0, max=0, default=0))
    for control in (
        controls.AeEnable,
        controls.AnalogueGain,
        controls.AwbEnable,
        controls.ExposureTime,
        controls.FrameDurationLimits,
        controls.draft.NoiseReductionMode,
    )
}
"""Those of an IMX477's controls that are used, as libcamera defines them."""


class SharedMemory(Allocator):  # type: ignore[misc]
    """Buffers for frames, one file in memory each, in the place of ``DmaAllocator``."""

    def __init__(self) -> None:
        super().__init__()
        self.sync = _Mapped
        self.maps: dict[Any, mmap.mmap] = {}
        self._buffers: dict[Any, list[Any]] = {}
        self._files: list[int] = []

    def allocate(self, libcamera_config: Any, use_case: object) -> None:
        self.close()
        for stream in libcamera_config:
            luma = stream.stride * stream.size.height
            self._buffers[stream.stream] = [
                self._buffer(stream.frame_size, luma) for _ in range(stream.buffer_count)
            ]

    def _buffer(self, size: int, luma: int) -> Any:
        file = os.memfd_create("frame")
        self._files.append(file)
        os.ftruncate(file, size)
        planes = []
        for offset, length in ((0, luma), (luma, size - luma)):
            plane = libcamera.FrameBuffer.Plane()
            plane.fd, plane.offset, plane.length = file, offset, length
            planes.append(plane)
        buffer = libcamera.FrameBuffer(planes)
        self.maps[buffer] = mmap.mmap(file, size)
        return buffer

    def buffers(self, stream: Any) -> list[Any]:
        return self._buffers[stream]

    def close(self) -> None:
        for file in self._files:
            os.close(file)
        self._files, self._buffers, self.maps = [], {}, {}

    def __del__(self) -> None:
        # All that picamera2 does with it when it closes.
        self.close()


class _Mapped:
    def __init__(self, allocator: SharedMemory, buffer: Any, write: bool) -> None:
        self._map = allocator.maps[buffer]

    def __enter__(self) -> mmap.mmap:
        return self._map

    def __exit__(self, *_: object) -> None:
        """Nothing was locked."""


class PlainPicamera2(Picamera2):  # type: ignore[misc]
    """A camera without raw frames; to open it at all, picamera2 is told of a raw mode."""

    def _get_raw_modes(self) -> list[dict[str, Any]]:
        return [{"format": f"SRGGB{MODE.bit_depth}", "size": MODE.size}]

    def _make_requests(self) -> list[Any]:
        # The virtual pipeline still reads a request that it has just completed; one that is dropped
        # at that moment, as by a listener that dies, is memory that is gone.
        self.requests = requests = list(super()._make_requests())
        return requests


class RawPicamera2(PlainPicamera2):
    """A camera with raw frames: its one stream is the raw one, too."""

    def __init__(self, camera_num: int = 0) -> None:
        self.told: dict[str, Any] = {}
        super().__init__(camera_num)

    def _is_rpi_camera(self) -> bool:
        return True

    @property
    def camera_ctrl_info(self) -> dict[str, Any]:
        return self._advertised

    @camera_ctrl_info.setter
    def camera_ctrl_info(self, advertised: dict[str, Any]) -> None:
        self._advertised = advertised | ADVERTISED

    def set_controls(self, controls: dict[str, Any]) -> None:
        super().set_controls(controls)
        self.told = self.told | controls

    def _make_libcamera_config(self, camera_config: dict[str, Any]) -> Any:
        config = super()._make_libcamera_config(camera_config | {"raw": None})
        self.raw_index = self.main_index
        return config

    def _update_camera_config(self, camera_config: dict[str, Any], libcamera_config: Any) -> None:
        super()._update_camera_config(camera_config, libcamera_config)
        # As a Raspberry Pi 5 has them: 12 bits in the high end of 16.
        camera_config["raw"] |= {"format": "SRGGB16", "size": MODE.size, "stride": 2 * MODE.columns}


class RawRequest(CompletedRequest):  # type: ignore[misc]
    def __init__(self, request: Any, picam2: RawPicamera2) -> None:
        super().__init__(request, picam2)
        self._told = picam2.told

    def get_metadata(self) -> dict[str, Any]:
        names = ("ExposureTime", "AnalogueGain")
        told = {name: self._told[name] for name in names if name in self._told}
        return {**super().get_metadata(), **told, "DigitalGain": 1.0}


def _pause(preview: object, request: object) -> None:
    time.sleep(ROUND)


@contextmanager
def instead_of(camera: type[PlainPicamera2]) -> Iterator[None]:
    with (
        patch("picamera2.Picamera2", camera),
        patch.object(module, "DmaAllocator", SharedMemory),
        patch.object(
            module, "CompletedRequest", RawRequest if camera is RawPicamera2 else CompletedRequest
        ),
        patch.object(NullPreview, "render_request", _pause),
    ):
        yield
