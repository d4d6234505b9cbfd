"""REST API of what a simulated camera looks at, for tests that hold scenes up by program."""

from __future__ import annotations

from typing import Any

from fastapi import APIRouter, Request

from veilcam_client.wire.simulation import PICTURE_MEDIA_TYPES, HeldScene
from veilcam_server.api.dependencies import ServiceDep, problems, unleased, uploads
from veilcam_server.api.scopes import requires

PATH = "/v1/simulation/scene"
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
    *("invalid_request", "body_too_large", "scene_api_off", "leased", "queue_full"),
    "calibrating",
)

router = APIRouter(
    prefix=PATH, dependencies=[requires("simulate"), unleased()], redirect_slashes=False
)


@router.put(
    "",
    dependencies=[uploads()],
    openapi_extra=_PICTURE,
    responses=problems("scene_invalid", "too_many_uploads", *_REFUSALS),
)
async def hold_scene(service: ServiceDep, request: Request) -> HeldScene:
    """Hold a picture up, the content of a PNG, JPEG or `.npy` file, until another one is.

    Every capture that is asked for after the answer sees it; one under way does not.
    """
    return await service.hold_scene(await request.body())


@router.delete("", responses=problems(*_REFUSALS))
async def take_scene_away(service: ServiceDep) -> HeldScene:
    """Take away what is held up: the camera sees again what it was started with."""
    return await service.hold_scene(None)
