"""Self tests: whether the panel hides the scene, and for how long that holds."""

from __future__ import annotations

import math
import secrets
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from veilcam_optics.camera.geometry import CHANNELS, Camera, Embedding, Scene
from veilcam_server.camera.capture import Fence, check_exposure
from veilcam_server.camera.guard import EVERY as GUARD_EVERY
from veilcam_server.devices.base import Device, Exposure, Levels
from veilcam_server.errors import SelfTestError, UndecidedError

_DARK = 5e-4
"""Mean measurement through the open window, over that of saturated pixels, that tells nothing."""
_OPAQUE = 0.5
"""Most light that an opaque panel may let through, over that of the open window."""
_SHARE = 0.15
"""Largest error of a pattern's share of the light."""
_REPEATED = 0.3
"""Largest difference (relative L2) of one pattern shown twice."""
_UNSTEADY = 0.2
"""Difference (relative L2) of the open window before and after from which on nothing is decided."""
_LIKE, _CLEARLY = 0.5, 0.2
"""Least correlation that counts as likeness, and least difference of two that counts at all."""
_APART, _OVERLAP = 2, 16
"""Least distance of two shadows, along each axis, and size of what they share, to compare them by
[boxes]: a coarser embedding cannot tell where a shadow is."""

_Measurement = npt.NDArray[np.float64]


class SelfTest(Protocol):
    """Decides whether a panel may be trusted."""

    def run(self, device: Device, fence: Fence) -> float:
        """Show and look; what the panel shows afterwards is not said.

        Returns:
            Light behind the opaque panel, over that behind the open window; raw, both.

        Raises:
            SelfTestError: the panel does not hide the scene, or does not show what it is told.
            UndecidedError: nothing can be seen, for want of light or of steady light.
            DeviceError, FenceError: panel or sensor failed meanwhile.
        """


class OpticalSelfTest:
    """The test for one geometry.

    Args:
        camera: window, panel and sensor.
        scene: scene, of which the distance alone counts.
        embedding: embedding of the sensor.
        colour: True where it has three channels, which are judged by their mean.
        generator: generator of patterns; by default one that nobody can foresee.
        clock: monotonic time [s].
    """

    def __init__(
        self,
        camera: Camera,
        scene: Scene,
        embedding: Embedding,
        *,
        colour: bool = False,
        generator: np.random.Generator | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._camera, self._embedding, self._clock = camera, embedding, clock
        self._shape = (3, *embedding.shape) if colour else embedding.shape
        self._generator = generator or np.random.default_rng(secrets.randbits(128))
        self._moved = _boxes_between_corners(camera, scene, embedding)

    def run(self, device: Device, fence: Fence) -> float:
        """Take 9 measurements and judge them."""
        quarter = self._quarter()
        corner = np.zeros(self._camera.mask_shape, bool)
        corner[: corner.shape[0] // 2, : corner.shape[1] // 2] = True

        lights: list[float] = []

        def seen(opened: npt.NDArray[np.bool_]) -> _Measurement:
            exposure = self._seen(device, fence, opened)
            lights.append(exposure.light.mean)
            channels = exposure.embedding.reshape(-1, *self._embedding.shape)
            mean: _Measurement = channels.mean(axis=0, dtype=np.float64)
            return mean

        nothing, everything = np.zeros_like(corner), np.ones_like(corner)
        dark, light = seen(nothing), seen(everything)
        few, most = seen(quarter), seen(~quarter)
        first = seen(corner)
        again = seen(quarter)
        last = seen(corner[::-1, ::-1])
        light_after, dark_after = seen(everything), seen(nothing)

        self._judge_light(light, light_after, device.sensor.full_scale)
        floor, light = (dark + dark_after) / 2, (light + light_after) / 2
        if floor.mean() > _OPAQUE * light.mean():
            raise SelfTestError("the panel does not hide the scene: check its power and its wiring")
        # From here on the light that the window lets through, without what always comes through.
        light, few, most, again, first, last = (
            measurement - floor for measurement in (light, few, most, again, first, last)
        )
        share = quarter.mean()
        errors = (
            few.mean() / light.mean() - share,
            again.mean() / light.mean() - share,
            most.mean() / light.mean() - (1 - share),
        )
        if max(map(abs, errors)) > _SHARE or _difference(few, again) > _REPEATED:
            raise SelfTestError(
                "the panel does not show what it is told, or settles more slowly than --settle "
                "says: check its wiring and the clock of its bus"
            )
        self._judge_place(first, last)
        # The first two and the last two are opaque and open.
        return max(0.0, lights[0] + lights[-1]) / (lights[1] + lights[-2])

    def _judge_light(self, before: _Measurement, after: _Measurement, full_scale: float) -> None:
        if before.mean() <= _DARK * full_scale or after.mean() <= _DARK * full_scale:
            raise UndecidedError(
                "it is too dark to see whether the panel hides the scene: give the scene light"
            )
        if _difference(before, after) > _UNSTEADY:
            raise UndecidedError(
                "the light changes too much to see whether the panel hides the scene: hold it still"
            )

    def _judge_place(self, first: _Measurement, last: _Measurement) -> None:
        """Compare the shadows of two corners, moved as they lie apart, and in other directions."""
        down, right = self._moved
        rows, columns = self._embedding.shape
        if min(down, right) < _APART or (rows - down) * (columns - right) < _OVERLAP:
            return
        told = _likeness(first, last, down, right)
        for other in ((-down, -right), (down, -right), (-down, right)):
            found = _likeness(first, last, *other)
            if found > _LIKE and found - told > _CLEARLY:
                raise SelfTestError(
                    "the panel shows masks turned or mirrored: check --panel-tab and how the panel "
                    "is mounted"
                )

    def _seen(self, device: Device, fence: Fence, opened: npt.NDArray[np.bool_]) -> Exposure:
        """Return the exposure behind a pattern."""
        if opened.any():
            levels: Levels = np.where(opened, self._camera.panel.levels - 1, 0).astype(np.uint8)
            device.display.show(levels)
        else:
            # Opaque as captures leave it: the whole panel, not the window alone.
            device.display.blank()
        not_before = self._clock() + fence.settle
        exposure = device.sensor.capture(not_before, fence.timeout)
        check_exposure(exposure, not_before=not_before, ended=self._clock(), shape=self._shape)
        return exposure

    def _quarter(self) -> npt.NDArray[np.bool_]:
        """Return a quarter of the window at random, in blocks that hold every colour."""
        rows, columns = self._camera.mask_shape
        high = -(-rows // len(CHANNELS))
        blocks = np.zeros(high * columns, bool)
        blocks[: max(1, round(blocks.size / 4))] = True
        self._generator.shuffle(blocks)
        return blocks.reshape(high, columns).repeat(len(CHANNELS), axis=0)[:rows]


def _boxes_between_corners(camera: Camera, scene: Scene, embedding: Embedding) -> tuple[int, int]:
    """Return the distance of the shadows of two opposite corners, in embedding pixels."""
    rows, columns = camera.mask_shape
    magnification = 1 + camera.distance / scene.distance
    down = (rows - rows // 2) * camera.panel.pitch_y * magnification
    right = (columns - columns // 2) * camera.panel.pitch_x * magnification
    return (
        round(down / (camera.sensor.height / embedding.rows)),
        round(right / (camera.sensor.width / embedding.columns)),
    )


def _difference(one: _Measurement, other: _Measurement) -> float:
    """Relative L2."""
    return float(np.linalg.norm(one - other) / np.linalg.norm((one + other) / 2))


def _likeness(first: _Measurement, last: _Measurement, down: int, right: int) -> float:
    """Correlation of ``first`` with ``last`` moved back, where they overlap."""
    rows, columns = first.shape

    def cut(size: int, move: int) -> tuple[slice, slice]:
        return slice(max(0, -move), size - max(0, move)), slice(max(0, move), size - max(0, -move))

    (rows_from, rows_to), (columns_from, columns_to) = cut(rows, down), cut(columns, right)
    one, other = first[rows_from, columns_from], last[rows_to, columns_to]
    one, other = one - one.mean(), other - other.mean()
    norms = float(np.linalg.norm(one) * np.linalg.norm(other))
    return float((one * other).sum()) / norms if norms > 0 else 0.0


EVERY = 600.0
"""Longest that a test holds, unless it is said otherwise [s]."""


@dataclass(frozen=True, slots=True)
class Checks:
    """Checks that the panel hides the scene."""

    test_every: float = EVERY
    """Longest time from one self test to the next [s]."""
    guard_every: float = GUARD_EVERY
    """Longest age of the opaque frame that vouches for an answer [s]."""
    steps: int = 64
    """Levels that the panel has."""


class SelfTestStatus:
    """A test that passed holds until the panel is set up anew, or until the test is too old.

    Args:
        test: test that decides.
        device: device that is tested.
        fence: times to keep.
        every: longest time that it holds [s].
        clock: monotonic time [s].

    Raises:
        ValueError: a time that cannot be.
    """

    def __init__(
        self,
        test: SelfTest,
        device: Device,
        fence: Fence,
        *,
        every: float = EVERY,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if not (math.isfinite(every) and every > 0):
            raise ValueError(f"every = {every} s is not valid: use a number > 0")
        self._test, self._device, self._fence = test, device, fence
        self._every, self._clock = every, clock
        self._passed, self._ends, self._resets = -math.inf, -math.inf, 0
        self.leak = 0.0
        """Light behind the opaque panel, over that behind the open window, when it passed last."""

    def holds_for(self) -> float:
        """Seconds for which it holds still; 0 if it does not."""
        if self._device.display.resets != self._resets:
            return 0.0
        return max(0.0, self._ends - self._clock())

    @property
    def age(self) -> float:
        """Return the time since the panel passed last [s]; inf: it never did."""
        return self._clock() - self._passed

    def adopt(self, device: Device, fence: Fence) -> None:
        """Test another device from now on, with other times to keep."""
        self._device, self._fence = device, fence
        self.void()

    def void(self) -> None:
        """Test again before anything is believed."""
        self._ends = -math.inf

    def renew(self) -> None:
        """Test now; raises as :meth:`SelfTest.run`, and then there is no proof any more."""
        self._ends = -math.inf
        resets = self._device.display.resets
        self.leak = self._test.run(self._device, self._fence)
        # Set up anew in the middle of the test, the panel may have forgotten what was tested.
        self._resets, self._passed = resets, self._clock()
        self._ends = self._passed + self._every
