"""Guard: one opaque frame at each mask change shows that the panel hides the scene.

Only raw light is compared: a black level that was measured behind the panel would hide its leak.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from veilcam_server.camera.capture import Fence
from veilcam_server.devices.base import Device, Levels, Light, Shown
from veilcam_server.devices.errors import SensorError
from veilcam_server.errors import PanelNotHidingError, UnsteadyLightError, UnwatchableError
from veilcam_server.masks.source import transmittance

EVERY = 10.0
"""Longest age of an opaque frame that vouches for an answer, unless it is said otherwise [s]."""
WATCHABLE = 0.7
"""Largest expected ratio of opaque to mask that can be told from a panel that does not hide."""
REMEMBERED = 600.0
"""Time for which the last verdict holds in the dark [s]."""

_NEAR = 1.0
"""Longest time between an opaque frame and its neighbours, beside settling [s]."""
_LIGHT_CHANGED = "the light changed around this capture, which was thrown away: try again"
ACCUSED, _UNSTEADY, _ROUNDS = 6, 3, 7
"""Verdicts in a row that accuse the panel, those that blame the light, and repeats at most. Of two
in a row, a lamp that is switched three times a second accuses a sound camera in .3 % of changes."""
_FRAME = 0.06
"""Time of a frame that is waited for, at 40 frames a second [s]."""

Verdict = Literal["hidden", "not hidden", "light changes", "too dark"]


@dataclass(frozen=True, slots=True)
class MaskFrame:
    """Light of a frame behind a mask."""

    light: Light
    threshold: float
    """Share of it under which an opaque frame is hidden."""
    at: float = 0.0
    """Monotonic time of its end [s]."""


def expected_ratio(leak: float, levels: Levels, steps: int) -> float:
    """Return light behind the opaque panel over that behind a mask, of a sound camera.

    Args:
        leak: light behind the opaque panel over that behind the open window.
        levels: mask, from 0 (opaque).
        steps: levels that the panel has.
    """
    return leak / (leak + (1 - leak) * transmittance(levels, steps))


def threshold(ratio: float) -> float:
    """Return the threshold for an expected ratio: half-way to a panel that hides nothing."""
    return (1 + ratio) / 2


def verdict(opaque: Light, neighbours: Sequence[MaskFrame]) -> Verdict:
    """Return the verdict of an opaque frame.

    A sound panel is accused only if the light rose before the frame and fell after it.

    Args:
        opaque: light of the frame.
        neighbours: frames behind masks right before and after it, one or both.
    """
    if opaque.dark and all(each.light.dark for each in neighbours):
        return "too dark"
    limits = [each.threshold * each.light.mean for each in neighbours]
    dark = any(each.light.dark for each in neighbours)
    if not (dark or opaque.saturated) and opaque.mean < min(limits):
        return "hidden"
    over = opaque.saturated or opaque.mean >= max(limits)
    return "not hidden" if over and not opaque.dark else "light changes"


@dataclass(frozen=True, slots=True)
class _Opaque:
    """Opaque frame that waits for the frame after it."""

    light: Light
    at: float
    before: MaskFrame | None = field(repr=False)


class Guard:
    """Writes masks, takes opaque frames in between, and decides which answers may leave.

    Called by one thread at a time.

    Args:
        device: panel and sensor, without any calibration.
        fence: times to keep.
        steps: levels that the panel has.
        every: longest age of the opaque frame that vouches for an answer [s].
        clock: monotonic time [s].

    Attributes:
        fence: times to keep.
        leak: light behind the opaque panel over that behind the open window, of the last self test.
        covered: True where the window was made opaque, and no mask was written since.
        completed_at: time when the last mask was written, monotonic [s].
    """

    def __init__(
        self,
        device: Device,
        fence: Fence,
        *,
        steps: int = 64,
        every: float = EVERY,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._device, self._every, self._clock, self._steps = device, every, clock, steps
        self.fence, self.leak, self.covered, self.completed_at = fence, 0.0, False, -math.inf
        self._opaque: _Opaque | None = None
        self._last: MaskFrame | None = None
        self._hidden_at = -math.inf

    @property
    def refusal(self) -> float:
        """Time from a request to its refusal, however the light changed meanwhile [s]."""
        return (2 * _ROUNDS + 2) * (self.fence.settle + _FRAME)

    def require_watchable(self, levels: Levels) -> None:
        """Raise :class:`UnwatchableError` for a mask that passes hardly more than the leak."""
        ratio = expected_ratio(self.leak, levels, self._steps)
        if ratio > WATCHABLE:
            raise UnwatchableError(
                f"too much light comes past this camera's masks ({ratio:.0%} of theirs): nothing "
                "would tell when they fail; make the camera light tight, with an infrared filter"
            )

    def cover(self, levels: Levels) -> None:
        """Make the window opaque and take a frame before a mask, unless that was done.

        A sensor that gives no frame keeps no mask off the panel: the next answer needs one.

        Raises:
            DisplayError: the panel did not become opaque.
        """
        if not self.covered:
            try:
                self._cover(levels)
            except SensorError:
                self._opaque = None

    def show(self, levels: Levels) -> Shown:
        """Write a mask, after an opaque frame; raises as :meth:`Display.show`."""
        self.cover(levels)
        shown = self._device.display.show(levels)
        self.covered, self.completed_at = False, shown.completed_at
        return shown

    def forget(self) -> None:
        """Something else is shown than masks and their opaque frames."""
        self.covered, self._opaque, self._last = False, None, None

    def vouch(self, levels: Levels, light: Light, *, last: bool) -> bool:
        """Decide about the answer of the capture that was just taken.

        The window stays opaque where an opaque frame was needed.

        Args:
            levels: mask that is shown.
            light: light of the capture.
            last: True where the mask is to change now.

        Returns:
            Whether an opaque frame beside the capture was hidden.

        Raises:
            PanelNotHidingError: the panel does not hide the scene.
            UnsteadyLightError: the light changed, or it has been too dark for too long.
            DisplayError: the panel did not become opaque.
            SensorError: the sensor gave no frame.
        """
        hidden_at, before, frame = self._hidden_at, self._last, self._frame(levels, light)
        self._last = frame
        opaque, self._opaque = self._opaque, None
        if opaque is not None and self._near(opaque.at):
            found = verdict(opaque.light, [*filter(None, (opaque.before,)), frame])
            if found in ("not hidden", "light changes"):
                self._repeat(levels, found)
            if found == "hidden":
                self._hidden_at = opaque.at
        if last or self._clock() - self._hidden_at > self._every:
            opaque = self._cover(levels)
            found = verdict(opaque.light, [frame])
            if found in ("not hidden", "light changes"):
                self._repeat(levels)
            if found == "hidden":
                self._hidden_at = opaque.at
        if light.dark:
            # A mask that was not written looks like a lamp that went out.
            if before is not None and not before.light.dark:
                raise UnsteadyLightError(_LIGHT_CHANGED)
            if self._clock() - self._hidden_at > REMEMBERED:
                raise UnsteadyLightError(
                    "it has been too dark for too long to see whether the panel hides the scene: "
                    "give the scene light"
                )
        return self._hidden_at > hidden_at

    def _repeat(self, levels: Levels, found: Verdict | None = None) -> None:
        """Find out who is to blame, the panel or the light; raises as :meth:`vouch`."""
        over, mixed = int(found == "not hidden"), int(found == "light changes")
        for _ in range(_ROUNDS):
            if not self.covered:
                self._cover(levels)
            opaque, self._opaque = self._opaque, None
            shown = self.show(levels)
            self._last = self._frame(levels, self._looked(shown.completed_at))
            if opaque is None:
                continue
            found = verdict(opaque.light, [*filter(None, (opaque.before,)), self._last])
            over = over + 1 if found == "not hidden" else 0
            mixed += found in ("light changes", "too dark")
            if over >= ACCUSED:
                self._hidden_at = -math.inf
                raise PanelNotHidingError("the panel does not hide the scene")
            if found == "hidden":
                self._hidden_at = opaque.at
            if found == "hidden" or mixed >= _UNSTEADY:
                break
        raise UnsteadyLightError(_LIGHT_CHANGED)

    def _cover(self, levels: Levels) -> _Opaque:
        """Make the window opaque and take a frame; raises as :meth:`vouch`."""
        near = self._last is not None and self._near(self._last.at)
        before = self._last if near else None
        completed_at = self._device.display.show(np.zeros_like(levels)).completed_at
        self.covered = True
        self._opaque = _Opaque(self._looked(completed_at), self._clock(), before)
        return self._opaque

    def _looked(self, completed_at: float) -> Light:
        return self._device.sensor.light(completed_at + self.fence.settle, self.fence.timeout)

    def _frame(self, levels: Levels, light: Light) -> MaskFrame:
        ratio = expected_ratio(self.leak, levels, self._steps)
        return MaskFrame(light, threshold(ratio), self._clock())

    def _near(self, at: float) -> bool:
        return self._clock() - at < _NEAR + self.fence.settle
