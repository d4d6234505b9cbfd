"""The signed record: written once measured, checked before it is used."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from pydantic import ValidationError

from veilcam_client.wire.calibration import CalibrationRecord, SignedCalibration
from veilcam_optics.decoding import Calibration
from veilcam_server.calibration.errors import CalibrationError
from veilcam_server.calibration.signing import SigningKey, is_signed

RECORD_NAME = "calibration.json"
"""Of the record in the state directory."""
MAX_BYTES = 2**20


def correction(record: CalibrationRecord) -> Calibration:
    """What a decoder takes in of a record."""
    return Calibration(
        shift_y=record.shift_y_m.value,
        shift_x=record.shift_x_m.value,
        rotation=record.rotation_rad.value,
        distance_error=record.distance_error_m.value,
        gamma=record.gamma.value,
        contrast_floor=record.contrast_floor.value,
        dead_rows=record.dead_rows,
        dead_columns=record.dead_columns,
        dead_transmittance=record.dead_transmittance.value,
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
        descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
        try:
            with os.fdopen(descriptor, "w") as stream:
                stream.write(signed.model_dump_json(indent=1) + "\n")
                stream.flush()
                os.fsync(stream.fileno())
            os.replace(name, path)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
        directory = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)
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


def check_fits(
    record: CalibrationRecord,
    *,
    display: str,
    sensor: str,
    simulated: bool,
    tab: str | None,
    exposure: float,
    geometry: str,
) -> None:
    """Refuse a record of another camera.

    Raises:
        CalibrationError: which of its properties differs, and what to do.
    """
    for what, measured, present in (
        ("panel", record.display, display),
        ("sensor", record.sensor, sensor),
        ("kind of device", _kind(record.simulated), _kind(simulated)),
        ("panel's tab", record.tab, tab),
        ("exposure [s]", record.exposure_s, exposure),
        ("geometry", record.geometry[:12], geometry[:12]),
    ):
        if measured != present:
            raise CalibrationError(
                f"the calibration is of another {what}, {measured}, not {present}: run "
                "'veilcamd calibrate' for this camera, or give another --calibration"
            )


def _kind(simulated: bool) -> str:
    return "simulated" if simulated else "real"


def _message(record: CalibrationRecord) -> bytes:
    return record.model_dump_json().encode()
