"""What is in front of a simulated camera: scenes one after the other, each from an instant on.

An exposure sees one scene from its beginning to its end: the one that was there when it began.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch

from veilcam_server.devices.errors import SensorError
from veilcam_server.devices.images import Picture, fitted
from veilcam_server.devices.scene import SceneSource, StillScene

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
        deck: at least one; after the last comes the first again.
        clock: monotonic time [s], that of the exposures.

    Raises:
        SensorError: the first scene cannot be seen.
    """

    def __init__(
        self, deck: Sequence[SceneSource], *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        if not deck:
            raise ValueError("deck = () is not valid: use one scene or more")
        self._deck, self._clock = tuple(deck), clock
        rows, columns = self._deck[0].read().shape
        self.shape = (rows, columns)
        """Of every scene."""
        self._place, self._free = 0, len(self._deck)
        self._shown = deque([_Shown(0, self._deck[0], -math.inf)], maxlen=REMEMBERED)
        self._seen = 0
        self._lock = threading.Lock()

    @property
    def seen(self) -> int:
        """Number of the scene that the last exposure saw."""
        return self._seen

    def hold(self, picture: torch.Tensor | Picture | None) -> int:
        """Hold a picture up, which stays until another one is; None takes it away.

        An exposure that began before goes on with what it saw; every one that begins after this
        returned sees the picture. The deck rests meanwhile.

        Args:
            picture: as :func:`veilcam_server.devices.images.fitted` takes it.

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
        scene = StillScene(fitted(np.asarray(picture), self.shape), self.shape)
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
            SensorError: there is nothing to see, or too much was shown since to tell what it was.
        """
        with self._lock:
            shown = next((each for each in reversed(self._shown) if each.since <= begin), None)
            if shown is None:
                raise SensorError(
                    f"the scene changed more than {REMEMBERED - 1} times during one exposure: "
                    "change it less often"
                )
            self._seen = shown.number
        return shown.scene.read()

    def read(self) -> npt.NDArray[np.float32]:
        """Return what is there now; raises as :meth:`at`."""
        return self.at(self._clock())

    def _show(self, number: int, scene: SceneSource) -> None:
        self._shown.append(_Shown(number, scene, self._clock()))
