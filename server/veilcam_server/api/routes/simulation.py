"""REST API of what a simulated camera looks at, and of what is wrong with it: for tests."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request

from veilcam_client.wire.simulation import PICTURE_MEDIA_TYPES, Faults, HeldScene
from veilcam_server.api.dependencies import BODY, ServiceDep, problems, requires, unleased, uploads

PREFIX = "/v1/simulation"
PATH = f"{PREFIX}/scene"
MAX_PICTURE = 8 * 2**20
"""[bytes]"""
_PICTURE: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {
            media_type: {"schema": {"type": "string", "format": "binary"}}
            for media_type in PICTURE_MEDIA_TYPES
        },
    }
}
_REFUSALS = (
    *("invalid_request", "body_too_large", "not_enabled", "leased", "queue_full", "not_ready"),
)

router = APIRouter(
    prefix=PREFIX,
    dependencies=[requires("simulate"), unleased()],
    redirect_slashes=False,
    tags=["Simulation"],
)


@router.put(
    "/scene",
    dependencies=[uploads()],
    openapi_extra=_PICTURE,
    responses=problems(*_REFUSALS),
)
async def hold_scene(service: ServiceDep, request: Request) -> HeldScene:
    """Hold a picture up, until another one is.

    It is the content of a PNG, JPEG, WebP, BMP, TIFF, GIF or `.npy` file. Every capture that is
    asked for after the answer sees it; one under way does not.
    """
    return await service.hold_scene(await request.body())


@router.delete("/scene", responses=problems(*_REFUSALS))
async def take_scene_away(service: ServiceDep) -> HeldScene:
    """Take away what is held up: the camera sees again what it was started with."""
    return await service.hold_scene(None)


@router.put("/faults", responses=problems(*BODY, "not_enabled", "leased"))
async def set_faults(service: ServiceDep, question: Faults) -> Faults:
    """Break the panel or the sensor, at once; what is not named is mended."""
    service.simulation.break_device(question)
    return question
