"""Who vouches for a record: an Ed25519 key that stays in the state directory.

A key pair and not one shared key (HMAC): whoever decodes elsewhere needs the record too, and can
check it with the public half, which lets nobody make another.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Self

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

from veilcam_server.calibration.errors import CalibrationError

KEY_NAME = "calibration-key"
"""Of the private key in the state directory."""


class SigningKey:
    """A private key; its repr tells nothing of it."""

    def __init__(self, key: Ed25519PrivateKey) -> None:
        self._key = key

    @classmethod
    def open(cls, state_dir: Path, *, create: bool = False) -> Self:
        """Read the key in ``state_dir``, or make one.

        Raises:
            CalibrationError: there is none, or it cannot be read or made.
        """
        path = state_dir / KEY_NAME
        try:
            if create and not path.exists():
                state_dir.mkdir(parents=True, exist_ok=True, mode=0o700)
                descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
                with os.fdopen(descriptor, "w") as stream:
                    stream.write(Ed25519PrivateKey.generate().private_bytes_raw().hex() + "\n")
                    stream.flush()
                    os.fsync(stream.fileno())
            return cls(Ed25519PrivateKey.from_private_bytes(bytes.fromhex(path.read_text("ascii"))))
        except FileNotFoundError:
            raise CalibrationError(
                f"there is no key {path} to check a calibration with: run 'veilcamd calibrate'"
            ) from None
        except OSError as error:
            raise CalibrationError(f"{path} cannot be used ({error.strerror}): check it") from None
        except ValueError:
            raise CalibrationError(
                f"{path} is no key: move it away and run 'veilcamd calibrate'"
            ) from None

    @property
    def public(self) -> str:
        """The public half, 64 hexadecimal digits."""
        return self._key.public_key().public_bytes_raw().hex()

    def sign(self, message: bytes) -> str:
        """Signature of ``message``, 128 hexadecimal digits."""
        return self._key.sign(message).hex()

    def __repr__(self) -> str:
        return f"SigningKey(public={self.public})"


def is_signed(message: bytes, signature: str, public: str) -> bool:
    """Whether whoever holds the private half of ``public`` signed ``message``."""
    try:
        key = Ed25519PublicKey.from_public_bytes(bytes.fromhex(public))
        key.verify(bytes.fromhex(signature), message)
    except (ValueError, InvalidSignature):
        return False
    return True
