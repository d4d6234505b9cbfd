"""REST API of bundles."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Path, Query, Request
from fastapi.responses import Response

from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE, InstalledBundle, InstalledBundles
from veilcam_server.api.conditional import KNOWN, IfNoneMatch, unless_known
from veilcam_server.api.dependencies import (
    CHANGE,
    DEVICE,
    KEYED,
    OnceDep,
    ServiceDep,
    problems,
    requires,
    unleased,
    uploads,
)

PREFIX = "/v1/bundles"

Digest = Annotated[str, Path(pattern=r"^[0-9a-f]{64}$", examples=["0f" * 32])]
AllowOlder = Annotated[
    bool,
    Query(
        description="Also if it is of an older version than the one in use. Where bundles need "
        "their owner's signature, none that is older is ever used."
    ),
]
_UPLOAD: dict[str, Any] = {
    "requestBody": {
        "required": True,
        "content": {BUNDLE_MEDIA_TYPE: {"schema": {"type": "string", "format": "binary"}}},
    }
}
_CHANGE = (*CHANGE, "too_many_requests", "not_enabled")
_USE = ("bundle_refused", "bundle_older")

router = APIRouter(
    prefix=PREFIX,
    dependencies=[requires("admin:bundles")],
    redirect_slashes=False,
    tags=["Bundles"],
)


@router.get(
    "",
    response_model=InstalledBundles,
    responses={**KNOWN, **problems("invalid_request", "not_enabled")},
)
async def bundles(service: ServiceDep, if_none_match: IfNoneMatch = "") -> Response:
    """Every bundle that can be used, and which one is."""
    return unless_known(await service.bundles.all(), if_none_match)


@router.post(
    "",
    status_code=201,
    dependencies=[uploads()],
    openapi_extra=_UPLOAD,
    responses=problems("body_too_large", "conflict", "too_many_requests", "not_enabled", *_USE),
)
async def install_bundle(service: ServiceDep, request: Request) -> InstalledBundle:
    """Take in a bundle, a `*.veilcam` file as it is. It is checked, and not used yet.

    Repeating it changes nothing: a bundle is named by its content.
    """
    return await service.bundles.install(request.stream())


@router.post(
    "/{digest}/activate",
    dependencies=[unleased()],
    responses=problems(
        *("body_too_large", "invalid_request", "not_found", "leased"),
        *(*_USE, *_CHANGE, *KEYED, *DEVICE),
    ),
)
async def activate_bundle(
    service: ServiceDep, once: OnceDep, digest: Digest, allow_older: AllowOlder = False
) -> InstalledBundle:
    """Use this bundle from now on: mask and classifier change as one, or not at all."""
    return await once(lambda: service.activate_bundle(digest, allow_older=allow_older))


@router.delete(
    "/{digest}",
    responses=problems("invalid_request", "not_found", "conflict", *_CHANGE),
)
async def remove_bundle(service: ServiceDep, digest: Digest) -> InstalledBundles:
    """Remove a bundle for good, but not the one in use."""
    return await service.bundles.remove(digest)
