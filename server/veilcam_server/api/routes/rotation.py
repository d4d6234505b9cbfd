"""REST API of the rotation of masks."""

from __future__ import annotations

from fastapi import APIRouter

from veilcam_client.wire.rotation import Rotation, RotationPolicy
from veilcam_server.api.dependencies import (
    BODY,
    CHANGE,
    DEVICE,
    OnceDep,
    ServiceDep,
    problems,
    requires,
    unleased,
)

router = APIRouter(prefix="/v1/rotation", redirect_slashes=False, tags=["Masks"])


@router.get("", dependencies=[requires("read:status")], responses=problems())
async def rotation(service: ServiceDep) -> Rotation:
    """Policy of mask changes, and the present epoch."""
    return service.rotation()


@router.put(
    "",
    dependencies=[requires("mask:rotate"), unleased()],
    responses=problems(*BODY, *CHANGE, "leased", "conflict", "not_enabled"),
)
async def set_rotation(service: ServiceDep, policy: RotationPolicy) -> Rotation:
    """Change when masks change, also after a restart: off, every N seconds, or N captures."""
    return await service.set_policy(policy)


@router.post(
    "/advance",
    dependencies=[requires("mask:rotate"), unleased()],
    responses=problems(*BODY, "leased", *DEVICE, "not_enabled"),
)
async def rotate(
    service: ServiceDep,
    once: OnceDep,
) -> Rotation:
    """Show another mask now."""
    return await once(service.rotate)
