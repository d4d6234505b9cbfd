"""Simulated camera: the real drivers on an emulated panel and a fake picamera2.

A measurement comes through bytes on a bus, the panel's memory, its crystal, light, raw frames of
12 bits and their binning.
"""

from __future__ import annotations

import hashlib
import math
import time
from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
import numpy.typing as npt
import torch
from torch.nn.functional import pixel_shuffle

from veilcam_client.numbers import erasable
from veilcam_client.wire.simulation import Faults
from veilcam_optics.arrays import overwrite
from veilcam_optics.camera.geometry import Camera, Embedding
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.propagation.sampling import area_average
from veilcam_optics.simulation.operator import Response
from veilcam_server.devices import imx477, st7735r
from veilcam_server.devices.base import Device, Levels
from veilcam_server.devices.driver import DisplayDriver, EmulatedPanel, SensorDriver
from veilcam_server.devices.errors import DeviceMissingError
from veilcam_server.devices.raw import Raw, SensorMode
from veilcam_server.devices.reopening import ReopeningDisplay, ReopeningSensor
from veilcam_server.devices.simulated.light import Light, raw_shape
from veilcam_server.devices.simulated.scenes import Scenes, SceneSource

_CACHED_MASKS = 3
"""Masks whose light is kept: opaque, open, and the one that is shown."""
_INSTANTS = 5
"""At how many instants an exposure over a turning crystal is evaluated."""
_SWITCHES = 16
"""Switches of the lamp that are remembered, for exposures that began before them."""
_BAYER = (0.25, 0.5, 0.25)
"""Shares of red, green and blue pixels (RGGB)."""
_HEADROOM = 1.1
"""What saturated pixels give, over the brightest one of a white scene through an open panel."""

Number = TypeVar("Number", bound=np.generic)


@dataclass(frozen=True, slots=True)
class Conditions:
    """Properties of the simulated hardware."""

    settle: float = 0.05
    """What a sub-pixel takes to turn, once the panel's scan has reached it [s]."""
    exposure: float = 0.01
    """[s]"""
    snr_db: float = 40.0
    """Of a binned measurement."""
    scan: float = 0.0
    """Between two refreshes of a panel's line; 12.3 ms on the real one [s]."""
    warm_up: float = 0.0
    """Share of the light that is missing at first."""
    warm_up_time: float = 60.0
    """After which 37 % of that is still missing [s]."""
    read_back: bool = False
    """Whether the panel is asked after each mask if it shows it."""


class SimulatedLight:
    """Light of a scene through a panel, as raw frames of an exposure from begin to end [s]."""

    def __init__(
        self,
        panel: EmulatedPanel,
        scenes: Scenes,
        light: Light,
        *,
        camera: Camera,
        embedding: Embedding,
        conditions: Conditions,
        mode: SensorMode,
        full_scale: float,
        seed: int | None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._panel, self._scenes, self._light = panel, scenes, light
        self._camera, self._embedding, self._conditions = camera, embedding, conditions
        self._mode, self._full_scale = mode, full_scale
        self._clock, self._began_at = clock, clock()
        self._generator = torch.Generator()
        if seed is None:
            self._generator.seed()
        else:
            self._generator.manual_seed(seed)
        self._settled = _Responses(light, camera)
        window, glass, sensor = camera.window, camera.panel, camera.sensor
        size = window.rows * glass.pitch_y * window.columns * glass.pitch_x
        # An even light on the whole sensor, where a window gives it to its shadow alone.
        self._beyond = max(0.0, sensor.height * sensor.width / size - 1)
        self._past, self._open_window = 0.0, False
        self._lamp = deque([(-math.inf, 1.0)], maxlen=_SWITCHES)

    def set_faults(self, faults: Faults) -> None:
        """Open the window, let light come past it, and switch the lamp, from now on."""
        panel, light = faults.panel, faults.light
        self._open_window = panel.open_window
        self._past = light.bypass + self._beyond * (panel.dead or panel.gone)
        if light.lamp != self._lamp[-1][1]:
            self._lamp.append((self._clock(), light.lamp))

    def __call__(self, begin: float, end: float) -> Raw:
        """Collect the light of an exposure, and convert it."""
        scene = torch.from_numpy(self._scenes.at(begin))[None]
        conditions, mode = self._conditions, self._mode
        with torch.no_grad():
            irradiance = self._collected(scene, begin, end)[0].double()
            if self._past:
                opened = np.full(self._camera.mask_shape, self._camera.panel.levels - 1, np.uint8)
                irradiance += self._past * self._settled.collect(scene, opened)[0].double().mean(
                    (-2, -1), keepdim=True
                )
        irradiance *= self._brightness(begin, end)
        missing = math.exp(-max(0.0, begin - self._began_at) / conditions.warm_up_time)
        irradiance = irradiance * (1 - conditions.warm_up * missing)
        if conditions.exposure > 0:
            irradiance = irradiance * ((end - begin) / conditions.exposure)
        counts = mode.white_level - mode.black_level
        numbers = mode.black_level + self._noisy(irradiance) * (counts / self._full_scale)
        raw: Raw = erasable(numbers.round_().clamp_(0, mode.white_level).numpy(), np.uint16)
        overwrite(irradiance, numbers)
        return raw

    def _noisy(self, irradiance: torch.Tensor) -> torch.Tensor:
        """Return raw pixels whose photon noise gives the *binned* measurement its ratio."""
        colour = irradiance.ndim == 3
        raw = pixel_shuffle(irradiance[[0, 1, 1, 2]], 2)[0] if colour else irradiance
        if self._conditions.snr_db == math.inf:
            return raw
        embedding = self._embedding
        binned = area_average(irradiance, *embedding.shape, embedding.fill)
        # As in veilcam_optics.sensor.noise: variance per unit of light; a measurement is the mean
        # of as many raw pixels, in colour of its own alone.
        shares = binned.new_tensor(_BAYER if colour else 1.0).reshape(-1, 1, 1)
        pixels = raw.numel() / embedding.size * embedding.fill**2
        total = float((binned / shares).sum()) / pixels
        if total <= 0:
            return raw
        unit = float(binned.square().sum()) / (total * 10 ** (self._conditions.snr_db / 10))
        noise = torch.randn(raw.shape, generator=self._generator, dtype=raw.dtype)
        return raw + (raw.clamp(min=0) * unit).sqrt() * noise

    def _brightness(self, begin: float, end: float) -> float:
        """Mean brightness of the lamp over an exposure."""
        end = max(end, begin + 1e-9)
        total, since = 0.0, end
        for at, level in reversed(tuple(self._lamp)):
            if at < since:
                total += level * (since - max(at, begin))
                since = max(at, begin)
        return total / (end - begin)

    def _collected(self, scene: torch.Tensor, begin: float, end: float) -> torch.Tensor:
        """Light on the sensor, mean over the exposure."""
        if self._panel.settled(begin):
            return self._settled.collect(scene, self._window(self._panel.framebuffer()))
        top = self._camera.panel.levels - 1
        seen = []
        for instant in np.linspace(begin, end, _INSTANTS):
            weights = torch.from_numpy(self._window(self._panel.visible(float(instant)))) / top
            seen.append(self._light.collect(scene, self._light.response(weights)))
        return torch.stack(seen).mean(0)

    def _window(self, shown: npt.NDArray[Number]) -> npt.NDArray[Number]:
        """Return the part of the whole panel that is the mask."""
        if self._open_window:
            return np.full(self._camera.mask_shape, self._camera.panel.levels - 1, shown.dtype)
        window = self._camera.window
        rows = slice(window.first_row, window.first_row + window.rows)
        return shown[rows, window.first_column : window.first_column + window.columns].copy()


@dataclass
class _Responses:
    """Responses of the masks shown last, by a digest of their levels."""

    light: Light
    camera: Camera
    kept: OrderedDict[bytes, Response] = field(default_factory=OrderedDict, repr=False)

    def collect(self, scene: torch.Tensor, levels: Levels) -> torch.Tensor:
        """Return the light of a scene behind a mask."""
        key = hashlib.sha256(levels.tobytes()).digest()
        if key not in self.kept:
            while len(self.kept) >= _CACHED_MASKS:
                self.kept.popitem(last=False)
            weights = torch.from_numpy(to_weights(levels, self.camera.panel))
            self.kept[key] = self.light.response(weights)
        self.kept.move_to_end(key)
        return self.light.collect(scene, self.kept[key])


def simulated_device(
    light: Light,
    *deck: SceneSource,
    camera: Camera,
    embedding: Embedding,
    conditions: Conditions,
    full_scale: float | None = None,
    seed: int | None = None,
    display: DisplayDriver = st7735r.DRIVER,
    sensor: SensorDriver = imx477.DRIVER,
    clock: Callable[[], float] = time.monotonic,
    sleep: Callable[[float], None] = time.sleep,
) -> Device:
    """Return a panel and a sensor, and the scenes that they see.

    Args:
        light: between them, on raw pixels.
        deck: scenes in front of it, one after the other, the next after each capture.
        camera: geometry; its window is the mask.
        embedding: embedding that is read.
        conditions: properties of the hardware.
        full_scale: measurement of saturated pixels; by default a little more than that of a white
        scene
            through an open panel.
        seed: fixes the noise.
        display: driver whose panel is emulated.
        sensor: driver whose sensor is emulated.
        clock: monotonic time [s].
        sleep: waits so many seconds.

    Raises:
        SensorError: there is nothing to see yet.
        DisplayError: the camera's panel is not the one that is emulated.
        DeviceMissingError: one of them has no emulator.
    """
    if display.emulate is None or sensor.emulate is None:
        raise DeviceMissingError(
            f"nobody wrote an emulator for {display.name} and {sensor.name}: leave --simulate out"
        )
    scenes = Scenes(deck, clock=clock)
    rows, columns = raw_shape(embedding, colour=scenes.shape[:-2] != ())
    mode = SensorMode(rows, columns, line_time=0.0, frame_duration=0.0)
    if full_scale is None:
        with torch.no_grad():
            opened = light.response(torch.ones(camera.mask_shape))
            white = light.collect(torch.ones((1, *scenes.shape)), opened)
        full_scale = _HEADROOM * float(white.max())
        del opened, white
    display.check(camera)
    open_display, emulated = display.emulate(
        camera,
        scan=conditions.scan,
        settle=conditions.settle,
        read_back=conditions.read_back,
        clock=clock,
    )
    frames = SimulatedLight(
        emulated,
        scenes,
        light,
        camera=camera,
        embedding=embedding,
        conditions=conditions,
        mode=mode,
        full_scale=full_scale,
        seed=seed,
        clock=clock,
    )
    start_sensor, break_sensor = sensor.emulate(
        *(frames, mode),
        shape=(*scenes.shape[:-2], *embedding.shape),
        fill=embedding.fill,
        exposure=conditions.exposure,
        full_scale=full_scale,
        clock=clock,
        sleep=sleep,
    )

    def set_faults(faults: Faults) -> None:
        emulated.faults = faults.panel
        break_sensor(faults.sensor)
        frames.set_faults(faults)

    return Device(
        ReopeningDisplay(display.name, open_display, clock=clock),
        ReopeningSensor(sensor.name, full_scale, start_sensor, clock=clock),
        simulated=True,
        scenes=scenes,
        set_faults=set_faults,
    )
