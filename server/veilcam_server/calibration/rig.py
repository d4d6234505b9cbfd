"""Scenes, patterns and measurements of a calibration."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field

import numpy as np
import numpy.typing as npt

from veilcam_client.wire.calibration import SceneName
from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_server.camera.capture import Fence, check_exposure
from veilcam_server.devices.base import Device, Levels

_LAMP = 7
"""Side of the scene over side of the lamp."""


@dataclass(frozen=True, slots=True)
class Geometry:
    """Camera, scene and embedding of a bundle."""

    camera: Camera
    scene: Scene
    embedding: Embedding

    @property
    def digest(self) -> str:
        """SHA-256 over all nominal numbers: 64 hexadecimal digits."""
        drawing = json.dumps(asdict(self), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(drawing.encode()).hexdigest()


_BLOCK = 0.4e-3
"""Side of the squares of coarse patterns [m]: two embedding pixels, the largest offset that a fit
finds."""


@dataclass(frozen=True, slots=True)
class Patterns:
    """Numbers of patterns of each kind."""

    coarse: int = 4
    """Patterns of open and opaque squares, for the first fit."""
    fine: int = 8
    """Patterns of open and opaque sub-pixels, for the second fit."""
    held_out: int = 3
    """Patterns of sub-pixels of any level, which no fit uses, for the check of its result."""

    @property
    def count(self) -> int:
        """Number of measurements of one scene, the opaque one included."""
        return 1 + self.coarse + self.fine + self.held_out

    def draw(self, camera: Camera) -> list[Levels]:
        """Return the opaque, coarse, fine and held-out patterns, the same ones every time."""
        random = np.random.default_rng(1)
        top, (rows, columns) = camera.panel.levels - 1, camera.mask_shape
        high, wide = (
            max(1, round(_BLOCK / pitch)) for pitch in (camera.panel.pitch_y, camera.panel.pitch_x)
        )

        def squares() -> Levels:
            blocks = random.integers(0, 2, (-(-rows // high), -(-columns // wide)), np.uint8)
            return (top * blocks).repeat(high, 0).repeat(wide, 1)[:rows, :columns]

        return [
            np.zeros((rows, columns), np.uint8),
            *(squares() for _ in range(self.coarse)),
            *(top * random.integers(0, 2, (rows, columns), np.uint8) for _ in range(self.fine)),
            *(random.integers(0, top + 1, (rows, columns), np.uint8) for _ in range(self.held_out)),
        ]


Values = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Moment:
    """Mean of a measurement; start and end of its exposure since the panel's last byte [s]."""

    started: float
    ended: float
    mean: float


class Rig:
    """Panel and sensor that show patterns and measure. Patterns never come from a key.

    Args:
        device: panel and sensor, which stay open.
        camera: nominal camera, whose window the patterns fill.
        shape: shape of an embedding.
        fence: fence of every measurement, except those of settling itself.
        repeats: exposures for one measurement, which is their mean.
        advance: function that is called after every exposure.
        clock: monotonic time [s].
    """

    def __init__(
        self,
        device: Device,
        camera: Camera,
        shape: tuple[int, int],
        *,
        fence: Fence,
        repeats: int = 1,
        advance: Callable[[], None] = lambda: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._device, self._camera, self._shape = device, camera, shape
        self._fence, self._repeats = fence, repeats
        self._advance, self._clock = advance, clock

    @property
    def full_scale(self) -> float:
        """Measurement of saturated pixels."""
        return self._device.sensor.full_scale

    def uniform(self, level: int) -> Levels:
        """Return the same level everywhere in the window."""
        return np.full(self._camera.mask_shape, level, np.uint8)

    @property
    def opaque(self) -> Levels:
        """Pattern of the lowest level."""
        return self.uniform(0)

    @property
    def open(self) -> Levels:
        """Pattern of the highest level."""
        return self.uniform(self._camera.panel.levels - 1)

    def read(self, levels: Levels) -> Values:
        """Show a pattern, let it settle, and return its measurement.

        Raises:
            DeviceError: panel or sensor failed.
            FenceError: the exposure does not keep to the fence.
        """
        not_before = self._device.display.show(levels).completed_at + self._fence.settle
        measurements = [self._expose(not_before)[0] for _ in range(self._repeats)]
        mean: Values = np.mean(measurements, axis=0)
        return mean

    def after(self, levels: Levels, delay: float) -> Moment:
        """Show a pattern, and return its measurement ``delay`` [s] later, settled or not."""
        completed = self._device.display.show(levels).completed_at
        measurement, started, ended = self._expose(completed + delay)
        return Moment(started - completed, ended - completed, float(measurement.mean()))

    def _expose(self, not_before: float) -> tuple[Values, float, float]:
        exposure = self._device.sensor.capture(not_before, self._fence.timeout)
        check_exposure(exposure, not_before=not_before, ended=self._clock(), shape=self._shape)
        self._advance()
        return exposure.embedding.astype(np.float64), exposure.started_at, exposure.ended_at


@dataclass(frozen=True, eq=False, slots=True)
class CalibrationScene:
    """Scene that a person sets up.

    Attributes:
        name: short name.
        instruction: instruction for a person who sets up the scene.
        image: reflectances of the scene in [0, 1], shape of the scene.
    """

    name: SceneName
    instruction: str
    image: npt.NDArray[np.float32] = field(repr=False)


def dark(scene: Scene) -> CalibrationScene:
    """Return the scene of a covered camera."""
    return CalibrationScene(
        "dark",
        "Cover the camera so that no light gets in.",
        np.zeros(scene.shape, np.float32),
    )


def white(scene: Scene) -> CalibrationScene:
    """Return the scene of a white card that fills it."""
    height, width = (100 * scene.pixel * count for count in scene.shape)
    return CalibrationScene(
        "white card",
        f"Hold up a white card, {width:.3g} cm wide and {height:.3g} cm high, evenly lit and "
        f"upright before black, {100 * scene.distance:.3g} cm in front of the panel, its middle "
        "on the camera's axis.",
        np.ones(scene.shape, np.float32),
    )


def lamp(scene: Scene) -> CalibrationScene:
    """Return the scene of a small bright square in the middle."""
    sides = tuple(_lamp_side(count) for count in scene.shape)
    image = np.zeros(scene.shape, np.float32)
    rows, columns = (
        slice((count - side) // 2, (count + side) // 2)
        for count, side in zip(scene.shape, sides, strict=True)
    )
    image[rows, columns] = 1.0
    height, width = (1000 * scene.pixel * side for side in sides)
    return CalibrationScene(
        "lamp",
        f"Put a lamp behind a hole of {width:.3g} x {height:.3g} mm in black card, the hole where "
        "the middle of the white card was; no other light.",
        image,
    )


def _lamp_side(count: int) -> int:
    """Return the lamp's pixels along a side: even where the scene's are, so that it is centred."""
    side = max(1, count // _LAMP)
    return side if side % 2 == count % 2 else side + 1
