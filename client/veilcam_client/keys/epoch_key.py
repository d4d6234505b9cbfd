"""Key of one epoch, and the keys that are derived from it."""

from __future__ import annotations

import hmac
from pathlib import Path
from typing import ClassVar, NoReturn, Self

from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.kdf.hkdf import HKDFExpand

KEY_BYTES = 32
_RANDOM = Path("/dev/urandom")


class EpochKey:
    """256 bits, drawn for one epoch; they show in no ``repr``, ``str``, pickle or error.

    What the epoch needs is derived with HKDF-Expand (RFC 5869, SHA-256): the key is uniform, so it
    is its own pseudorandom key. ``info`` is a label for each use, a zero byte, the device's public
    key and the bundle's digest, 32 bytes each: no two uses, devices or bundles share a key.

    Args:
        value: 32 bytes; they are copied.
        device: public Ed25519 key of the device, 64 hexadecimal digits.
        bundle: SHA-256 of the bundle in use, 64 hexadecimal digits.
    """

    __slots__ = ("_context", "_value")

    def __init__(self, value: bytes | bytearray, *, device: str, bundle: str) -> None:
        if len(value) != KEY_BYTES:
            raise ValueError(f"an epoch's key is not valid: use {KEY_BYTES} bytes")
        context = bytes.fromhex(device), bytes.fromhex(bundle)
        if any(len(each) != KEY_BYTES for each in context):
            raise ValueError("device and bundle are not valid: use 64 hexadecimal digits each")
        self._value, self._context = bytearray(value), b"".join(context)

    @classmethod
    def generate(cls, *, device: str, bundle: str) -> Self:
        """Draw a key from the kernel."""
        # Into memory that can be overwritten: os.urandom gives bytes, which cannot.
        drawn = bytearray(KEY_BYTES)
        try:
            with _RANDOM.open("rb", buffering=0) as kernel:
                if kernel.readinto(drawn) != KEY_BYTES:
                    raise OSError("the kernel gave too few random bytes")
            return cls(drawn, device=device, bundle=bundle)
        finally:
            drawn[:] = bytes(KEY_BYTES)

    def levels(self) -> bytearray:
        """Key of the stream that the mask is drawn from, 32 bytes."""
        return self._derived(b"veilcam mask levels 1")

    def sealing(self) -> bytearray:
        """Key that embeddings are sealed under, 32 bytes."""
        return self._derived(b"veilcam embedding sealing 1")

    def commitment(self) -> bytearray:
        """Key that the log commits to the mask under, 32 bytes."""
        return self._derived(b"veilcam mask commitment 1")

    def reveal(self) -> bytearray:
        """Return the key itself, to be sealed to receivers; :meth:`erase` reaches it."""
        self._require()
        return self._value

    def erase(self) -> None:
        """Overwrite the key; nothing can be derived from it any more. Twice does no harm."""
        self._value[:] = bytes(KEY_BYTES)
        self._context = b""

    def _derived(self, label: bytes) -> bytearray:
        self._require()
        derived = bytearray(KEY_BYTES)
        info = label + b"\0" + self._context
        HKDFExpand(SHA256(), KEY_BYTES, info).derive_into(self._value, derived)
        return derived

    def _require(self) -> None:
        if not self._context:
            raise ValueError("the key of this epoch was erased")

    def __repr__(self) -> str:
        return "EpochKey(...)"

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, EpochKey):
            return NotImplemented
        return self._context == other._context and hmac.compare_digest(self._value, other._value)

    # A hash would leak bits and invite dictionaries.
    __hash__: ClassVar[None] = None  # type: ignore[assignment]

    def __reduce__(self) -> NoReturn:
        raise TypeError("an epoch's key is not pickled: it is sealed to receivers or gone")
