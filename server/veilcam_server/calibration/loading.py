"""The record that the settings name, and what a daemon takes from it."""

from __future__ import annotations

from pathlib import Path

from veilcam_client.keys.envelopes import Signer
from veilcam_client.wire.calibration import CalibrationRecord, SignedCalibration
from veilcam_optics.camera.imperfections import NOMINAL
from veilcam_server.bundles.loader import OpenSource, open_source
from veilcam_server.calibration.record import (
    AGAIN,
    RECORD_NAME,
    calibration_store,
    imperfections_of,
    is_signed,
)
from veilcam_server.calibration.rig import Geometry
from veilcam_server.errors import CalibrationError, StartError
from veilcam_server.settings import Settings
from veilcam_server.system.state_file import Report, log_fault
from veilcam_training.bundle import Bundle


def open_calibration(
    settings: Settings, bundle: Bundle, key: Signer, report: Report = log_fault
) -> SignedCalibration | None:
    """Return the record that the settings name, or the one in the state directory, or none.

    One in the state directory that is lost, or cannot be trusted any more, is reported, and the
    camera is taken as it was drawn.

    Args:
        settings: checked.
        bundle: bundle whose camera was calibrated.
        key: key of the device, which has to have signed the record.
        report: takes what was damaged.

    Raises:
        StartError: it is of another camera; or the one that the settings name cannot be trusted.
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
    if signed.public_key != key.public or not is_signed(signed):
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
    """Return the path of the record that a daemon takes."""
    return settings.calibration or settings.state_dir / RECORD_NAME


def check_record(record: CalibrationRecord, settings: Settings, bundle: Bundle) -> None:
    """Refuse a record of another camera.

    Raises:
        CalibrationError: which of its properties differs, and what to do.
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
    """Return the tab of the panel that the settings name; the simulated one has none."""
    return None if settings.device == "simulated" else settings.panel_tab


def source_opener(settings: Settings, signed: SignedCalibration | None) -> OpenSource:
    """Open the source of a bundle's masks, its readers prepared for the camera as measured."""
    imperfections = NOMINAL if signed is None else imperfections_of(signed.record)
    return lambda bundle: open_source(settings, bundle, imperfections)


def settle_time(settings: Settings, signed: SignedCalibration | None) -> float:
    """Return the settling time that the fence grants the panel [s], the longer of two."""
    if signed is None:
        return settings.settle
    settling = signed.record.settling_s
    measured = settling.value + settling.uncertainty
    # The default is a guess from before anything was measured.
    return max(measured, settings.settle) if "settle" in settings.model_fields_set else measured
