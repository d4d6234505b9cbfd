"""The camera as its attackers meet it: masks that come and go, and what leaves behind each.

It keeps to itself what a camera keeps (masks, keys, measurements) and gives what a camera gives: a
vector for each capture and the name of its epoch. Attacks never see this object. They are given
tensors of it: what leaves and, where a threat says so, pictures, masks or transfer matrices.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import torch
from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305
from torch import Tensor

from veilcam_optics.camera.geometry import Camera
from veilcam_optics.camera.masks import quantise, random_mask, to_weights
from veilcam_optics.decoding import Decoder, SceneDecoding
from veilcam_optics.keys.masks import KEY_BYTES, MaskDistribution, draw_levels
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_training.errors import require

SNR_DB = 40.0
"""Noise of a measurement, as the daemon's simulated camera has it."""


class MaskSource(Protocol):
    """Source of the masks of epochs."""

    def __call__(self, generator: torch.Generator) -> tuple[int, Tensor]:
        """Return the mask of the next epoch: its place in the store (-1: none), and weights."""


class StoredMasks:
    """Masks that are kept and come again, in an order that nobody foresees.

    Args:
        weights: weights of each mask, ``camera.mask_shape``.
    """

    def __init__(self, weights: Sequence[Tensor]) -> None:
        require(len(weights) > 0, "there are no masks: store one or more")
        self.weights = tuple(weights)

    @classmethod
    def random(cls, camera: Camera, count: int, generator: torch.Generator) -> "StoredMasks":
        """Masks that were drawn once, uniformly over all that the panel can show."""
        drawn = (random_mask(camera, generator) for _ in range(count))
        return cls([quantise(weights, camera.panel) for weights in drawn])

    def __call__(self, generator: torch.Generator) -> tuple[int, Tensor]:
        """Any of them."""
        place = int(torch.randint(len(self.weights), (), generator=generator))
        return place, self.weights[place]


@dataclass(frozen=True)
class FreshMasks:
    """Masks that are drawn from a key of their own for every epoch, and never come again."""

    camera: Camera
    distribution: MaskDistribution

    def __call__(self, generator: torch.Generator) -> tuple[int, Tensor]:
        """Return a new mask."""
        levels = draw_levels(_key(generator), camera=self.camera, distribution=self.distribution)
        return -1, torch.from_numpy(to_weights(levels, self.camera.panel))


@dataclass(frozen=True)
class VictimMask:
    """The mask of one epoch, and all that follows from its key."""

    epoch: int
    """Its public name: no two masks in turn share one, whether or not the mask comes again."""
    place: int = field(repr=False)
    """Among those stored; -1 for a mask that never comes again. Secret, as all below."""
    weights: Tensor = field(repr=False)
    """``camera.mask_shape``."""
    transfer: Tensor = field(repr=False)
    """Of the light, (scene pixels, embedding pixels)."""
    decoder: Decoder | None = field(repr=False)
    """None where the camera knows no scene statistics."""
    key: bytes = field(repr=False)
    """Of this epoch alone: it seals."""
    numbers: Iterator[int] = field(default_factory=itertools.count, repr=False, compare=False)
    """Of captures in this epoch that are yet to be sealed: none is sealed under a number twice."""


ReleaseRule = Callable[[VictimMask, Tensor], Tensor]
"""From a mask and measurements (count, E) to what leaves, (count, numbers)."""


Prepared = tuple[Tensor, Decoder | None]
"""Transfer matrix of the light behind a mask, and its decoder."""


def raw(mask: VictimMask, measurements: Tensor) -> Tensor:
    """Measurements as they were read."""
    del mask
    return measurements


def sealed(mask: VictimMask, measurements: Tensor) -> Tensor:
    """Ciphertext and its tag, byte for byte: 4 E + 16 numbers of variance 1.

    The cipher is the one that embeddings are sealed with, under the epoch's key; its nonce is the
    number of a capture in its epoch.
    """
    cipher, rows = ChaCha20Poly1305(mask.key), []
    for measurement in measurements.float().cpu().numpy():
        block = cipher.encrypt(_nonce(next(mask.numbers)), measurement.tobytes(), None)
        rows.append(np.frombuffer(block, np.uint8))
    values = torch.from_numpy(np.stack(rows).astype(np.float32))
    return (values - _BYTE_MEAN) / _BYTE_DEVIATION


def unsealed(mask: VictimMask, released: Tensor) -> Tensor | None:
    """Measurements of the first captures of an epoch, or None: another key opens nothing.

    Args:
        mask: mask whose key is tried.
        released: result of :func:`sealed` for the first captures, in their order.
    """
    cipher, rows = ChaCha20Poly1305(mask.key), []
    blocks = (released * _BYTE_DEVIATION + _BYTE_MEAN).round().to(torch.uint8).numpy()
    try:
        for number, block in enumerate(blocks):
            opened = cipher.decrypt(_nonce(number), block.tobytes(), None)
            rows.append(np.frombuffer(opened, np.float32))
    except InvalidTag:
        return None
    return torch.from_numpy(np.stack(rows))


_BYTE_MEAN, _BYTE_DEVIATION = 127.5, math.sqrt((256**2 - 1) / 12)


def _nonce(number: int) -> bytes:
    return number.to_bytes(12, "little")


FORMS: dict[str, ReleaseRule] = {"raw": raw, "sealed": sealed}


@dataclass(frozen=True)
class Captures:
    """Released embeddings of some scenes, mask by mask."""

    released: Tensor
    """(masks, captures of each, numbers)."""
    epochs: Tensor
    """int64 (masks,): the public names."""
    masks: tuple[VictimMask, ...] = field(repr=False)
    """What no attacker is given but by a threat that says so."""


class Victim:
    """A camera under attack.

    Args:
        light: transfer operator of the camera as it is.
        source: source of masks.
        release: form in which an embedding leaves.
        decoding: decoding with the camera's knowledge of scenes; None: none.
        snr_db: signal-to-noise ratio of a measurement [dB].
        generator: generator of masks, keys and noise.
        prepared: transfer and decoder of stored masks by their place: cameras with the same masks
            share what one of them has prepared. None: nothing is shared.
    """

    def __init__(
        self,
        light: TransferOperator,
        source: MaskSource,
        release: ReleaseRule,
        *,
        decoding: SceneDecoding | None = None,
        snr_db: float = SNR_DB,
        generator: torch.Generator,
        prepared: dict[int, Prepared] | None = None,
    ) -> None:
        self.light, self.source, self.release = light, source, release
        self.decoding, self.snr_db = decoding, snr_db
        self._generator, self._epochs = generator, 0
        self._prepared = {} if prepared is None else prepared

    def mask(self) -> VictimMask:
        """Return the mask of the next epoch."""
        return self._epoch(*self.source(self._generator))

    def leak(self, count: int) -> tuple[VictimMask, ...]:
        """Return a list as it may leak: all stored masks, or those of the next ``count`` epochs."""
        if isinstance(self.source, StoredMasks):
            return tuple(self._epoch(*each) for each in enumerate(self.source.weights))
        return tuple(self.mask() for _ in range(count))

    @torch.no_grad()
    def _epoch(self, place: int, weights: Tensor) -> VictimMask:
        self._epochs += 1
        known = self._prepared.get(place) or self._prepare(weights)
        if place >= 0:  # it comes again
            self._prepared[place] = known
        return VictimMask(self._epochs, place, weights, *known, _key(self._generator))

    def _prepare(self, weights: Tensor) -> tuple[Tensor, Decoder | None]:
        decoder = None if self.decoding is None else self.decoding.prepare(weights)
        return self.light(weights), decoder

    @torch.no_grad()
    def measure(self, mask: VictimMask, scenes: Tensor) -> Tensor:
        """Noisy measurements (count, E) of scenes (count, rows, columns), which never leave."""
        return shot_noise(scenes.flatten(1) @ mask.transfer, self.snr_db, self._generator)

    @torch.no_grad()
    def capture(self, mask: VictimMask, scenes: Tensor) -> Tensor:
        """Return released embeddings of scenes (count, rows, columns), as (count, numbers)."""
        return self.release(mask, self.measure(mask, scenes))

    def watch(self, scenes: Tensor) -> Captures:
        """Change the mask for every row of scenes (masks, captures of each, rows, columns)."""
        masks = tuple(self.mask() for _ in range(len(scenes)))
        released = [self.capture(mask, each) for mask, each in zip(masks, scenes, strict=True)]
        return Captures(torch.stack(released), torch.tensor([mask.epoch for mask in masks]), masks)


def _key(generator: torch.Generator) -> bytes:
    drawn = torch.randint(256, (KEY_BYTES,), generator=generator, dtype=torch.uint8)
    return drawn.numpy().tobytes()
