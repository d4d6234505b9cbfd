"""What a daemon makes of its calibration: which record it is, and what it changes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from veilcam_client.wire.calibration import CalibrationRecord, SignedCalibration
from veilcam_optics.decoding import AS_DRAWN, Calibration
from veilcam_server.calibration import (
    CalibrationError,
    Geometry,
    SigningKey,
    correction,
    read_record,
)
from veilcam_server.calibration.record import RECORD_NAME, check_fits
from veilcam_server.devices.base import Device
from veilcam_server.devices.corrected import CalibratedSensor
from veilcam_server.errors import StartError
from veilcam_server.settings import Settings
from veilcam_training.bundle import Bundle


def open_calibration(settings: Settings, bundle: Bundle) -> SignedCalibration | None:
    """Return the record that the settings name, or the one in the state directory, or none.

    Raises:
        StartError: it cannot be read or trusted, or is of another camera.
    """
    path = record_path(settings)
    if settings.calibration is None and not path.exists():
        return None
    try:
        signed = read_record(path, SigningKey.open(settings.state_dir))
        check_record(signed.record, settings, bundle)
    except CalibrationError as error:
        raise StartError(str(error)) from None
    return signed


def record_path(settings: Settings) -> Path:
    """Where the record is that a daemon takes."""
    return settings.calibration or settings.state_dir / RECORD_NAME


def check_record(record: CalibrationRecord, settings: Settings, bundle: Bundle) -> None:
    """Raise :class:`CalibrationError` if ``record`` is of another camera than is set up."""
    check_fits(
        record,
        display=settings.panel,
        sensor=settings.sensor,
        simulated=settings.device == "simulated",
        tab=panel_tab(settings),
        exposure=settings.exposure,
        geometry=Geometry(bundle.camera, bundle.scene, bundle.embedding).digest,
    )


def panel_tab(settings: Settings) -> str | None:
    """Of the panel that the settings name; the simulated one has no film."""
    return None if settings.device == "simulated" else settings.panel_tab


def decoder_calibration(signed: SignedCalibration | None) -> Calibration:
    """What decoders are prepared for."""
    return AS_DRAWN if signed is None else correction(signed.record)


def calibrated(device: Device, signed: SignedCalibration | None) -> Device:
    """The device with readings as decoders expect them."""
    if signed is None:
        return device
    return replace(device, sensor=CalibratedSensor.of(device.sensor, signed.record))


def settle_time(settings: Settings, signed: SignedCalibration | None) -> float:
    """What the fence grants the panel [s]: what was measured, or more where more was asked for."""
    if signed is None:
        return settings.settle
    settling = signed.record.settling_s
    measured = settling.value + settling.uncertainty
    # The default is a guess from before anything was measured.
    return max(measured, settings.settle) if "settle" in settings.model_fields_set else measured
