"""Tells which mask an embedding was made with, from the bundle and, for fresh masks, the secret.

The API names epochs, not masks. The demonstration holds what it takes to find the mask of an epoch.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import numpy.typing as npt
import torch

from veilcam_optics.camera.masks import to_weights
from veilcam_optics.keys.epoch_names import EpochNames
from veilcam_optics.keys.masks import Secret, epoch_levels
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_server.devices.base import Levels, Measurement
from veilcam_training.bundle import Bundle


class Observer(Protocol):
    """Knows every mask."""

    def which(self, image: npt.NDArray[np.uint8], embedding: Measurement, epoch: str) -> int:
        """Return a number for the mask behind which ``embedding`` of ``image`` was taken."""

    def levels(self, mask: int) -> Levels:
        """Return what the panel showed for the mask of this number."""


class PairObserver:
    """Predicts the embedding of every stored mask, and takes the one that fits."""

    def __init__(self, bundle: Bundle) -> None:
        self._pairs = bundle.pairs
        operator = TransferOperator(bundle.camera, bundle.scene, bundle.embedding)
        with torch.inference_mode():
            self._transfers = [
                operator(to_weights(pair.levels, bundle.camera.panel)) for pair in bundle.pairs
            ]

    def which(self, image: npt.NDArray[np.uint8], embedding: Measurement, epoch: str) -> int:  # noqa: ARG002
        """Return the index of the pair whose predicted raw embedding lies nearest."""
        scene = torch.from_numpy(image / np.float32(255)).reshape(1, -1)
        seen = torch.from_numpy(embedding.ravel())
        distances = [float((scene @ transfer - seen).norm()) for transfer in self._transfers]
        return int(np.argmin(distances))

    def levels(self, mask: int) -> Levels:
        """Return the levels of a pair."""
        return self._pairs[mask].levels


class KeyObserver:
    """Reads the counter in an epoch's name and draws its mask again, as the secret allows."""

    def __init__(self, bundle: Bundle, secret: Secret) -> None:
        if bundle.fresh is None:
            raise ValueError(f"a bundle of mode {bundle.mode!r} has no key policy")
        self._bundle, self._fresh, self._secret = bundle, bundle.fresh, secret
        self._names = EpochNames(secret, bundle.fresh.device)
        self._counters: list[int] = []

    def which(self, image: npt.NDArray[np.uint8], embedding: Measurement, epoch: str) -> int:  # noqa: ARG002
        """Return how many masks came before that of ``epoch``."""
        counter = self._names.counter(epoch)
        if counter not in self._counters:
            self._counters.append(counter)
        return self._counters.index(counter)

    def levels(self, mask: int) -> Levels:
        """Return the levels of a mask that was seen."""
        return epoch_levels(
            self._secret,
            self._fresh.device,
            self._counters[mask],
            camera=self._bundle.camera,
            distribution=self._fresh.distribution,
        )
