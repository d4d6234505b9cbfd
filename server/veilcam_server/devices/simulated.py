"""A simulated panel and sensor, coupled by light alone.

The panel's liquid crystal takes time to turn; the sensor collects what passes it meanwhile. The
light is a plan's, and takes the grid path of the optics (field, propagation, point spread function,
convolution), which is not the transfer operator that training uses.
"""

from __future__ import annotations

import hashlib
import math
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import numpy.typing as npt
import torch

from veilcam_optics.effects.operator import Response
from veilcam_optics.geometry import Camera, Embedding, Scene
from veilcam_optics.masks import to_weights
from veilcam_optics.noise import shot_noise
from veilcam_optics.plan import plan
from veilcam_server.devices.errors import DisplayError, SensorTimeoutError
from veilcam_server.devices.protocols import Device, Exposure, Levels, Shown
from veilcam_server.devices.scene import SceneSource

_CACHED_MASKS = 8
"""Of a real camera's size, one takes 13 MiB; a mask drawn from a key never comes back anyway."""
_INSTANTS = 5
"""At how many instants an exposure over a turning crystal is evaluated."""


class Light(Protocol):
    """What the optics do; :class:`veilcam_optics.effects.LightOperator` is one."""

    def response(self, weights: torch.Tensor) -> Response:
        """Return what a mask makes of the light."""

    def collect(self, scenes: torch.Tensor, response: Response) -> torch.Tensor:
        """Return the binned light of scenes, (batch, rows, columns)."""


TOLERANCE = 0.025
"""Relative error of the simulated light: it has to be right, not the same as the decoder's."""


def planned_light(camera: Camera, scene: Scene, embedding: Embedding) -> Light:
    """Return the light of a camera in front of an ordinary scene, as a plan chooses it."""
    chosen = plan(camera, scene, embedding, TOLERANCE, batch=1, method="grid")
    return chosen.operator


@dataclass(frozen=True, slots=True)
class Conditions:
    """What the simulated hardware is like."""

    settle: float = 0.05
    """From a write to the panel until its crystal has turned [s]."""
    exposure: float = 0.01
    """[s]"""
    snr_db: float = 40.0

    def __post_init__(self) -> None:
        for name in ("settle", "exposure"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"{name} = {value} s is not valid: use a number >= 0")
        if math.isnan(self.snr_db):
            raise ValueError("snr_db = nan is not valid: use a number of dB, or inf for no noise")


class SimulatedDisplay:
    """A panel whose transmittance moves linearly from the old mask to the new one."""

    name = "simulated ST7735R"

    def __init__(
        self, camera: Camera, settle: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._camera, self._settle, self._clock = camera, settle, clock
        self._lock = threading.Lock()
        self._old = self._new = np.zeros(camera.mask_shape, np.uint8)
        self._written_at = -math.inf

    def show(self, levels: Levels) -> Shown:
        """Write a mask."""
        if levels.shape != self._camera.mask_shape or levels.dtype != np.uint8:
            raise DisplayError(f"the panel takes uint8 levels of shape {self._camera.mask_shape}")
        if int(levels.max()) >= self._camera.panel.levels:
            raise DisplayError(f"the panel takes levels 0 to {self._camera.panel.levels - 1}")
        with self._lock:
            # A crystal that is still turning when it is told to turn elsewhere counts as turned:
            # the engine never asks for that but when a write failed.
            self._old, self._new = self._new, levels.copy()
            self._written_at = self._clock()
            return Shown(self._written_at)

    def blank(self) -> None:
        """Show opaque."""
        self.show(np.zeros(self._camera.mask_shape, np.uint8))

    def close(self) -> None:
        """Nothing is held open."""

    def transmittance(self, at: float) -> tuple[Levels, Levels, float]:
        """Return old mask, new mask and how far the crystal has turned to the new one, 0 to 1."""
        with self._lock:
            elapsed = at - self._written_at
            if elapsed < 0:
                return self._old, self._new, 0.0
            turned = elapsed / self._settle if self._settle > 0 else 1.0
            return self._old, self._new, min(1.0, turned)


class SimulatedSensor:
    """Collects the light that passes a :class:`SimulatedDisplay` from a scene."""

    name = "simulated IMX477"

    def __init__(
        self,
        display: SimulatedDisplay,
        scene: SceneSource,
        light: Light,
        *,
        camera: Camera,
        conditions: Conditions,
        seed: int | None = None,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._display, self._scene, self._light = display, scene, light
        self._camera, self._conditions = camera, conditions
        self._clock, self._sleep = clock, sleep
        self._generator = torch.Generator()
        if seed is None:
            self._generator.seed()
        else:
            self._generator.manual_seed(seed)
        self._settled = _Responses(light, camera)

    def capture(self, not_before: float, timeout: float) -> Exposure:
        """Wait, expose, convolve, bin."""
        if self._conditions.exposure > timeout:
            raise SensorTimeoutError(f"the exposure takes longer than the timeout, {timeout} s")
        self._sleep(max(0.0, not_before - self._clock()))
        started_at = self._clock()
        scene = torch.from_numpy(self._scene.read())
        self._sleep(self._conditions.exposure)
        ended_at = self._clock()
        with torch.no_grad():
            irradiance = self._collected(scene[None], started_at, ended_at)
        noisy = shot_noise(irradiance, self._conditions.snr_db, self._generator)[0]
        embedding: npt.NDArray[np.float32] = noisy.numpy().astype(np.float32)
        return Exposure(embedding, started_at, ended_at)

    def close(self) -> None:
        """Nothing is held open."""

    def _collected(self, scene: torch.Tensor, started_at: float, ended_at: float) -> torch.Tensor:
        """Light on the sensor, mean over the exposure."""
        old, new, turned = self._display.transmittance(started_at)
        if turned == 1.0:
            return self._light.collect(scene, self._settled.response(new))
        seen = []
        for instant in np.linspace(started_at, ended_at, _INSTANTS):
            old, new, turned = self._display.transmittance(float(instant))
            mixed = torch.lerp(
                to_weights(old, self._camera.panel), to_weights(new, self._camera.panel), turned
            )
            seen.append(self._light.collect(scene, self._light.response(mixed)))
        return torch.stack(seen).mean(0)


@dataclass
class _Responses:
    """Of the masks shown last, by a digest of their levels."""

    light: Light
    camera: Camera
    kept: OrderedDict[bytes, Response] = field(default_factory=OrderedDict, repr=False)

    def response(self, levels: Levels) -> Response:
        key = hashlib.sha256(levels.tobytes()).digest()
        if key not in self.kept:
            self.kept[key] = self.light.response(to_weights(levels, self.camera.panel))
        self.kept.move_to_end(key)
        while len(self.kept) > _CACHED_MASKS:
            self.kept.popitem(last=False)
        return self.kept[key]


def simulated_device(
    light: Light,
    scene: SceneSource,
    *,
    camera: Camera,
    conditions: Conditions,
    seed: int | None = None,
) -> Device:
    """Return a panel and a sensor that see ``scene``; ``seed`` fixes the noise.

    Raises:
        SensorError: there is nothing to see yet.
    """
    scene.read()
    display = SimulatedDisplay(camera, conditions.settle)
    sensor = SimulatedSensor(
        display,
        scene,
        light,
        camera=camera,
        conditions=conditions,
        seed=seed,
    )
    return Device(display, sensor, simulated=True)
