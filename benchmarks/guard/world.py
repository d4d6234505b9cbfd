"""Light of drawn cameras on a clock of its own: the guard of the daemon sees it frame by frame."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch

from veilcam_optics.camera.imperfections import NOMINAL, Imperfections
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_server.camera.capture import Fence
from veilcam_server.camera.guard import Guard
from veilcam_server.demo_data import load_digits
from veilcam_server.devices import Device, Shown
from veilcam_server.devices.base import Levels, Light
from veilcam_training.bundle import Bundle, read_bundle

Array = npt.NDArray[np.float64]
FAULTS = ("dead", "open_window", "stuck", "inverted", "asleep")
SETTLE, EXPOSURE, FRAME = 0.1, 0.01, 0.025
"""Of the daemon as shipped; a frame is read out so long after its exposure [s]."""
NOISE = 1e-4
"""Error of a frame's light, as the driver gives it."""


def scenes(random: np.random.Generator, each: int) -> Mapping[str, Array]:
    """Return ``each`` scenes of eight kinds, shape (each, 784), in [0, 1]."""
    digits = load_digits().images
    chosen = digits[random.integers(len(digits), size=each)].reshape(each, -1) / 255
    ramp = np.tile(np.linspace(0.2, 1, 28), 28)
    frequencies = np.hypot(*np.meshgrid(np.fft.fftfreq(28), np.fft.fftfreq(28)))
    frequencies[0, 0] = 1 / 28
    waves = np.fft.fft2(random.normal(size=(each, 28, 28))) / frequencies**1.2
    natural = np.fft.ifft2(waves).real.reshape(each, -1)
    natural -= natural.min(1, keepdims=True)
    points = np.zeros((each, 784))
    points[np.arange(each), random.integers(784, size=each)] = 1
    return {
        "digit": chosen,
        "digit on gray": 0.5 + 0.5 * chosen,
        "dark digit on white": 1 - chosen,
        "wall": np.ones((each, 784)),
        "gradient": np.tile(ramp, (each, 1)),
        "1/f": natural / natural.max(1, keepdims=True),
        "point": points,
        "noise": random.random((each, 784)),
    }


@dataclass(frozen=True)
class Pattern:
    """Mean light of each scene pixel behind a pattern, even and as it falls off to the edges."""

    even: Array = field(repr=False)
    fallen: Array = field(repr=False)

    def light(self, scene: Array, shading: float) -> float:
        """Mean light of a scene where it falls off by ``shading`` to the corners."""
        return float(scene @ self.even - shading * (scene @ self.fallen))


class Optics:
    """Patterns of one camera, in shares of saturation.

    Args:
        bundle: camera and masks.
        masks: levels.
        imperfections: of the panel.
    """

    def __init__(
        self, bundle: Bundle, masks: Sequence[Levels], imperfections: Imperfections = NOMINAL
    ) -> None:
        self._operator = TransferOperator(bundle.camera, bundle.scene, bundle.embedding)
        self._panel, self._imperfections = bundle.camera.panel, imperfections
        rows, columns = bundle.embedding.shape
        y, x = np.linspace(-1, 1, rows)[:, None], np.linspace(-1, 1, columns)[None]
        self._fall = ((y**2 + x**2) / 2).ravel()
        window, panel, sensor = bundle.camera.window, bundle.camera.panel, bundle.camera.sensor
        size = window.rows * panel.pitch_y * window.columns * panel.pitch_x
        self.beyond = max(0.0, sensor.height * sensor.width / size - 1)
        """Light of all the glass beyond the window, over that of the open window."""
        self.masks = list(masks)
        shape = bundle.camera.mask_shape
        opened = self._matrix(np.full(shape, 63, np.uint8))
        self._scale = 1 / (1.1 * float(opened.sum(0).max()))
        self.opened = self._pattern(opened)
        self.opaque = self._pattern(self._matrix(np.zeros(shape, np.uint8)))
        self.shown = [self._pattern(self._matrix(levels)) for levels in masks]
        self._inverted: dict[int, Pattern] = {}

    def inverted(self, mask: int) -> Pattern:
        """Pattern of a mask that is shown light for dark."""
        if mask not in self._inverted:
            levels = (63 - self.masks[mask]).astype(np.uint8)
            self._inverted[mask] = self._pattern(self._matrix(levels))
        return self._inverted[mask]

    def _matrix(self, levels: Levels) -> Array:
        weights = torch.from_numpy(to_weights(levels, self._panel))
        with torch.no_grad():
            matrix: Array = self._operator(self._imperfections.shown(weights)).double().numpy()
        return matrix

    def _pattern(self, matrix: Array) -> Pattern:
        return Pattern(self._scale * matrix.mean(1), self._scale * (matrix * self._fall).mean(1))


@dataclass
class Lamp:
    """A lamp that is switched at random, and flickers.

    Attributes:
        random: of its switches.
        rate: switches a second; 0 for none.
        low: brightness while it is down.
        flicker: amplitude of its flicker, at twice the frequency of the mains.
        mains: that frequency [Hz].
    """

    random: np.random.Generator
    rate: float = 0.0
    low: float = 1 / 30
    flicker: float = 0.0
    mains: float = 50.0
    _switches: list[float] = field(default_factory=lambda: [-1.0], repr=False)

    def mean(self, begin: float, end: float) -> float:
        """Mean brightness from ``begin`` to ``end`` [s]."""
        level = 1.0
        if self.rate:
            while self._switches[-1] < end:
                self._switches.append(self._switches[-1] + self.random.exponential(1 / self.rate))
            first = bisect_right(self._switches, begin)
            ends = [begin, *(at for at in self._switches[first:] if at < end), end]
            lit = sum(
                (until - since) * (1.0 if (first + index) % 2 else self.low)
                for index, (since, until) in enumerate(pairwise(ends))
            )
            level = lit / (end - begin)
        if self.flicker:
            turns = 4 * math.pi * self.mains
            wave = (math.cos(turns * begin) - math.cos(turns * end)) / (turns * (end - begin))
            level *= 1 + self.flicker * wave
        return level


@dataclass
class Rig:
    """A panel, a sensor and the light in front of them; the guard takes it for a device.

    Attributes:
        optics: of the camera.
        light_of: mean light of a pattern.
        lamp: that lights the scene.
        brightness: of the scene.
        offset: error of the black level.
    """

    optics: Optics
    light_of: Callable[[Pattern], float]
    lamp: Lamp
    brightness: float = 1.0
    bypass: float = 0.0
    offset: float = 0.0
    now: float = 0.0
    fault: str = ""
    every: float = 0.0
    name: str = "simulated"
    full_scale: float = 1.0
    resets: int = 0

    def __post_init__(self) -> None:
        self._place = {levels.tobytes(): place for place, levels in enumerate(self.optics.masks)}
        self._told: int | None = None
        self._lights: dict[tuple[str, int | None], float] = {}
        self.guard = Guard(
            Device(self, self, simulated=True),  # type: ignore[arg-type]
            Fence(SETTLE),
            every=self.every,
            clock=lambda: self.now,
        )
        opened = self.light_of(self.optics.opened) * (1 + self.bypass)
        self._past = self.bypass * self.light_of(self.optics.opened)
        # The self test sees the lamp flicker, too.
        self.guard.leak = (self.light_of(self.optics.opaque) + self._past) / opened

    def show(self, levels: Levels) -> Shown:
        """Take a mask, or opaque."""
        self.now += 0.002
        if self.fault != "stuck":
            self._told = self._place.get(levels.tobytes())
        return Shown(self.now)

    def light(self, not_before: float, timeout: float) -> Light:  # noqa: ARG002 - never late
        """Expose once."""
        begin = max(self.now, not_before)
        self.now = begin + EXPOSURE + FRAME
        key = (self.fault, self._told)
        if key not in self._lights:
            self._lights[key] = self._passed()
        mean = self.brightness * self.lamp.mean(begin, begin + EXPOSURE) * self._lights[key]
        return Light(min(mean, 1.0) + self.offset, NOISE, saturated=mean > 1)

    def capture(self, mask: int, *, last: bool = True) -> Light:
        """Take a capture behind a mask that is written if need be; raises as the guard does."""
        levels = self.optics.masks[mask]
        if self.guard.covered or self._told is None:
            self.guard.show(levels)
        light = self.light(self.guard.completed_at + SETTLE, 1.0)
        self.guard.vouch(levels, light, last=last)
        return light

    def _passed(self) -> float:
        optics, told = self.optics, self._told
        if self.fault in ("dead", "asleep"):
            return self._past + (1 + optics.beyond) * self.light_of(optics.opened)
        if self.fault == "open_window":
            pattern = optics.opened
        elif self.fault == "inverted":
            pattern = optics.opened if told is None else optics.inverted(told)
        else:
            pattern = optics.opaque if told is None else optics.shown[told]
        return self._past + self.light_of(pattern)


def shipped(path: Path, random: np.random.Generator, count: int) -> tuple[Bundle, list[Levels]]:
    """Return a bundle, and masks that its daemon shows."""
    bundle = read_bundle(path)
    if bundle.mode == "pairs":
        return bundle, [pair.levels for pair in bundle.pairs][:count]
    shape = bundle.camera.mask_shape
    return bundle, [random.integers(0, 64, shape).astype(np.uint8) for _ in range(count)]
