"""Key pairs of receivers: to whom a camera seals the keys of its epochs.

The pair is X-Wing's, ML-KEM-768 beside X25519: what is kept today stays closed as long as either of
them holds, also to a quantum computer that somebody builds later.
"""

from __future__ import annotations

import base64
import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn, Self

from cryptography.hazmat.primitives.asymmetric.mlkem import MLKEM768PrivateKey, MLKEM768PublicKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.hpke import (
    AEAD,
    KDF,
    KEM,
    MLKEM768X25519PrivateKey,
    MLKEM768X25519PublicKey,
    Suite,
)

from veilcam_client.errors import FileError

SUITE = Suite(KEM.MLKEM768_X25519, KDF.HKDF_SHA256, AEAD.CHACHA20_POLY1305)
"""Of hybrid public key encryption (RFC 9180), base mode."""
PUBLIC_BYTES = 1184 + 32
_SEED_BYTES = 64
PRIVATE_BYTES = _SEED_BYTES + 32
_MOST_READ = 4096
_PUBLIC_PREFIX = "veilcam-receiver:"
_PRIVATE_PREFIX = "veilcam-receiver-private-key:"


@dataclass(frozen=True, slots=True)
class Receiver:
    """Public key of a receiver; ``str`` gives the line that names it."""

    raw: bytes
    """ML-KEM-768's 1,184 bytes (FIPS 203), then X25519's 32 (RFC 7748)."""

    def __post_init__(self) -> None:
        if len(self.raw) != PUBLIC_BYTES:
            raise ValueError(f"a receiver's key has {len(self.raw)} bytes: use {PUBLIC_BYTES}")
        self._public()
        # A point of low order agrees with nobody: nothing could be sealed to it.
        X25519PrivateKey.generate().exchange(X25519PublicKey.from_public_bytes(self.raw[-32:]))

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read ``veilcam-receiver:BASE64``; raises ValueError."""
        try:
            if text.startswith(_PUBLIC_PREFIX):
                return cls(base64.b64decode(text.removeprefix(_PUBLIC_PREFIX), validate=True))
        except ValueError:
            pass
        raise ValueError(
            f"this is no receiver's key: use {_PUBLIC_PREFIX} and {PUBLIC_BYTES} bytes as base64, "
            "as 'veilcam receiver keygen' prints it"
        )

    @property
    def id(self) -> str:
        """SHA-256 of the key, 64 hexadecimal digits: its name in envelopes."""
        return hashlib.sha256(self.raw).hexdigest()

    def seal(self, secret: bytes | bytearray, info: bytes) -> bytes:
        """Seal a secret to whoever has the private half: 1,136 bytes more than it has."""
        return SUITE.encrypt(secret, self._public(), info)

    def _public(self) -> MLKEM768X25519PublicKey:
        kem, dh = self.raw[:-32], self.raw[-32:]
        return MLKEM768X25519PublicKey(
            MLKEM768PublicKey.from_public_bytes(kem), X25519PublicKey.from_public_bytes(dh)
        )

    def __str__(self) -> str:
        return f"{_PUBLIC_PREFIX}{base64.b64encode(self.raw).decode()}"


class ReceiverKey:
    """Private half of a receiver's pair. It opens all that was ever sealed to the public half."""

    __slots__ = ("_key", "_raw", "public")

    def __init__(self, raw: bytes) -> None:
        if len(raw) != PRIVATE_BYTES:
            raise ValueError(f"a receiver's private key is not valid: use {PRIVATE_BYTES} bytes")
        kem = MLKEM768PrivateKey.from_seed_bytes(raw[:_SEED_BYTES])
        dh = X25519PrivateKey.from_private_bytes(raw[_SEED_BYTES:])
        self._raw, self._key = raw, MLKEM768X25519PrivateKey(kem, dh)
        self.public: Receiver = Receiver(
            kem.public_key().public_bytes_raw() + dh.public_key().public_bytes_raw()
        )
        """The public half."""

    @classmethod
    def generate(cls) -> Self:
        """Make a key pair."""
        return cls(os.urandom(PRIVATE_BYTES))

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Self:
        """Read what :meth:`write` wrote.

        Raises:
            FileError: it cannot be read, others may read it, or it is no such key. No message
                repeats it.
        """
        path = Path(path)
        try:
            with path.open("rb") as stream:
                mode = os.fstat(stream.fileno()).st_mode
                text = stream.read(_MOST_READ).decode("ascii", "replace").strip()
        except OSError as error:
            raise FileError(f"{path} cannot be read ({error.strerror}): check the path") from None
        if mode & 0o077:
            raise FileError(f"{path} is open to others: run chmod 600 {path}")
        try:
            if text.startswith(_PRIVATE_PREFIX):
                return cls(base64.b64decode(text.removeprefix(_PRIVATE_PREFIX), validate=True))
        except ValueError:
            pass
        raise FileError(
            f"{path} holds no receiver's private key: make one with 'veilcam receiver keygen'"
        )

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write a new file that its owner alone may read; raises :class:`FileError`."""
        path = Path(path)
        line = f"{_PRIVATE_PREFIX}{base64.b64encode(self._raw).decode()}\n".encode()
        try:
            descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
            try:
                with os.fdopen(descriptor, "wb") as stream:
                    stream.write(line)
                    stream.flush()
                    os.fsync(stream.fileno())
            except OSError:
                path.unlink()  # half a key is none, and it would keep a whole one off
                raise
        except FileExistsError:
            raise FileError(
                f"{path} exists and was left alone: whoever replaces a receiver's key cannot open "
                "what was sealed to it; give another name"
            ) from None
        except OSError as error:
            raise FileError(f"{path} cannot be written ({error.strerror}): check it") from None

    def open(self, sealed: bytes, info: bytes) -> bytes:
        """Open what was sealed to the public half; raises ``InvalidTag``."""
        return SUITE.decrypt(sealed, self._key, info)

    def __repr__(self) -> str:
        return f"ReceiverKey(public={self.public.id[:16]})"

    def __reduce__(self) -> NoReturn:
        raise TypeError("a private key is not pickled: write it to a file, deliberately")
