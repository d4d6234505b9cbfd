"""REST API of the lease, and what keeps others away meanwhile."""

from __future__ import annotations

import secrets
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Header, Query, Request

from veilcam_client.wire.lease import Lease as LeaseAnswer
from veilcam_client.wire.lease import LeaseRequest, NewLease
from veilcam_server.api.dependencies import BODY, GatewayDep, OnceDep, problems
from veilcam_server.security.admission import Gateway
from veilcam_server.security.caller import CallerDep, requires


async def _holder(
    gateway: GatewayDep,
    caller: CallerDep,
    veilcam_lease: Annotated[str, Header(max_length=64)] = "",
) -> str:
    """Name of who asks: the token's, or what it was told when it took the lease."""
    return veilcam_lease if gateway.tokens is None else caller.id


HolderDep = Annotated[str, Depends(_holder)]


async def _free(gateway: GatewayDep, holder: HolderDep) -> None:
    gateway.lease.require(holder)


def unleased() -> Any:
    """For ``dependencies=[unleased()]``: 423 while somebody else holds the camera."""
    return Depends(_free)


router = APIRouter(prefix="/v1/lease", redirect_slashes=False)


@router.get("", dependencies=[requires("read:status")], responses=problems("invalid_request"))
async def lease(gateway: GatewayDep, holder: HolderDep) -> LeaseAnswer:
    """Whether somebody holds the camera."""
    return LeaseAnswer(**_answer(gateway, holder))


@router.post("", dependencies=[requires("mask:rotate")], responses=problems(*BODY, "leased"))
async def take(
    gateway: GatewayDep, holder: HolderDep, once: OnceDep, question: LeaseRequest
) -> NewLease:
    """Hold the camera, or go on holding it: others take no captures and change no mask."""

    async def work() -> NewLease:
        name = holder
        if gateway.tokens is None and not gateway.lease.held_by(holder):
            gateway.lease.require(holder)
            name = secrets.token_hex(16)
        gateway.lease.take(name, question.owner, question.seconds)
        secret = name if gateway.tokens is None else None
        return NewLease(**_answer(gateway, name), secret=secret)

    return await once(work)


@router.delete(
    "", dependencies=[requires("mask:rotate")], responses=problems("invalid_request", "leased")
)
async def release(
    request: Request,
    gateway: GatewayDep,
    caller: CallerDep,
    holder: HolderDep,
    *,
    force: Annotated[bool, Query()] = False,
) -> LeaseAnswer:
    """Hold the camera no longer; `force=true` ends the lease of another, for `admin:tokens`.

    Who was put out stands in the audit log.
    """
    if force:
        caller.require("admin:tokens")
        owner = gateway.lease.break_off()
        if owner is not None:
            request.state.noted = {"broke": owner}
    else:
        gateway.lease.release(holder)
    return LeaseAnswer(**_answer(gateway, holder))


def _answer(gateway: Gateway, holder: str) -> dict[str, Any]:
    holding = gateway.lease.holding
    return {
        "held": holding is not None,
        "owner": None if holding is None else holding.owner,
        "expires_in_s": gateway.lease.left,
        "mine": gateway.lease.held_by(holder),
    }
