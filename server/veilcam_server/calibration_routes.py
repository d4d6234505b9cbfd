"""REST API of the calibration."""

from __future__ import annotations

from fastapi import APIRouter

from veilcam_client.calibration_models import SignedCalibration
from veilcam_server.access import requires
from veilcam_server.dependencies import ServiceDep, problems

router = APIRouter(
    prefix="/v1/calibration", dependencies=[requires("read:status")], redirect_slashes=False
)


@router.get("", responses=problems("not_calibrated"))
async def calibration(service: ServiceDep) -> SignedCalibration:
    """What the camera found out about itself, and who vouches for it. There is no mask in it."""
    return service.calibration()
