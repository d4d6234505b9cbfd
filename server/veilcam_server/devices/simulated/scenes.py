"""Scenes in front of a simulated camera, one after the other, each from an instant on.

An exposure sees one scene from its beginning to its end: the one that was there when it began.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np
import numpy.typing as npt

from veilcam_client.numbers import erasable
from veilcam_optics.files import replacing
from veilcam_optics.pictures import PictureError
from veilcam_server.devices.errors import LightError
from veilcam_server.devices.simulated.images import Picture, as_scene, decoded, range_warning

if TYPE_CHECKING:
    import torch

MAX_BYTES = 64 * 2**20


class SceneSource(Protocol):
    """One scene."""

    def read(self) -> npt.NDArray[np.float32]:
        """Return reflectance in [0, 1], (rows, columns), or (3, rows, columns) in colour.

        Raises:
            LightError: there is nothing that light could come from.
        """


class FileScene:
    """A picture in a file, fitted to the shape of the scene."""

    def __init__(self, path: Path, shape: tuple[int, ...]) -> None:
        self.path, self._shape = path, shape

    def read(self) -> npt.NDArray[np.float32]:
        """Read the file as it is at this moment."""
        return self.look()[0]

    def look(self) -> tuple[npt.NDArray[np.float32], str | None]:
        """Read the file, and return what to say of a picture that uses little of its range."""
        try:
            with self.path.open("rb") as stream:
                content = stream.read(MAX_BYTES + 1)
            if len(content) > MAX_BYTES:
                raise LightError(
                    f"scene file {self.path} is too large: use at most {MAX_BYTES >> 20} MiB"
                )
            picture = decoded(content)
            return _fitted(picture, self._shape), range_warning(picture)
        except FileNotFoundError:
            raise LightError(
                f"there is no scene file {self.path}: check --scenes, or 'veilcamd show' a digit"
            ) from None
        except OSError as error:
            raise LightError(f"scene file {self.path} cannot be read ({error.strerror})") from None
        except PictureError as error:
            raise LightError(f"scene file {self.path} {error}") from None


@dataclass(frozen=True, eq=False, slots=True)
class StillScene:
    """A picture in memory, fitted to the shape of the scene whenever it is looked at."""

    picture: Picture = field(repr=False)
    shape: tuple[int, ...]

    def read(self) -> npt.NDArray[np.float32]:
        """Return the picture; raises :class:`PictureError` for what is none."""
        return _fitted(self.picture, self.shape)


def _fitted(picture: Picture, shape: tuple[int, ...]) -> npt.NDArray[np.float32]:
    scene = as_scene(picture, shape)
    held = erasable(scene)
    scene.fill(0)
    return held


def write_scene(path: Path, image: npt.NDArray[np.uint8]) -> None:
    """Hold up ``image``: replace the file at once, so that no reader sees half of it."""
    with replacing(path, private=True) as stream:
        np.save(stream, image, allow_pickle=False)


REMEMBERED = 16
"""Scenes that are remembered for exposures that began before they were replaced."""


@dataclass(frozen=True, slots=True)
class _Shown:
    number: int
    scene: SceneSource
    since: float


class Scenes:
    """A deck of scenes, the next one after each capture, and what is held up before it by program.

    Every scene has a number: those of the deck their place in it, from 0 on, and those held up the
    numbers after that. Safe to use from several threads.

    Args:
        deck: scenes, at least one; after the last comes the first again.
        clock: monotonic time [s], that of the exposures.

    Raises:
        LightError: the first scene cannot be seen.
    """

    def __init__(
        self, deck: Sequence[SceneSource], *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        if not deck:
            raise ValueError("deck = () is not valid: use one scene or more")
        self._deck, self._clock = tuple(deck), clock
        self.shape = self._deck[0].read().shape
        """Of every scene."""
        self._place, self._free = 0, len(self._deck)
        self._shown = deque([_Shown(0, self._deck[0], -math.inf)], maxlen=REMEMBERED)
        self.seen = 0
        """Number of the scene that the last exposure saw."""
        self._lock = threading.Lock()

    def hold(self, picture: torch.Tensor | Picture | None) -> int:
        """Hold a picture up, which stays until another one is; None takes it away.

        An exposure that began before goes on with what it saw; every one that begins after this
        returned sees the picture. The deck rests meanwhile.

        Args:
            picture: picture as :func:`veilcam_server.devices.simulated.images.as_scene` takes it.

        Returns:
            Its number, which no other scene of this camera has or gets; that of the deck's scene
            if it is None.

        Raises:
            PictureError: it is none.
        """
        if picture is None:
            with self._lock:
                self._show(self._place, self._deck[self._place])
                return self._place
        scene = StillScene(np.asarray(picture).copy(), self.shape)
        scene.read()
        with self._lock:
            number, self._free = self._free, self._free + 1
            self._show(number, scene)
            return number

    def advance(self) -> None:
        """Turn to the next scene of the deck, unless something is held up before it."""
        with self._lock:
            if len(self._deck) == 1 or self._shown[-1].number != self._place:
                return
            self._place = (self._place + 1) % len(self._deck)
            self._show(self._place, self._deck[self._place])

    def at(self, begin: float) -> npt.NDArray[np.float32]:
        """Return what an exposure sees that begins at this monotonic time [s].

        Raises:
            LightError: there is nothing to see, or too much was shown since to tell what it was.
        """
        with self._lock:
            shown = next((each for each in reversed(self._shown) if each.since <= begin), None)
            if shown is None:
                raise LightError(
                    f"the scene changed more than {REMEMBERED - 1} times during one exposure: "
                    "change it less often"
                )
            self.seen = shown.number
        return shown.scene.read()

    def read(self) -> npt.NDArray[np.float32]:
        """Return what is there now; raises as :meth:`at`."""
        return self.at(self._clock())

    def _show(self, number: int, scene: SceneSource) -> None:
        self._shown.append(_Shown(number, scene, self._clock()))
