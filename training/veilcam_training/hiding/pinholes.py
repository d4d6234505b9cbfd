"""Measurements of scenes behind a mask, and the pictures that single sub-pixels show."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.transfer.tables import Reach, make_transfer
from veilcam_training.hiding.scenes import noisy

Values = npt.NDArray[Any]
Kernel = tuple[int, Values, Values]
"""Channel; kernels (places, scene pixels, pixels) of one colour along y, and along x."""


class Measurer:
    """Noisy measurements of one camera.

    Args:
        camera: geometry.
        scene: before it.
        embedding: shape of the embedding.
        channels: 1 gray, 3 in colour.
    """

    def __init__(self, camera: Camera, scene: Scene, embedding: Embedding, channels: int) -> None:
        self._transfer = make_transfer(
            camera, scene, embedding, colour=channels > 1, like=np.empty(0, np.float32)
        )
        self.channels = channels

    @property
    def fade(self) -> Values:
        """Share of the light that each scene pixel keeps over the field, (rows, columns)."""
        return self._transfer.fade

    def at(self, embedding: Embedding) -> Measurer:
        """Return measurements of the same camera and scene at another embedding."""
        return Measurer(self._transfer.camera, self._transfer.scene, embedding, self.channels)

    def __call__(self, scenes: Values, weights: Values) -> Values:
        """Return measurements at 40 dB, float32 (count, channels * pixels).

        Args:
            scenes: (count, channels, rows, columns) in [0, 1].
            weights: amplitude transmittances, ``camera.mask_shape``.

        Raises:
            OpticsError: the mask has another shape, or holds NaN or infinity.
        """
        count, channels = len(scenes), self.channels
        transfer = self._transfer(weights.astype(np.float32))
        transfer = transfer.reshape(channels, -1, transfer.shape[-1])
        flat = scenes.reshape(count, channels, -1).transpose(1, 0, 2)
        return noisy((flat @ transfer).transpose(1, 0, 2).reshape(count, -1))


def pinhole_kernels(
    camera: Camera, scene: Scene, embedding: Embedding, channels: int
) -> Iterator[Kernel]:
    """Yield the kernels of each colour; light of different sub-pixels does not interfere."""
    transfer = make_transfer(
        camera,
        scene,
        embedding,
        reach=Reach(0, 0),
        colour=channels > 1,
        like=np.empty(0, np.float32),
    )
    for channel, measurement in enumerate(transfer.measurements):
        start = 0
        for stack in measurement.stacks:
            pairs = len(stack.first) // len(stack.columns)
            for columns in stack.columns:
                rows = measurement.rows[:, start : start + pairs].T
                start += pairs
                yield (
                    channel,
                    rows.reshape(pairs, scene.rows, embedding.rows),
                    columns.reshape(-1, scene.columns, embedding.columns),
                )


def pinhole(camera: Camera) -> Values:
    """Return the mask of one open sub-pixel of each colour in the middle of the window."""
    rows, columns = camera.mask_shape
    mask = np.zeros((rows, columns), np.float32)
    top = max(0, rows // 2 - 1)
    mask[top : top + 3, columns // 2] = 1
    return mask
