"""The scene in front of a simulated camera: a file that somebody outside the daemon writes.

Writing the file is holding something up in front of the camera. Only the simulated sensor reads it.
"""

from __future__ import annotations

import os
import tempfile
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from veilcam_server.devices.errors import SensorError

MAX_BYTES = 64 * 2**20


class SceneSource(Protocol):
    """Whatever is in front of the camera now."""

    def read(self) -> npt.NDArray[np.float32]:
        """Return reflectance in [0, 1], shape (rows, columns).

        Raises:
            SensorError: there is nothing that light could come from.
        """


class FileScene:
    """An image in a ``.npy`` file: uint8 (0 to 255) or float (0 to 1), shape of the scene."""

    def __init__(self, path: Path, shape: tuple[int, int]) -> None:
        self._path, self._shape = path, shape

    def read(self) -> npt.NDArray[np.float32]:
        """Read the file as it is at this moment."""
        try:
            if self._path.stat().st_size > MAX_BYTES:
                raise SensorError(f"scene file {self._path} is too large: use a .npy image")
            with self._path.open("rb") as stream:
                image = np.load(stream, allow_pickle=False)
        except FileNotFoundError:
            raise SensorError(
                f"there is no scene file {self._path}: write one with 'veilcamd show'"
            ) from None
        except (OSError, ValueError, EOFError):
            raise SensorError(
                f"scene file {self._path} is not a .npy image: write one with 'veilcamd show'"
            ) from None
        if not isinstance(image, np.ndarray) or image.shape != self._shape:
            raise SensorError(
                f"scene file {self._path} has the wrong shape: use {self._shape} pixels"
            )
        if image.dtype == np.uint8:
            return (image / np.float32(255)).astype(np.float32)
        if image.dtype.kind != "f" or not bool(((image >= 0) & (image <= 1)).all()):
            raise SensorError(
                f"scene file {self._path} holds no reflectances: use uint8, or floats in [0, 1]"
            )
        return image.astype(np.float32)


def write_scene(path: Path, image: npt.NDArray[np.uint8]) -> None:
    """Hold up ``image``: replace the file at once, so that no reader sees half of it."""
    descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(descriptor, "wb") as stream:
            np.save(stream, image, allow_pickle=False)
        os.replace(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise
