"""The signed record: written once measured, checked before it is used."""

from __future__ import annotations

from pathlib import Path

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from pydantic import ValidationError

from veilcam_client.keys.envelopes import Signer
from veilcam_client.wire.calibration import CalibrationRecord, SignedCalibration
from veilcam_optics.camera.imperfections import Imperfections
from veilcam_server.errors import CalibrationError
from veilcam_server.system.state_file import Report, StateFile, log_fault

RECORD_NAME = "calibration.json"
"""Of the record in the state directory."""
AGAIN = "run 'veilcamd calibrate' again"
"""What helps where a record cannot be used."""


def is_signed(message: bytes, signature: str, public: str) -> bool:
    """Return whether whoever holds the private half of ``public`` signed ``message``."""
    try:
        key = Ed25519PublicKey.from_public_bytes(bytes.fromhex(public))
        key.verify(bytes.fromhex(signature), message)
    except (ValueError, InvalidSignature):
        return False
    return True


class RecordFile(StateFile[SignedCalibration]):
    """A signed record in two copies, each as others read it: its signature is its checksum.

    Args:
        path: path of the record.
        report: takes what was damaged.
    """

    def __init__(self, path: Path, report: Report = log_fault) -> None:
        lost = f"the camera is taken as it was drawn; {AGAIN}"
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
    """Return the camera as measured; the uncertainty of each number stays in the record."""
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


def sign_record(record: CalibrationRecord, key: Signer) -> SignedCalibration:
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
