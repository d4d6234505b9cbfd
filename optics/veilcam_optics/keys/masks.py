"""Masks from a key: levels = expand(HKDF(secret; panel, device, epoch)).

Whoever has the secret can make the mask of any epoch again, on any machine and byte for byte:
everything here is whole numbers. Without it, the mask of one epoch says nothing about another's.
An epoch must be used once; counting them, durably, is the device's duty.
"""

import hmac
import re
import secrets
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn, Self

import numpy as np
import numpy.typing as npt
from cryptography.hazmat.primitives.ciphers import Cipher, algorithms
from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from veilcam_optics.camera.geometry import Camera
from veilcam_optics.errors import (
    OpticsError,
    require,
    require_count,
    require_positive,
    require_shape,
)

SECRET_BYTES = 32
MAX_EPOCH = 2**64 - 1
MAX_DEVICE_BYTES = 255
CONTEXT = b"veilcam mask levels, version 1"

Levels = npt.NDArray[np.uint8]


class Secret:
    """256 secret bits. They show in no ``repr``, ``str``, format, pickle or error of this class."""

    __slots__ = ("_bytes",)

    def __init__(self, value: bytes) -> None:
        if not isinstance(value, bytes) or len(value) != SECRET_BYTES:
            raise OpticsError(f"a secret is not valid: use {SECRET_BYTES} bytes")
        self._bytes = value

    @classmethod
    def generate(cls) -> Self:
        """Draw a secret from the operating system's random source."""
        return cls(secrets.token_bytes(SECRET_BYTES))

    @classmethod
    def from_hex(cls, text: str) -> Self:
        """Read 64 hexadecimal digits; white space around them does not count.

        Raises:
            OpticsError: anything else. The message does not repeat it.
        """
        digits = text.strip()
        if re.fullmatch(rf"[0-9a-fA-F]{{{2 * SECRET_BYTES}}}", digits) is None:
            raise OpticsError(f"a secret is not valid: use {2 * SECRET_BYTES} hexadecimal digits")
        return cls(bytes.fromhex(digits))

    @classmethod
    def read(cls, path: Path) -> Self:
        """Read a file that holds 64 hexadecimal digits and that its owner alone may read.

        Raises:
            OpticsError: no such file, others may read it, or it holds something else.
        """
        try:
            mode = path.stat().st_mode
            text = path.read_text("ascii", "replace")
        except OSError as error:
            raise OpticsError(
                f"secret {path} cannot be read ({error.strerror}): check the path"
            ) from None
        if mode & 0o077:
            raise OpticsError(f"secret {path} is open to others: run chmod 600 {path}")
        try:
            return cls.from_hex(text)
        except OpticsError as error:
            raise OpticsError(f"{path}: {error}") from None

    def reveal(self) -> bytes:
        """The bytes themselves: for deriving keys and for storing, never for showing."""
        return self._bytes

    def __repr__(self) -> str:
        return "Secret(...)"

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Secret):
            return NotImplemented
        return hmac.compare_digest(self._bytes, other._bytes)

    __hash__ = None  # type: ignore[assignment]  # a hash would leak bits and invite dictionaries

    def __reduce__(self) -> NoReturn:
        raise TypeError("a secret is not pickled: store it with reveal(), deliberately")


@dataclass(frozen=True)
class MaskDistribution:
    """What a key's masks are drawn from: public, and fixed for as long as a classifier serves.

    Every sub-pixel draws a whole number uniformly from ``lowest`` to ``highest``, both included,
    independently of the others, and shows the level that ``curve`` holds for it. The default is
    uniform over all levels. A curve that favours dark levels makes small embeddings tell more
    apart; a range that a task has learned fixes a mask's centre, and the secret draws around it.
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
        if max(int(self.highest.max()), int(self.curve.max())) >= self.curve.size:
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
        levels: Levels = self.curve[numbers.reshape(self.lowest.shape) + self.lowest]
        return levels


class KeyStream:
    """ChaCha20's key stream (RFC 8439, block counter from 0, nonce 0) under a key used once."""

    def __init__(self, key: bytes) -> None:
        self._encryptor = Cipher(algorithms.ChaCha20(key, bytes(16)), mode=None).encryptor()

    def read(self, count: int) -> npt.NDArray[np.uint8]:
        """The next ``count`` bytes."""
        return np.frombuffer(self._encryptor.update(bytes(count)), np.uint8)


def epoch_key(
    secret: Secret, device: str, epoch: int, *, camera: Camera, distribution: MaskDistribution
) -> bytes:
    """Key of one epoch of one device: HKDF-SHA256 (RFC 5869) without salt, 32 bytes.

    The context (HKDF's ``info``) is ``CONTEXT``, the device's name with its length in front, the
    epoch, the number of levels, the mask's shape and the distribution, so that no two uses share a
    key.

    Raises:
        OpticsError: an empty or long device name, an epoch that is not in 0 to 2^64 - 1, a
            distribution for another window or panel.
    """
    name = device.encode()
    require(
        1 <= len(name) <= MAX_DEVICE_BYTES,
        "device",
        device,
        "",
        f"a name of 1 to {MAX_DEVICE_BYTES} bytes",
    )
    require_count("epoch", epoch, least=0)
    require(epoch <= MAX_EPOCH, "epoch", epoch, "", "at most 2^64 - 1")
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
    info = b"".join(
        (
            CONTEXT,
            struct.pack(">B", len(name)),
            name,
            struct.pack(">QHHH", epoch, camera.panel.levels, *camera.mask_shape),
            distribution.lowest.tobytes(),
            distribution.highest.tobytes(),
            distribution.curve.tobytes(),
        )
    )
    return derived_key(secret.reveal(), info)


def derived_key(material: bytes, info: bytes) -> bytes:
    """HKDF-SHA256 (RFC 5869) without salt, 32 bytes; ``info`` keeps the uses of a key apart."""
    return HKDF(algorithm=SHA256(), length=32, salt=None, info=info).derive(material)


def epoch_levels(
    secret: Secret,
    device: str,
    epoch: int,
    *,
    camera: Camera,
    distribution: MaskDistribution | None = None,
) -> Levels:
    """The mask of one epoch, as levels for the panel.

    Args:
        secret: 256 bits that the device and its authorised decoders share.
        device: name of the device; two devices with one secret have unrelated masks.
        epoch: 0 to 2^64 - 1; never use one twice.
        camera: its window and the panel's number of levels.
        distribution: to draw from, uniform over all that the panel can show by default.

    Returns:
        uint8 array of shape ``camera.mask_shape``: a secret, to be logged nowhere.

    Raises:
        OpticsError: an argument is not valid; the message holds no secret.
    """
    if distribution is None:
        distribution = MaskDistribution.uniform(camera)
    key = epoch_key(secret, device, epoch, camera=camera, distribution=distribution)
    return distribution.draw(KeyStream(key))
