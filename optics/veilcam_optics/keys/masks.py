"""Masks from a key: 32 bytes that serve one mask, once.

Everything here is whole numbers, so that whoever has the key makes the same mask again, on any
machine and byte for byte. What a key is for, and for which device and bundle, is the affair of
whoever derives it: two uses never share one.
"""

from dataclasses import dataclass, field
from typing import Self

import numpy as np
import numpy.typing as npt
from cryptography.hazmat.primitives.ciphers import Cipher, algorithms

from veilcam_optics.camera.geometry import Camera
from veilcam_optics.errors import OpticsError, require, require_positive, require_shape

KEY_BYTES = 32

Levels = npt.NDArray[np.uint8]


@dataclass(frozen=True)
class MaskDistribution:
    """Distribution of a key's masks: public, and fixed for as long as a classifier serves.

    Every sub-pixel draws a whole number uniformly from ``lowest`` to ``highest``, both included,
    independently of the others, and shows the level that ``curve`` holds for it. The default is
    uniform over all levels. A curve that favours dark levels makes small embeddings tell more
    apart; a range that a task has learned fixes a mask's centre, and the key draws around it.
    """

    lowest: Levels = field(repr=False)
    """uint8, ``camera.mask_shape``."""
    highest: Levels = field(repr=False)
    """uint8, ``camera.mask_shape``."""
    curve: Levels = field(repr=False)
    """uint8, (panel levels,): the level shown for each number drawn."""

    def __post_init__(self) -> None:
        for name, dimensions in (("lowest", 2), ("highest", 2), ("curve", 1)):
            array = getattr(self, name)
            if not isinstance(array, np.ndarray) or array.dtype != np.uint8:
                raise OpticsError(f"distribution.{name} is not valid: use a uint8 array")
            require(
                array.ndim == dimensions and array.size != 0,
                f"distribution.{name}.shape",
                array.shape,
                "",
                f"{dimensions} dimensions",
            )
        require_shape("distribution.highest", self.highest, *self.lowest.shape)
        if bool((self.lowest > self.highest).any()):
            raise OpticsError("distribution.lowest exceeds highest: use at most the same number")
        if max(int(np.max(self.highest)), int(np.max(self.curve))) >= self.curve.size:
            raise OpticsError(
                f"distribution exceeds its {self.curve.size} levels: use 0 to {self.curve.size - 1}"
            )

    @classmethod
    def uniform(cls, camera: Camera) -> Self:
        """All that the panel can show, for every sub-pixel."""
        return cls.power(camera, 1.0)

    @classmethod
    def power(cls, camera: Camera, exponent: float) -> Self:
        """Weights ``u ** exponent`` for uniform ``u``, rounded to the panel's levels.

        An exponent above 1 makes most sub-pixels dark and a few open. The embedding then adds up
        fewer shifted images of the scene, which leaves more contrast in it.
        """
        require_positive("exponent", exponent, "")
        levels = camera.panel.levels
        require(levels <= 256, "panel.levels", levels, "", "at most 256 for keyed masks")
        curve = np.round((levels - 1) * np.linspace(0, 1, levels) ** exponent).astype(np.uint8)
        shape = camera.mask_shape
        return cls(np.zeros(shape, np.uint8), np.full(shape, levels - 1, np.uint8), curve)

    @property
    def bits(self) -> float:
        """Entropy of one mask [bit]; a key of 256 bits bounds what it is worth."""
        ranges, times = np.unique(
            np.stack([self.lowest.ravel(), self.highest.ravel()]), axis=1, return_counts=True
        )
        total = 0.0
        for (low, high), count in zip(ranges.T, times, strict=True):
            shares = np.bincount(self.curve[int(low) : int(high) + 1]) / (int(high) - int(low) + 1)
            shares = shares[shares > 0]
            total -= float(count) * float((shares * np.log2(shares)).sum())
        return total

    def draw(self, stream: "KeyStream") -> Levels:
        """One mask, uint8 of shape ``camera.mask_shape``.

        A byte serves where it lies under the largest multiple of the range's size; where it does
        not, that sub-pixel takes a byte of the next round, so that no number is favoured.
        """
        counts = self.highest.astype(np.int64).reshape(-1) - self.lowest.reshape(-1) + 1
        limits = 256 - 256 % counts
        numbers = np.zeros(counts.size, np.int64)
        wanting = np.arange(counts.size)
        while wanting.size:
            drawn = stream.read(wanting.size).astype(np.int64)
            good = drawn < limits[wanting]
            chosen = wanting[good]
            numbers[chosen] = drawn[good] % counts[chosen]
            wanting = wanting[~good]
        numbers += self.lowest.reshape(-1)
        levels: Levels = self.curve[numbers.reshape(self.lowest.shape)]
        numbers.fill(0)  # they are the mask, too
        return levels


class KeyStream:
    """ChaCha20's key stream (RFC 8439, block counter from 0, nonce 0) under a key used once."""

    def __init__(self, key: bytes | bytearray) -> None:
        if len(key) != KEY_BYTES:
            raise OpticsError(f"a key is not valid: use {KEY_BYTES} bytes")
        self._encryptor = Cipher(algorithms.ChaCha20(key, bytes(16)), mode=None).encryptor()

    def read(self, count: int) -> npt.NDArray[np.uint8]:
        """Return the next ``count`` bytes."""
        return np.frombuffer(self._encryptor.update(bytes(count)), np.uint8)


def draw_levels(
    key: bytes | bytearray, *, camera: Camera, distribution: MaskDistribution | None = None
) -> Levels:
    """Draw the mask of a key, as levels for the panel.

    Args:
        key: 32 bytes, used for nothing else and never again.
        camera: camera with the window and the panel's number of levels.
        distribution: distribution to draw from; by default uniform over all levels.

    Returns:
        uint8 array of shape ``camera.mask_shape``: a secret, to be logged nowhere.

    Raises:
        OpticsError: a key of another length, or a distribution for another window or panel; the
            message holds no key.
    """
    if distribution is None:
        distribution = MaskDistribution.uniform(camera)
    require(
        distribution.lowest.shape == camera.mask_shape,
        "distribution.shape",
        distribution.lowest.shape,
        "",
        f"the window, {camera.mask_shape}",
    )
    require(
        distribution.curve.size == camera.panel.levels,
        "distribution.curve.size",
        distribution.curve.size,
        "levels",
        f"the panel's, {camera.panel.levels}",
    )
    return distribution.draw(KeyStream(key))
