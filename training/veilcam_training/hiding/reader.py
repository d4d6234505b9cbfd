"""Reader that knows the task and no mask: a small network that is trained behind other masks."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from veilcam_optics.camera.geometry import Camera, Embedding
from veilcam_training.data import Images
from veilcam_training.hiding.machine import FINEST, averaging, power_spectra
from veilcam_training.hiding.masks import Draw, other_mask
from veilcam_training.hiding.pinholes import Measurer

Values = npt.NDArray[Any]

FEW = 1000
"""Values up to which measurements are read as they are. Of more, spectra tell more in gray, and
averages in colour."""
_MASKS = 300
_SCENES = 200
"""Scenes behind each mask of the training."""
_EPOCHS, _LONGER = 3, 5
"""Epochs, and those of averaged values: they read as much as all values then."""
_BATCH = 256
_HIDDEN = 512


class Reader:
    """Reader of labels from one measurement.

    Args:
        camera: camera whose masks are in question.
        embedding: shape of the embedding.
        measure: measurements of that camera.
        images: training images.
        labels: number of labels.
        draw: draw of the masks that it is trained behind.
    """

    def __init__(
        self,
        camera: Camera,
        embedding: Embedding,
        measure: Measurer,
        images: Images,
        labels: int,
        *,
        draw: Draw = other_mask,
    ) -> None:
        self._embedding = self._read_at = embedding
        many = measure.channels * embedding.size > FEW
        self._spectra = many and measure.channels == 1
        averaged = many and not self._spectra
        if averaged:
            self._read_at = Embedding(*map(min, embedding.shape, FINEST.shape))
            measure = measure.at(self._read_at)
        random = np.random.default_rng(3)
        inputs, wanted = [], []
        # Few images are soon learned by heart.
        for _ in range(min(_MASKS, 1 + len(images) // 20)):
            chosen = torch.from_numpy(random.integers(len(images), size=_SCENES))
            values = measure(scenes_of(images, chosen), draw(camera.mask_shape, random))
            inputs.append(self._inputs(values))
            wanted.append(images.labels[chosen])
        epochs = _LONGER if averaged else _EPOCHS
        self._network = _train(torch.cat(inputs), torch.cat(wanted), labels, epochs)

    @torch.no_grad()
    def read(self, measurements: Values, labels: Tensor) -> float:
        """Return the share of labels that are read right.

        Args:
            measurements: (count, channels * pixels).
            labels: int64 (count,).
        """
        found = self._network(self._inputs(self._averaged(measurements))).argmax(1)
        return float((found == labels).float().mean())

    def _averaged(self, measurements: Values) -> Values:
        if self._read_at == self._embedding:
            return measurements
        down, across = map(averaging, self._embedding.shape, self._read_at.shape)
        images = down @ measurements.reshape(-1, *self._embedding.shape) @ across.T
        averages: Values = images.reshape(len(measurements), -1)
        return averages

    def _inputs(self, measurements: Values) -> Tensor:
        if self._spectra:
            return torch.from_numpy(power_spectra(measurements, self._embedding))
        values = torch.from_numpy(measurements)
        values = values - values.mean(1, keepdim=True)
        values = values / values.std(1, keepdim=True).clamp_min(1e-12)
        return torch.cat([values, values.square() - 1], 1)


def scenes_of(images: Images, chosen: Tensor | slice) -> Values:
    """Return images as scenes, float32 (count, channels, rows, columns)."""
    scenes: Values = images.scenes(chosen).numpy()
    return scenes if scenes.ndim == 4 else scenes[:, None]


def _train(inputs: Tensor, labels: Tensor, classes: int, epochs: int) -> nn.Module:
    """Return a perceptron fitted to inputs (count, numbers) and labels (count,)."""
    with torch.random.fork_rng(devices=()):
        torch.manual_seed(3)
        network = nn.Sequential(
            nn.BatchNorm1d(inputs.shape[1]),
            *_layer(inputs.shape[1], _HIDDEN),
            *_layer(_HIDDEN, _HIDDEN // 2),
            nn.Linear(_HIDDEN // 2, classes),
        )
        steps = epochs * (len(inputs) // _BATCH + 1)
        adam = torch.optim.Adam(network.parameters(), 2e-3)
        rates = torch.optim.lr_scheduler.OneCycleLR(adam, 3e-3, total_steps=steps)
        for _ in range(epochs):
            for batch in torch.split(torch.randperm(len(inputs)), _BATCH):
                loss = nn.functional.cross_entropy(network(inputs[batch]), labels[batch])
                adam.zero_grad()
                loss.backward()  # type: ignore[no-untyped-call]
                adam.step()
                rates.step()
    return network.eval()


def _layer(inputs: int, outputs: int) -> tuple[nn.Module, ...]:
    return nn.Linear(inputs, outputs), nn.BatchNorm1d(outputs), nn.GELU()
