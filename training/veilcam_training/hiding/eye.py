"""Eye that looks for pictures of candidates in one measurement: matched filters of pinholes.

Behind a sub-pixel of row r and column c alone, a scene X shows the picture ``Ky[r]' X Kx[c]``. The
eye compares the measurement with such pictures of all candidates, at each place, and adds up the
colours. Both are high-passed, and normalised inside the window that the pinhole's light covers. All
factors are separable: the measurement is projected back to the scene, and no picture is kept.
"""

from __future__ import annotations

import itertools
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache, reduce
from typing import Any

import numpy as np
import numpy.typing as npt

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_training.hiding.pinholes import Kernel, Measurer, pinhole, pinhole_kernels
from veilcam_training.hiding.scenes import GROUP, drawn_scenes, random_masks, smoother

Values = npt.NDArray[Any]

SCENES = 2 * GROUP
_SMOOTH = {1: 1.75 / 24, 3: 3.5 / 24}
"""Standard deviation of the mean that the high-pass subtracts, in heights of the sensor; by the
number of channels. Random masks are seen little then, and fifty holes or a hole in a random ground
clearly."""
_TRUST = {1: 0.0, 3: 0.25}
"""Power of a window's pixels that its correlations are multiplied by: few agree by chance; by the
number of channels."""
_LIT = 0.1
"""Share of the brightest pixel from which a pixel belongs to a pinhole's window."""
_KEPT = 0.2
"""Share of the largest singular value from which a mode of the scene is kept."""


@dataclass(frozen=True)
class _Axis:
    """Pinholes along one axis of one colour."""

    modes: Values
    """Modes of the scene, (scene pixels, modes)."""
    sharp: Values
    """Pictures of the modes inside the window, (places, modes, pixels)."""
    smooth: Values
    """Smoothed pictures of the modes inside the window."""
    window: Values
    """Windows of the pinholes, 0 or 1, (places, pixels)."""

    @classmethod
    def of(cls, kernel: Values, smoothing: Values) -> _Axis:
        """Make an axis from kernels (places, scene pixels, pixels)."""
        flat = kernel.transpose(1, 0, 2).reshape(kernel.shape[1], -1)
        left, values, _ = np.linalg.svd(flat, full_matrices=False)
        modes = left[:, values > _KEPT * values[0]]
        light = kernel.sum(1)
        window = light > _LIT * light.max(1, keepdims=True)
        window[window.sum(1) < 2] = True
        sharp = modes.T @ kernel
        inside = window[:, None].astype(np.float32)
        return cls(modes, sharp * inside, sharp @ smoothing.T * inside, inside[:, 0])


@dataclass(frozen=True)
class _Colour:
    """Pinholes of one colour, and the candidates as they show them."""

    channel: int
    y: _Axis
    x: _Axis
    candidates: Values
    """(candidates, modes y * modes x)."""
    means: Values
    """Means of the pictures in their windows, (places y, places x, candidates)."""
    norms: Values
    """Norms of the pictures less their means, smaller where a window is large."""


class Eye:
    """Eye for one camera and its candidates.

    Args:
        camera: geometry.
        scene: before it.
        embedding: shape of the embedding.
        channels: 1 gray, 3 in colour.
        scenes: candidates, (count, channels, rows, columns) in [0, 1]; drawn ones by default.
    """

    def __init__(
        self,
        camera: Camera,
        scene: Scene,
        embedding: Embedding,
        channels: int = 1,
        scenes: Values | None = None,
    ) -> None:
        self.scenes = drawn_scenes(scene, channels, SCENES) if scenes is None else scenes
        self._camera, self._embedding, self._channels = camera, embedding, channels
        self._measure = Measurer(camera, scene, embedding, channels)
        sigma = _SMOOTH[channels] * embedding.rows
        self._smooth_y = smoother(embedding.rows, sigma)
        self._smooth_x = smoother(embedding.columns, sigma)
        self._colours = [
            self._prepare(channel, _Axis.of(y, self._smooth_y), _Axis.of(x, self._smooth_x))
            for channel, y, x in _brightest(pinhole_kernels(camera, scene, embedding, channels))
        ]
        # As their sub-pixels lie, from the top.
        self._colours.sort(key=lambda each: int(np.argmax(camera.row_amplitudes(each.channel))))
        self.pinhole = self.seen(pinhole(camera))
        # Twenty masks are many: each hides one of the hundreds, in turn.
        starts = range(0, len(self.scenes), GROUP)
        shares = [
            self.seen(mask, slice(start, start + GROUP))
            for mask, start in zip(random_masks(camera), itertools.cycle(starts), strict=False)
        ]
        self.random = float(np.mean(shares))

    def seen(self, weights: Values, part: slice = slice(None)) -> float:
        """Return the share of scenes that the eye picks out of a hundred behind a mask.

        Args:
            weights: amplitude transmittances, ``camera.mask_shape``.
            part: scenes that are shown; all by default.

        Raises:
            OpticsError: the mask has another shape, or holds NaN or infinity.
        """
        values, first = self._measure(self.scenes[part], weights), part.start or 0
        picked = 0
        for start in range(0, len(values), GROUP):
            scores = self.scores(
                values[start : start + GROUP], slice(first + start, first + start + GROUP)
            )
            picked += int((scores.argmax(1) == np.arange(len(scores))).sum())
        return picked / len(values)

    def scores(self, measurements: Values, group: slice) -> Values:
        """Return the best correlation of measurements with candidates, (measurements, group).

        Args:
            measurements: (count, channels * pixels).
            group: candidates that are compared.
        """
        values = measurements.reshape(len(measurements), self._channels, *self._embedding.shape)
        best = np.full((len(values), len(self.scenes[group])), -np.inf, np.float32)
        images = values - self._smooth_y @ values @ self._smooth_x.T
        rows = [_correlations(images[:, each.channel], each, group) for each in self._colours]
        near: deque[Values] = deque(maxlen=len(rows))
        for found in itertools.chain.from_iterable(zip(*rows, strict=False)):
            near.append(found)
            if len(near) == len(rows):
                # A pinhole lets all colours through, whichever is on top: their evidence adds up.
                np.maximum(best, reduce(np.add, near).max(1) / np.sqrt(len(near)), out=best)
        return best

    def _prepare(self, channel: int, y: _Axis, x: _Axis) -> _Colour:
        faded = self.scenes[:, channel] * self._measure.fade
        modes = y.modes.T @ faded @ x.modes
        means, norms = [], []
        right = np.concatenate([x.sharp, -x.smooth], axis=1).transpose(1, 0, 2)
        right = right.reshape(right.shape[0], -1)
        for sharp, smooth, window in zip(y.sharp, y.smooth, y.window, strict=True):
            left = np.concatenate([sharp.T @ modes, smooth.T @ modes], axis=2)
            pictures = (left @ right).reshape(*left.shape[:2], *x.window.shape)
            sizes = window.sum() * x.window.sum(1)
            mean = pictures.sum((1, 3)) / sizes
            means.append(mean.T)
            norms.append((np.square(pictures).sum((1, 3)) - sizes * mean**2).T)
        squares = np.array(norms)
        pixels = np.outer(y.window.sum(1), x.window.sum(1))[:, :, None]
        return _Colour(
            channel,
            y,
            x,
            modes.reshape(len(modes), -1),
            np.array(means),
            np.sqrt(np.maximum(squares, 1e-12 * squares.max())) / pixels ** _TRUST[self._channels],
        )


@lru_cache(maxsize=2)
def drawn_eye(camera: Camera, scene: Scene, embedding: Embedding, channels: int) -> Eye:
    """Return the eye that looks for drawn scenes; it is made once for each camera."""
    return Eye(camera, scene, embedding, channels)


def _brightest(kernels: Iterable[Kernel]) -> Iterable[Kernel]:
    """Kernels of the brightest colour of each channel: a gray camera adds up three."""
    best: dict[int, Kernel] = {}
    for kernel in kernels:
        before = best.get(kernel[0])
        if before is None or kernel[1].sum() > before[1].sum():
            best[kernel[0]] = kernel
    return best.values()


def _correlations(image: Values, colour: _Colour, group: slice) -> Iterator[Values]:
    """Correlations (measurements, places, candidates) in each row of places."""
    x = colour.x
    count, modes_x = len(image), x.modes.shape[1]
    candidates = colour.candidates[group].T
    right = np.concatenate([x.sharp, -x.smooth], axis=2).transpose(2, 0, 1)
    right = np.ascontiguousarray(right.reshape(right.shape[0], -1))
    floor = 1e-12 * float(np.square(image).sum((1, 2)).max(initial=0)) + 1e-30
    for row, window in enumerate(colour.y.window):
        left = np.concatenate([colour.y.sharp[row] @ image, colour.y.smooth[row] @ image], axis=2)
        back = (left.reshape(-1, left.shape[2]) @ right).reshape(count, -1, len(x.window), modes_x)
        back = back.transpose(0, 2, 1, 3).reshape(count * len(x.window), -1)
        products = (back @ candidates).reshape(count, len(x.window), -1)
        total = window @ image @ x.window.T
        sizes = window.sum() * x.window.sum(1)
        energy = window @ np.square(image) @ x.window.T - total**2 / sizes
        products -= total[:, :, None] * colour.means[row][None, :, group]
        products /= np.sqrt(np.maximum(energy, floor))[:, :, None]
        products /= colour.norms[row][None, :, group]
        yield products
