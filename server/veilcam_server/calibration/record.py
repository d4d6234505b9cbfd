"""The signed record: written once measured, checked before it is used."""

from __future__ import annotations

from pathlib import Path

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

from veilcam_client.keys.envelopes import Signer
from veilcam_client.wire.calibration import CalibrationRecord, SignedCalibration
from veilcam_optics.camera.imperfections import Imperfections
from veilcam_server.system.state_file import Report, StateStore, log_fault

RECORD_NAME = "calibration.json"
"""Of the record in the state directory."""
AGAIN = "run 'veilcamd calibrate' again"
"""What helps where a record cannot be used."""


def is_signed(signed: SignedCalibration) -> bool:
    """Return whether the owner of a record's public key signed it."""
    try:
        key = Ed25519PublicKey.from_public_bytes(bytes.fromhex(signed.public_key))
        key.verify(bytes.fromhex(signed.signature), _message(signed.record))
    except (ValueError, InvalidSignature):
        return False
    return True


def calibration_store(path: Path, report: Report = log_fault) -> StateStore[SignedCalibration]:
    """Return the store of a signed record; it may lie under another name than its own.

    Args:
        path: path of the record.
        report: takes what was damaged.
    """
    lost = f"the camera is taken as it was drawn; {AGAIN}"
    return StateStore(path, SignedCalibration, lost=lost, report=report, name="calibration")


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


def _message(record: CalibrationRecord) -> bytes:
    return record.model_dump_json().encode()
