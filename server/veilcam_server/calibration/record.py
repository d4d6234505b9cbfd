"""The signed record: written once measured, checked before it is used."""

from __future__ import annotations

from pathlib import Path
from typing import Self

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from pydantic import ValidationError

from veilcam_client.wire.calibration import CalibrationRecord, SignedCalibration
from veilcam_optics.camera.imperfections import Imperfections
from veilcam_optics.files import create_private, write_whole
from veilcam_server.errors import CalibrationError

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
                secret = Ed25519PrivateKey.generate().private_bytes_raw()
                create_private(path, f"{secret.hex()}\n".encode())
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


RECORD_NAME = "calibration.json"
"""Of the record in the state directory."""
MAX_BYTES = 2**20


def imperfections_of(record: CalibrationRecord) -> Imperfections:
    """The camera as it was measured; how well each number is known stays in the record."""
    return Imperfections(
        shift_y=record.shift_y_m.value,
        shift_x=record.shift_x_m.value,
        rotation=record.rotation_rad.value,
        distance_error=record.distance_error_m.value,
        gamma=record.gamma.value,
        contrast_floor=record.contrast_floor.value,
        dead_rows=record.dead_rows,
        dead_columns=record.dead_columns,
        dead_transmittance=record.dead_transmittance.value,
        stray_light=record.stray_light.value,
    )


def sign_record(record: CalibrationRecord, key: SigningKey) -> SignedCalibration:
    """Return ``record`` with who vouches for it."""
    return SignedCalibration(
        record=record, public_key=key.public, signature=key.sign(_message(record))
    )


def write_record(path: Path, signed: SignedCalibration) -> None:
    """Replace ``path`` by a signed record, or leave what was there before.

    Raises:
        CalibrationError: it cannot be written.
    """
    try:
        write_whole(path, f"{signed.model_dump_json(indent=1)}\n".encode(), private=True)
    except OSError as error:
        raise CalibrationError(f"{path} cannot be written ({error.strerror}): check it") from None


def read_record(path: Path, key: SigningKey) -> SignedCalibration:
    """Read what :func:`write_record` wrote with ``key``.

    Raises:
        CalibrationError: it cannot be read, is none, was changed, or is signed by another.
    """
    again = "run 'veilcamd calibrate' again, or give another --calibration"
    try:
        with path.open("rb") as stream:
            text = stream.read(MAX_BYTES + 1)
        if len(text) > MAX_BYTES:
            raise CalibrationError(f"{path} is too large for a calibration: {again}")
        signed = SignedCalibration.model_validate_json(text)
    except OSError as error:
        raise CalibrationError(f"{path} cannot be read ({error.strerror}): check it") from None
    except ValidationError as error:
        details = error.errors(include_url=False, include_input=False, include_context=False)[0]
        place = ".".join(map(str, details["loc"])) or "file"
        raise CalibrationError(
            f"{path} is no calibration ({place}: {details['msg']}): {again}"
        ) from None
    if signed.public_key != key.public:
        raise CalibrationError(f"{path} was signed by another daemon: {again}")
    if not is_signed(_message(signed.record), signed.signature, signed.public_key):
        raise CalibrationError(f"{path} was changed after it was signed: {again}")
    return signed


def _message(record: CalibrationRecord) -> bytes:
    return record.model_dump_json().encode()
