"""Scopes as dependencies: every route names the one that it needs."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Depends, Request, Security
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer, SecurityScopes

from veilcam_client.wire.tokens import SCOPES, Scope
from veilcam_server.security.caller import Caller
from veilcam_server.service.responses import Scores

# What this finds is not used: the middleware has looked at the token before a byte of the body was
# read. It stands here so that the OpenAPI document names the scheme and each route's scope.
_BEARER = HTTPBearer(
    scheme_name="token",
    description="A token from `veilcamd token create`, as `Authorization: Bearer vc_...`.",
    auto_error=False,
)


async def caller_of(request: Request) -> Caller:
    """Return the caller that the middleware found."""
    caller: Caller = request.state.caller
    return caller


CallerDep = Annotated[Caller, Depends(caller_of)]


async def _allowed(
    needed: SecurityScopes,
    caller: CallerDep,
    _: Annotated[HTTPAuthorizationCredentials | None, Security(_BEARER)],
) -> None:
    for scope in SCOPES:
        if scope in needed.scopes:
            caller.require(scope)


def requires(scope: Scope) -> Any:
    """For ``dependencies=[requires("classify")]``: 403 unless the caller has this scope."""
    return Security(_allowed, scopes=[scope])


def scores_for(caller: Caller) -> Scores:
    """Return how a caller may see probabilities."""
    if not caller.may("read:scores"):
        return "none"
    return "all" if caller.full_scores else "tenths"
