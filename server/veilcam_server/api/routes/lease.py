"""REST API of the lease."""

from __future__ import annotations

import secrets
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request

from veilcam_client.wire.lease import Lease as LeaseResponse
from veilcam_client.wire.lease import LeaseRequest, NewLease
from veilcam_server.api.dependencies import (
    BODY,
    AdmissionDep,
    CallerDep,
    HolderDep,
    OnceDep,
    problems,
    requires,
)
from veilcam_server.security.admission import Admission

router = APIRouter(prefix="/v1/lease", redirect_slashes=False, tags=["Lease"])


@router.get("", dependencies=[requires("read:status")], responses=problems("invalid_request"))
async def lease_state(admission: AdmissionDep, holder: HolderDep) -> LeaseResponse:
    """Holder of the camera, if there is one."""
    return LeaseResponse(**_response(admission, holder))


@router.post("", dependencies=[requires("mask:rotate")], responses=problems(*BODY, "leased"))
async def take_lease(
    admission: AdmissionDep, holder: HolderDep, once: OnceDep, question: LeaseRequest
) -> NewLease:
    """Hold the camera, or go on holding it: others take no captures and change no mask."""

    async def work() -> NewLease:
        name = holder
        if admission.tokens is None and not admission.lease.held_by(holder):
            admission.lease.require(holder)
            name = secrets.token_hex(16)
        admission.lease.take(name, question.owner, question.seconds)
        return NewLease(
            **_response(admission, name), secret=name if admission.tokens is None else None
        )

    return await once(work)


@router.delete(
    "", dependencies=[requires("mask:rotate")], responses=problems("invalid_request", "leased")
)
async def release_lease(
    request: Request,
    admission: AdmissionDep,
    caller: CallerDep,
    holder: HolderDep,
    *,
    force: Annotated[bool, Query()] = False,
) -> LeaseResponse:
    """Hold the camera no longer; `force=true` ends the lease of another, for `admin:tokens`.

    Who was put out stands in the log.
    """
    if force:
        caller.require("admin:tokens")
        owner = admission.lease.break_off()
        if owner is not None:
            request.state.noted = {"broke": owner}
    else:
        admission.lease.release(holder)
    return LeaseResponse(**_response(admission, holder))


def _response(admission: Admission, holder: str) -> dict[str, Any]:
    holding = admission.lease.holding
    return {
        "held": holding is not None,
        "owner": None if holding is None else holding.owner,
        "expires_in_s": admission.lease.left,
        "mine": admission.lease.held_by(holder),
    }
