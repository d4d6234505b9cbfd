"""The signed record: written once measured, checked before it is used."""

from __future__ import annotations

from pathlib import Path
from typing import Self

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from veilcam_client.wire.calibration import CalibrationRecord, SignedCalibration
from veilcam_optics.camera.imperfections import Imperfections
from veilcam_server.errors import CalibrationError, StartError
from veilcam_server.system.state_file import (
    Report,
    StateFile,
    log_fault,
    make_directory,
    refuse_earlier,
)

RECORD_NAME = "calibration.json"
"""Of the record in the state directory."""
KEY_NAME = "calibration-key.json"
"""Of the private key in the state directory."""
_AGAIN = "run 'veilcamd calibrate' again"


class _Seed(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid")
    seed: str = Field(pattern="^[0-9a-f]{64}$", repr=False)


class SigningKey:
    """A private key; its repr tells nothing of it."""

    def __init__(self, key: Ed25519PrivateKey) -> None:
        self._key = key

    @classmethod
    def open(cls, state_dir: Path, *, create: bool = False, report: Report = log_fault) -> Self:
        """Read the key in ``state_dir``, or make one.

        Args:
            state_dir: of the daemon.
            create: make one where there is none, and a new one where it is lost.
            report: takes what was damaged.

        Raises:
            CalibrationError: there is none, it cannot be made, or it is of another version.
        """
        lost = f"what it signed cannot be checked; {_AGAIN}"
        file = StateFile(state_dir / KEY_NAME, _Seed, lost=lost, report=report)
        try:
            refuse_earlier(
                state_dir / "calibration-key", f"remove it and {RECORD_NAME}, and {_AGAIN}"
            )
            found = file.read()
        except StartError as error:
            raise CalibrationError(str(error)) from None
        if found is None and not create:
            raise CalibrationError(
                f"there is no key {state_dir / KEY_NAME} to check a calibration with: {_AGAIN}"
            )
        try:
            if found is None:
                make_directory(state_dir)
                made = Ed25519PrivateKey.generate().private_bytes_raw().hex()
                found = file.change(lambda held: held or _Seed(seed=made))
        except OSError as error:
            raise CalibrationError(
                f"{state_dir / KEY_NAME} cannot be used ({error.strerror}): check it"
            ) from None
        return cls(Ed25519PrivateKey.from_private_bytes(bytes.fromhex(found.seed)))

    @property
    def public(self) -> str:
        """The public half, 64 hexadecimal digits."""
        return self._key.public_key().public_bytes_raw().hex()

    def sign(self, message: bytes) -> str:
        """Signature of ``message``, 128 hexadecimal digits."""
        return self._key.sign(message).hex()

    def require(self, signed: SignedCalibration, path: Path) -> None:
        """Raise :class:`CalibrationError` where another key signed the record at ``path``."""
        if signed.public_key != self.public:
            raise CalibrationError(
                f"{path} was signed by another daemon: {_AGAIN}, or give another --calibration"
            )

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


class RecordFile(StateFile[SignedCalibration]):
    """A signed record in two copies, each as others read it: its signature is its checksum.

    Args:
        path: of the record.
        report: takes what was damaged.
    """

    def __init__(self, path: Path, report: Report = log_fault) -> None:
        lost = f"the camera is taken as it was drawn; {_AGAIN}"
        super().__init__(path, SignedCalibration, lost=lost, report=report)

    def _encode(self, state: SignedCalibration, serial: int) -> bytes:  # noqa: ARG002 - its time
        return f"{state.model_dump_json(indent=1)}\n".encode()

    def _decode(self, content: bytes) -> tuple[int, SignedCalibration]:
        try:
            signed = SignedCalibration.model_validate_json(content)
        except ValidationError:
            raise ValueError("it is no record") from None
        if not is_signed(_message(signed.record), signed.signature, signed.public_key):
            raise ValueError("it was changed after it was signed")
        return int(1e6 * signed.record.taken_at.timestamp()), signed


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
    """Replace ``path`` and its copy by a signed record, or leave what was there before.

    Raises:
        CalibrationError: it cannot be written.
    """
    try:
        RecordFile(path).change(lambda _: signed)
    except OSError as error:
        raise CalibrationError(f"{path} cannot be written ({error.strerror}): check it") from None


def _message(record: CalibrationRecord) -> bytes:
    return record.model_dump_json().encode()
