"""REST API of the calibration."""

from __future__ import annotations

from fastapi import APIRouter

from veilcam_client.wire.calibration import (
    CalibrationRequest,
    CalibrationRun,
    CalibrationStatus,
    SceneConfirmation,
)
from veilcam_server.api.dependencies import (
    BODY,
    CHANGE,
    OnceDep,
    ServiceDep,
    problems,
    requires,
    unleased,
)

router = APIRouter(prefix="/v1/calibration", redirect_slashes=False, tags=["Calibration"])

_CALIBRATES = (requires("calibrate"), unleased())


@router.get("", dependencies=[requires("read:status")], responses=problems())
async def calibration(service: ServiceDep) -> CalibrationStatus:
    """Calibration in use, who vouches for it, and how a running one goes on.

    There is no mask in it.
    """
    return service.calibration.status


@router.post(
    "",
    status_code=202,
    dependencies=_CALIBRATES,
    responses=problems(*BODY, *CHANGE, "leased", "not_ready", "calibration_impossible"),
)
async def start_calibration(
    service: ServiceDep, once: OnceDep, question: CalibrationRequest | None = None
) -> CalibrationRun:
    """Measure the camera with itself; it takes no captures meanwhile.

    What is found is used from then on, and after a restart. Nothing changes if it fails.
    """
    repeats = (question or CalibrationRequest()).repeats
    return await once(lambda: service.calibration.start(repeats))


@router.post(
    "/scene",
    dependencies=_CALIBRATES,
    responses=problems(*BODY, *CHANGE, "leased", "conflict"),
)
async def confirm_scene(
    service: ServiceDep, once: OnceDep, question: SceneConfirmation
) -> CalibrationRun:
    """Confirm that the scene that the calibration waits for is set."""

    async def work() -> CalibrationRun:
        return service.calibration.confirm(question.scene)

    return await once(work)


@router.delete(
    "",
    dependencies=_CALIBRATES,
    responses=problems(*CHANGE, "invalid_request", "leased", "conflict"),
)
async def cancel_calibration(service: ServiceDep) -> CalibrationRun:
    """End the calibration that is under way; answered once the camera is back."""
    return await service.calibration.cancel()
