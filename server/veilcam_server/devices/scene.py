"""One scene in front of a simulated camera: a file that somebody holds up, or a picture.

Writing the file is holding something up in front of the camera. Only the simulated sensor reads it.
"""

from __future__ import annotations

import os
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from veilcam_server.devices.errors import SensorError
from veilcam_server.devices.images import Picture, PictureError, decode, fitted

MAX_BYTES = 64 * 2**20


class SceneSource(Protocol):
    """One scene."""

    def read(self) -> npt.NDArray[np.float32]:
        """Return reflectance in [0, 1], shape (rows, columns).

        Raises:
            SensorError: there is nothing that light could come from.
        """


class FileScene:
    """A picture in a file, ``.npy``, PNG or JPEG, fitted to the shape of the scene."""

    def __init__(self, path: Path, shape: tuple[int, int]) -> None:
        self._path, self._shape = path, shape

    def read(self) -> npt.NDArray[np.float32]:
        """Read the file as it is at this moment."""
        try:
            with self._path.open("rb") as stream:
                content = stream.read(MAX_BYTES + 1)
            if len(content) > MAX_BYTES:
                raise SensorError(
                    f"scene file {self._path} is too large: use at most {MAX_BYTES >> 20} MiB"
                )
            return fitted(decode(content), self._shape)
        except FileNotFoundError:
            raise SensorError(
                f"there is no scene file {self._path}: check --scenes, or 'veilcamd show' a digit"
            ) from None
        except OSError as error:
            raise SensorError(
                f"scene file {self._path} cannot be read ({error.strerror})"
            ) from None
        except PictureError as error:
            raise SensorError(f"scene file {self._path} {error}") from None


@dataclass(frozen=True, eq=False, slots=True)
class StillScene:
    """A picture in memory, fitted to the shape of the scene whenever it is looked at."""

    picture: Picture = field(repr=False)
    shape: tuple[int, int]

    def read(self) -> npt.NDArray[np.float32]:
        """Return the picture; raises :class:`PictureError` for what is none."""
        return fitted(self.picture, self.shape)


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
