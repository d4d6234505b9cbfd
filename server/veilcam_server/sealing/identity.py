"""Identity of the device: one Ed25519 key, which signs envelopes and calibrations."""

from __future__ import annotations

from pathlib import Path
from typing import NoReturn, Self

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from pydantic import BaseModel, ConfigDict, Field

from veilcam_server.system.state_file import Report, StateStore, log_fault, make_directory
from veilcam_server.system.state_folder import unusable

KEY_NAME = "device-key.json"
"""Of the private key in the state directory."""


class _Seed(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid")
    seed: str = Field(pattern="^[0-9a-f]{64}$", repr=False)


class DeviceKey:
    """A private key, a :class:`~veilcam_client.keys.envelopes.Signer`; its repr tells nothing."""

    def __init__(self, key: Ed25519PrivateKey) -> None:
        self._key = key

    @classmethod
    def open(cls, state_dir: Path, report: Report = log_fault) -> Self:
        """Read the key in ``state_dir``, or make one where there is none, or it is lost.

        Args:
            state_dir: state directory of the daemon; made if need be.
            report: takes what was damaged.

        Raises:
            StartError: it cannot be made or read.
        """
        file = StateStore(
            state_dir / KEY_NAME,
            _Seed,
            lost="this device has another key from now on: tell its receivers, and run "
            "'veilcamd calibrate' again if it was calibrated",
            report=report,
        )
        found = file.read()
        if found is None:
            try:
                make_directory(state_dir)
            except OSError as error:
                raise unusable(state_dir, error) from None
            made = _Seed(seed=Ed25519PrivateKey.generate().private_bytes_raw().hex())
            found = file.change(lambda held: held or made)
        return cls(Ed25519PrivateKey.from_private_bytes(bytes.fromhex(found.seed)))

    @property
    def public(self) -> str:
        """The public half, 64 hexadecimal digits."""
        return self._key.public_key().public_bytes_raw().hex()

    def sign(self, message: bytes) -> str:
        """Signature of ``message`` (RFC 8032), 128 hexadecimal digits."""
        return self._key.sign(message).hex()

    def __repr__(self) -> str:
        return f"DeviceKey(public={self.public})"

    def __reduce__(self) -> NoReturn:
        raise TypeError("a device's key is not pickled: it stays in its state directory")
