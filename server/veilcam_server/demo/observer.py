"""Tells which mask an embedding was made with, from the bundle and, for fresh masks, a key.

The API names epochs, not masks. The demonstration holds what it takes to find the mask of an epoch:
the bundle, and the private key of a receiver.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
import numpy.typing as npt
import torch

from veilcam_client.keys.envelopes import open_key
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.sealing import Envelope
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.keys.masks import draw_levels
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_server.devices.base import Levels, Measurement
from veilcam_training.bundle import Bundle


class Observer(Protocol):
    """Knows every mask."""

    def which(
        self, image: npt.NDArray[np.uint8], embedding: Measurement, envelope: Envelope
    ) -> int:
        """Return a number for the mask behind which ``embedding`` of ``image`` was taken.

        Args:
            image: image that was shown.
            embedding: embedding as it was read.
            envelope: envelope of its epoch.
        """

    def levels(self, mask: int) -> Levels:
        """Return what the panel showed for the mask of this number."""


class PairObserver:
    """Predicts the embedding of every stored mask, and takes the one that fits."""

    def __init__(self, bundle: Bundle) -> None:
        self._pairs = bundle.pairs
        operator = TransferOperator(bundle.camera, bundle.scene, bundle.embedding)
        with torch.inference_mode():
            self._transfers = [
                operator(torch.from_numpy(to_weights(pair.levels, bundle.camera.panel)))
                for pair in bundle.pairs
            ]

    def which(
        self,
        image: npt.NDArray[np.uint8],
        embedding: Measurement,
        envelope: Envelope,  # noqa: ARG002 - the masks lie in the bundle, under no key
    ) -> int:
        """Return the index of the pair whose predicted raw embedding lies nearest."""
        scene = torch.from_numpy(image / np.float32(255)).reshape(1, -1)
        seen = torch.from_numpy(embedding.ravel())
        distances = [float((scene @ transfer - seen).norm()) for transfer in self._transfers]
        return int(np.argmin(distances))

    def levels(self, mask: int) -> Levels:
        """Return the levels of a pair."""
        return self._pairs[mask].levels


class KeyObserver:
    """Opens the envelope of an epoch and draws its mask again, as every receiver can."""

    def __init__(self, bundle: Bundle, key: ReceiverKey) -> None:
        if bundle.fresh is None:
            raise ValueError(f"a bundle of mode {bundle.mode!r} draws no masks")
        self._camera, self._distribution = bundle.camera, bundle.fresh.distribution
        self._key = key
        self._levels: dict[str, Levels] = {}

    def which(
        self,
        image: npt.NDArray[np.uint8],  # noqa: ARG002 - the key says it without looking
        embedding: Measurement,  # noqa: ARG002
        envelope: Envelope,
    ) -> int:
        """Return how many masks came before that of the envelope's epoch."""
        if envelope.epoch not in self._levels:
            key = open_key(envelope, self._key, device=None)
            self._levels[envelope.epoch] = draw_levels(
                key.levels(), camera=self._camera, distribution=self._distribution
            )
        return list(self._levels).index(envelope.epoch)

    def levels(self, mask: int) -> Levels:
        """Return the levels of a mask that was seen."""
        return list(self._levels.values())[mask]
