"""Records of calibrations: files, signatures, and the camera that follows from one."""

from __future__ import annotations

from pathlib import Path

from veilcam_client.keys.envelopes import Signer, is_signed
from veilcam_client.wire.calibration import CalibrationRecord, SignedCalibration
from veilcam_optics.camera.imperfections import NOMINAL, Imperfections
from veilcam_server.bundles.loader import OpenSource, open_source
from veilcam_server.calibration.rig import Geometry
from veilcam_server.errors import CalibrationError, StartError
from veilcam_server.settings import Settings
from veilcam_server.system.state_file import Report, StateStore, log_fault
from veilcam_training.bundle import Bundle

RECORD_NAME = "calibration.json"
"""Name of the record in the state directory."""
AGAIN = "run 'veilcamd calibrate' again"
"""Remedy for a record that cannot be used."""


def calibration_store(path: Path, report: Report = log_fault) -> StateStore[SignedCalibration]:
    """Return the store of a signed record; it may lie under another name than its own.

    Args:
        path: path of the record.
        report: function that takes damage of the file.
    """
    lost = f"the camera is taken as it was drawn; {AGAIN}"
    return StateStore(path, SignedCalibration, lost=lost, report=report, name="calibration")


def imperfections_of(record: CalibrationRecord) -> Imperfections:
    """Return the measured imperfections, without their uncertainties."""
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
    """Return ``record`` with the device's key and signature."""
    return SignedCalibration(
        record=record, public_key=key.public, signature=key.sign(_message(record))
    )


def _message(record: CalibrationRecord) -> bytes:
    return record.model_dump_json().encode()


def open_calibration(
    settings: Settings, bundle: Bundle, key: Signer, report: Report = log_fault
) -> SignedCalibration | None:
    """Return the record that the settings name, or else the one in the state directory, if any.

    A record of the state directory that is lost, or has another signer, is reported. The camera
    counts as nominal then.

    Args:
        settings: checked.
        bundle: bundle whose camera was calibrated.
        key: key of the device that has to be the signer.
        report: function that takes damage of the file.

    Raises:
        StartError: the record is of another camera, or the one that the settings name is lost or
            has another signer.
    """
    path, named = record_path(settings), settings.calibration is not None
    signed = calibration_store(path, report).read()
    if signed is None:
        if named:
            raise StartError(
                f"{path} holds no calibration that is whole: run 'veilcamd calibrate' again, or "
                "give another --calibration"
            )
        return None
    genuine = is_signed(key.public, signed.signature, _message(signed.record))
    if signed.public_key != key.public or not genuine:
        why = f"{path} was signed by another device: {AGAIN}, or give another --calibration"
        if named:
            raise StartError(why)
        report(CalibrationError(why))
        return None
    try:
        check_record(signed.record, settings, bundle)
    except CalibrationError as error:
        raise StartError(str(error)) from None
    return signed


def record_path(settings: Settings) -> Path:
    """Return the path of a daemon's record."""
    return settings.calibration or settings.state_dir / RECORD_NAME


def check_record(record: CalibrationRecord, settings: Settings, bundle: Bundle) -> None:
    """Refuse a record of another camera.

    Raises:
        CalibrationError: a property differs, which the text names with a remedy.
    """
    geometry = geometry_of(bundle).digest
    kind = "simulated" if record.simulated else "real"
    for what, measured, present in (
        ("panel", record.display, settings.panel),
        ("sensor", record.sensor, settings.sensor),
        ("kind of device", kind, "simulated" if settings.device == "simulated" else "real"),
        ("panel's tab", record.tab, panel_tab(settings)),
        ("exposure [s]", record.exposure_s, settings.exposure),
        ("geometry", record.geometry[:12], geometry[:12]),
    ):
        if measured != present:
            raise CalibrationError(
                f"the calibration is of another {what}, {measured}, not {present}: run "
                "'veilcamd calibrate' for this camera, or give another --calibration"
            )


def geometry_of(bundle: Bundle) -> Geometry:
    """Return the geometry of a bundle's camera; raises :class:`CalibrationError` in colour."""
    if bundle.channels != 1:
        raise CalibrationError(
            "a camera in colour has no calibration: serve a gray bundle, or remove the record"
        )
    return Geometry(bundle.camera, bundle.scene, bundle.embedding)


def panel_tab(settings: Settings) -> str | None:
    """Return the tab of the panel; None for a simulated one."""
    return None if settings.device == "simulated" else settings.panel_tab


def source_opener(settings: Settings, signed: SignedCalibration | None) -> OpenSource:
    """Return an opener of a bundle's masks, with readers for the measured camera."""
    imperfections = NOMINAL if signed is None else imperfections_of(signed.record)
    return lambda bundle: open_source(settings, bundle, imperfections)


def settle_time(settings: Settings, signed: SignedCalibration | None) -> float:
    """Return the settling time of the panel, measured or given, whichever is longer [s]."""
    if signed is None:
        return settings.settle
    settling = signed.record.settling_s
    measured = settling.value + settling.uncertainty
    # A default is a guess, and gives way to a measurement.
    return max(measured, settings.settle) if "settle" in settings.model_fields_set else measured
