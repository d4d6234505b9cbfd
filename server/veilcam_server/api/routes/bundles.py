"""REST API of keyrings."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Request

from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE, Keyring, Keyrings
from veilcam_server.api.dependencies import DEVICE, OnceDep, ServiceDep, problems, unleased
from veilcam_server.api.scopes import requires

PREFIX = "/v1/keyrings"

Digest = Annotated[str, Path(pattern=r"^[0-9a-f]{64}$", examples=["0f" * 32])]
_UPLOAD: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {BUNDLE_MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}}},
    }
}
_CHANGE = ("keyrings_busy", "keyring_not_stored", "replaying")
_USE = ("keyring_invalid", "keyring_unfit")

router = APIRouter(prefix=PREFIX, dependencies=[requires("admin:keyring")], redirect_slashes=False)


@router.get("", responses=problems("replaying"))
async def keyrings(service: ServiceDep) -> Keyrings:
    """Every keyring that can be used, and which one is."""
    return await service.keyrings.all()


@router.post(
    "",
    status_code=201,
    openapi_extra=_UPLOAD,
    responses=problems("body_too_large", "keyrings_full", *_USE, *_CHANGE),
)
async def install(service: ServiceDep, request: Request) -> Keyring:
    """Take in a bundle, a `*.veilcam` file as it is. It is checked, and not used yet.

    Repeating it changes nothing: a keyring is named by its content.
    """
    return await service.keyrings.install(request.stream())


@router.post(
    "/{digest}/activate",
    dependencies=[unleased()],
    responses=problems(
        *("body_too_large", "invalid_request", "unknown_keyring", "leased"),
        *(*_USE, *_CHANGE, "idempotency_key_reused", *DEVICE),
    ),
)
async def activate(service: ServiceDep, once: OnceDep, digest: Digest) -> Keyring:
    """Use this keyring from now on: mask and classifier change as one, or not at all."""
    return await once(lambda: service.activate_keyring(digest))


@router.delete(
    "/{digest}",
    responses=problems("invalid_request", "unknown_keyring", "keyring_in_use", *_CHANGE),
)
async def remove(service: ServiceDep, digest: Digest) -> Keyrings:
    """Remove a keyring for good, but not the one in use."""
    return await service.keyrings.remove(digest)
