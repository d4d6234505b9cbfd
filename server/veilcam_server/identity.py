"""What a daemon is, for its status."""

from __future__ import annotations

from dataclasses import dataclass

from veilcam_client.calibration_models import SignedCalibration
from veilcam_client.models import BundleInfo, Device


@dataclass(frozen=True, slots=True)
class Identity:
    """What the daemon tells of itself; it does not change while it runs."""

    device: Device
    bundle: BundleInfo
    experiment: str | None = None
    calibration: SignedCalibration | None = None
