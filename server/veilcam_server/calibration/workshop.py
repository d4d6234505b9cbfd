"""What a daemon needs to measure its camera with itself, and to keep what was found."""

from __future__ import annotations

import os

from veilcam_client.wire.calibration import CalibrationRecord, SignedCalibration
from veilcam_optics.transfer.operator import Reach
from veilcam_server.bundles.loader import Opener, open_source
from veilcam_server.calibration import (
    CalibrationError,
    CalibrationScene,
    Effort,
    Geometry,
    SigningKey,
    calibrate,
    sign_record,
    write_record,
)
from veilcam_server.calibration.loading import (
    check_record,
    decoder_calibration,
    panel_tab,
    record_path,
    settle_time,
)
from veilcam_server.calibration.progress import Run
from veilcam_server.devices.base import Device
from veilcam_server.settings import Settings
from veilcam_training.bundle import Bundle

LONGEST = 3.0
"""Settling may take so many times what the daemon would grant it without a calibration."""


class Workshop:
    """For one camera, set up as the settings say.

    Args:
        settings: checked.
        bundle: that the daemon was started with.
    """

    def __init__(self, settings: Settings, bundle: Bundle) -> None:
        self._settings, self._bundle = settings, bundle
        self._geometry = Geometry(bundle.camera, bundle.scene, bundle.embedding)

    def open_key(self) -> SigningKey:
        """The key to sign with, made if there is none.

        Raises:
            CalibrationError: it cannot be made, or no record can be written.
        """
        # A disk that cannot be written should not be found out minutes later.
        folder = record_path(self._settings).parent
        if not os.access(folder, os.W_OK):
            raise CalibrationError(f"no calibration can be written into {folder}: check it")
        return SigningKey.open(self._settings.state_dir, create=True)

    def exposures(self, repeats: int) -> int:
        """How many a calibration takes."""
        return Effort(repeats=repeats).captures(self._geometry)

    def measure(self, device: Device, run: Run, repeats: int) -> CalibrationRecord:
        """Measure a device; it takes minutes.

        Raises:
            CancelledError: somebody wants it to end.
            CalibrationError: the camera, its light or the fit is not good enough.
            DeviceError, FenceError: panel or sensor failed.
        """
        settings, fresh, scenes = self._settings, self._bundle.fresh, device.scenes

        def present(scene: CalibrationScene) -> None:
            if scenes is None:
                # Somebody stands before the camera now, maybe for minutes.
                device.display.blank()
                run.ask_for(scene)
            else:
                run.hold_up(scenes, scene)

        try:
            found = calibrate(
                device,
                self._geometry,
                present,
                longest=LONGEST * settings.settle,
                exposure=settings.exposure,
                tab=panel_tab(settings),
                reach=fresh.reach if fresh else Reach(),
                timeout=settings.capture_timeout,
                effort=Effort(repeats=repeats),
                advance=run.advance,
                check=run.check,
                fitting=run.fit,
            )
        finally:
            if scenes is not None:
                scenes.hold(None)
        return found.record

    def sign(self, record: CalibrationRecord, key: SigningKey) -> SignedCalibration:
        """Vouch for a record; raises :class:`CalibrationError` if it is of another camera."""
        check_record(record, self._settings, self._bundle)
        return sign_record(record, key)

    def keep(self, signed: SignedCalibration) -> None:
        """Let the next daemon begin with it; raises :class:`CalibrationError`."""
        write_record(record_path(self._settings), signed)

    def settle(self, signed: SignedCalibration | None) -> float:
        """What the panel is given to settle [s]."""
        return settle_time(self._settings, signed)

    def opener(self, signed: SignedCalibration | None) -> Opener:
        """What opens keyrings, their readers made for the camera as it was measured."""
        calibration = decoder_calibration(signed)
        return Opener(self._bundle, lambda keys: open_source(self._settings, keys, calibration))
