"""Looks of a simulated camera in batches: what each of many captures tells, behind fresh masks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from veilcam_optics.camera.masks import to_weights
from veilcam_optics.keys.masks import KEY_BYTES, Levels, draw_levels
from veilcam_optics.propagation.sampling import area_average
from veilcam_optics.sensor.noise import shot_noise
from veilcam_server.demo_data import FRESH, Digits, load_digits
from veilcam_server.demo_data.make import IMAGES, LABELS, read_idx
from veilcam_server.devices.simulated.light import planned_light
from veilcam_server.masks.classifier import Classifier
from veilcam_server.masks.fresh import FreshReader
from veilcam_server.masks.source import Evidence, transmittance
from veilcam_training.bundle import read_bundle

SNR_DB = 40.0
"""Of a measurement, as the daemon's simulated camera has it."""
READ_NOISE = 1e-3
"""Standard deviation of what is read without light, over the mean measurement of the mean scene."""
MASKS = 150
"""That the looks of one command are shared among; none comes twice in a row."""

Scenes = npt.NDArray[np.float32]
"""Reflectance, (looks, rows, columns)."""


@dataclass(frozen=True, eq=False)
class Mask:
    """One mask, and what it makes of scenes."""

    levels: Levels
    transfer: Tensor
    reader: FreshReader


class Rig:
    """The fresh bundle that comes along, and masks drawn for it.

    Args:
        seed: of masks, noise, and of which mask a look is behind.
        masks: how many.
    """

    def __init__(self, seed: int, masks: int = MASKS) -> None:
        torch.set_num_threads(1)
        self.bundle = read_bundle(FRESH)
        if self.bundle.fresh is None:
            raise ValueError(f"{FRESH} holds no fresh masks")
        self._fresh = self.bundle.fresh
        self._generator = torch.Generator().manual_seed(seed)
        self._frame = self._fresh.frame(
            self.bundle.camera, self.bundle.scene, self.bundle.embedding
        )
        self._decoding = self._frame.decoding()
        self._classifier = Classifier.load(
            self._fresh.layers,
            self._fresh.weights,
            labels=self.bundle.labels,
            inputs=self.bundle.inputs,
        )
        self.masks = [self.draw() for _ in range(masks)]

    def draw(self) -> Mask:
        """Another mask, and what reads behind it."""
        key = torch.randint(0, 256, (KEY_BYTES,), generator=self._generator, dtype=torch.uint8)
        levels = draw_levels(
            key.numpy().tobytes(),
            camera=self.bundle.camera,
            distribution=self._fresh.distribution,
        )
        transfer = self._decoding.operator(self._frame.shown(levels))
        decoder = self._decoding.prepare_transfer(transfer)
        passes = transmittance(levels, self.bundle.camera.panel.levels)
        reader = FreshReader(self._classifier, decoder, passes)
        return Mask(levels, torch.from_numpy(transfer), reader)

    def look(self, scenes: Scenes) -> list[Evidence]:
        """What every one of ``scenes``, in order, tells behind a mask of its own."""
        # A step of at least one, and less than once around: never the same mask twice in a row.
        steps = torch.randint(1, len(self.masks), (len(scenes),), generator=self._generator)
        behind = steps.cumsum(0) % len(self.masks)
        found: list[Evidence | None] = [None] * len(scenes)
        for number, mask in enumerate(self.masks):
            here = (behind == number).nonzero()[:, 0].tolist()
            if here:
                for place, told in zip(here, self.look_behind(scenes[here], mask), strict=True):
                    found[place] = told
        return [each for each in found if each is not None]

    def look_behind(self, scenes: Scenes, mask: Mask) -> list[Evidence]:
        """What every one of ``scenes`` tells behind one mask."""
        return mask.reader.evidence_of(self.measured(scenes, mask))

    def measured(self, scenes: Scenes, mask: Mask) -> npt.NDArray[np.float32]:
        """What is read of every one of ``scenes`` behind one mask, (looks, rows, columns)."""
        return self._read(torch.from_numpy(scenes).flatten(1) @ mask.transfer, mask)

    def look_by_grid(self, scenes: Scenes, masks: int) -> tuple[list[Evidence], list[Evidence]]:
        """The same scenes behind the same masks: by the matrix, and by the daemon's light."""
        grid = planned_light(self.bundle.camera, self.bundle.scene, self.bundle.embedding)
        by_matrix, by_grid = [], []
        for mask, some in zip(self.masks, np.array_split(scenes, masks), strict=False):
            images = torch.from_numpy(some)
            by_matrix += self.look_behind(some, mask)
            with torch.inference_mode():
                weights = torch.from_numpy(to_weights(mask.levels, self.bundle.camera.panel))
                raw = grid.collect(images, grid.response(weights))
            light = area_average(raw, *self.bundle.embedding.shape).flatten(1)
            by_grid += mask.reader.evidence_of(self._read(light, mask))
        return by_matrix, by_grid

    def _read(self, light: Tensor, mask: Mask) -> npt.NDArray[np.float32]:
        """Measurements, (batch, embedding pixels), once noise is added, as a sensor's."""
        with torch.inference_mode():
            floor = READ_NOISE * float(mask.reader.decoder.mean_measurement.mean())
            noise = torch.randn(light.shape, generator=self._generator)
            read = shot_noise(light, SNR_DB, self._generator) + floor * noise
            return read.reshape(-1, *self.bundle.embedding.shape).numpy()


def fixing_digits() -> Digits:
    """Every other digit of those that come along: they fixed the numbers of the filter."""
    shipped = load_digits()
    return Digits(shipped.images[::2], shipped.labels[::2])


def unseen_digits(data: Path | None = None) -> Digits:
    """Digits that fixed nothing, of those that come along or of the MNIST test files."""
    every = load_digits()
    if data is not None:
        every = Digits(read_idx(data / IMAGES), read_idx(data / LABELS))
    known = {image.tobytes() for image in fixing_digits().images}
    unseen = [place for place, image in enumerate(every.images) if image.tobytes() not in known]
    return Digits(every.images[unseen], every.labels[unseen])


def as_scenes(images: npt.NDArray[np.uint8]) -> Scenes:
    """Reflectance of pictures."""
    return (images / np.float32(255)).astype(np.float32)


def empty_scenes(count: int, draw: np.random.Generator, *, held: int = 20) -> Scenes:
    """Scenes without a thing, each held for several looks: darkness, dim rooms, lit walls.

    A third each: black; evenly lit, up to 5 % of white; up to white, falling off to one side.
    """
    down, across = np.mgrid[-1:1:28j, -1:1:28j]
    made = list[npt.NDArray[np.float64]]()
    for number in range(-(-count // held)):
        kind = number % 3
        if kind == 0:
            scene = np.zeros((28, 28))
        elif kind == 1:
            scene = np.full((28, 28), draw.uniform(0, 0.05))
        else:
            angle, slope = draw.uniform(0, 2 * np.pi), draw.uniform(0, 0.7)
            fall = 1 + slope * (np.cos(angle) * across + np.sin(angle) * down)
            scene = draw.uniform(0.05, 1) * fall / fall.max()
        made += [scene] * held
    return np.array(made[:count], np.float32)


def odd_scenes(images: npt.NDArray[np.uint8], draw: np.random.Generator) -> dict[str, Scenes]:
    """Scenes that are no digits, or digits that are hard to see, by what they are."""
    whole = as_scenes(images)
    count = len(whole)
    down, across = np.mgrid[-1:1:28j, -1:1:28j]
    face = (across**2 / 0.5 + down**2 / 0.8 < 1) * 0.7
    for side in (-0.3, 0.3):
        face[(across - side) ** 2 + (down + 0.25) ** 2 < 0.015] = 0.05
    face[(np.abs(down - 0.4) < 0.06) & (np.abs(across) < 0.3)] = 0.15
    left = whole.copy()
    left[:, :, 14:] = 0
    moved = np.zeros_like(whole)
    moved[:, :, 10:] = whole[:, :, :18]
    lit = np.clip(whole + draw.uniform(0, 0.05, (count, 1, 1)), 0, 1).astype(np.float32)
    return {
        "a wall, lit from one side": empty_scenes(3 * count, draw, held=1)[2::3],
        "a face, drawn": (face * draw.uniform(0.5, 1, (count, 1, 1))).astype(np.float32),
        "noise, every pixel": draw.uniform(0, 1, whole.shape).astype(np.float32),
        "noise, few pixels": (draw.uniform(0, 1, whole.shape) < 0.13).astype(np.float32),
        "half a digit": left,
        "a digit 10 pixels aside": moved,
        "a digit, half as bright": (whole / 2).astype(np.float32),
        "a digit, a fifth as bright": (whole / 5).astype(np.float32),
        "a digit in stray light up to 5 %": lit,
    }
