"""Dependencies of routes: scopes, service, idempotency keys, lease, and problems in OpenAPI."""

from __future__ import annotations

import hashlib
from collections.abc import AsyncIterator, Callable, Coroutine
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from fastapi import Depends, Header, Request, Security
from fastapi.openapi.constants import REF_PREFIX
from fastapi.security import HTTPAuthorizationCredentials, HTTPBearer, SecurityScopes

from veilcam_client.wire.base import PROBLEM_MEDIA_TYPE
from veilcam_client.wire.tokens import SCOPES, Scope
from veilcam_server.errors import PROBLEMS
from veilcam_server.security.admission import Admission
from veilcam_server.security.idempotency import IdempotencyKeys
from veilcam_server.security.tokens import Caller
from veilcam_server.service.responses import Scores
from veilcam_server.service.service import Service

ResultT = TypeVar("ResultT")

OPEN = ("bad_request", "cross_site", "host_refused", "unsupported_media_type", "internal_error")
"""What every route can answer with."""
ALWAYS = (*OPEN, "unauthorized", "forbidden", "too_many_requests", "storage_failed")
"""What every route that wants a token can answer with."""
KEYED = ("idempotency_key_reused", "answer_lost")
"""What a route that takes an ``Idempotency-Key`` can answer with besides."""
BODY = ("body_too_large", "invalid_request", *KEYED)
"""What a route with a body can answer with besides."""
CHANGE = ("storage_failed",)
"""What a route can answer with besides that makes a change which outlives the daemon."""
DEVICE = (
    *("queue_full", "not_ready", "not_looking", "conflict", "display_failed", "sensor_failed"),
    *("panel_not_hiding", "light_unsteady"),
)
"""What a route that needs the device can answer with besides."""


# What this finds is not used: the middleware has looked at the token before a byte of the body was
# read. It stands here so that the OpenAPI document names the scheme and each route's scope.
_BEARER = HTTPBearer(
    scheme_name="token",
    description="A token from `veilcamd token`, as `Authorization: Bearer vc_...`.",
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


def problems(*codes: str) -> dict[int | str, dict[str, object]]:
    """OpenAPI entries for the problems of a route, those of every route included."""
    return _problems((*ALWAYS, *codes))


def open_problems(*codes: str) -> dict[int | str, dict[str, object]]:
    """OpenAPI entries for the problems of a route that wants no token."""
    return _problems((*OPEN, *codes))


def _problems(wanted: tuple[str, ...]) -> dict[int | str, dict[str, object]]:
    answers: dict[int | str, dict[str, object]] = {}
    codes = dict.fromkeys(wanted)
    for status in sorted({PROBLEMS[code].status for code in codes}):
        answers[status] = {
            "description": ", ".join(code for code in codes if PROBLEMS[code].status == status),
            # The model itself, and an example of each code, are added to the whole document.
            "content": {PROBLEM_MEDIA_TYPE: {"schema": {"$ref": f"{REF_PREFIX}Problem"}}},
        }
    return answers


# Not plain functions: FastAPI would run those on a thread pool, two hops for every request.
async def _service(request: Request) -> Service:
    service: Service = request.app.state.service
    return service


async def _admission(request: Request) -> Admission:
    admission: Admission = request.app.state.admission
    return admission


AdmissionDep = Annotated[Admission, Depends(_admission)]


@dataclass(frozen=True, slots=True)
class Once:
    """Does the work of a request once for its ``Idempotency-Key``."""

    keys: IdempotencyKeys
    caller: str
    key: str | None
    fingerprint: bytes

    async def __call__(self, work: Callable[[], Coroutine[Any, Any, ResultT]]) -> ResultT:
        """Return the result of ``work``; raises as :meth:`IdempotencyKeys.once` besides."""
        return await self.keys.once(self.caller, self.key, self.fingerprint, work)


async def _once(
    request: Request,
    admission: AdmissionDep,
    caller: CallerDep,
    idempotency_key: Annotated[str | None, Header(pattern=r"^[\x21-\x7e]{1,128}$")] = None,
    veilcam_run: Annotated[str | None, Header(max_length=64)] = None,
) -> Once:
    if idempotency_key is not None:
        admission.keys.require_run(caller.id, idempotency_key, veilcam_run)
    head = f"{request.method} {request.url.path}?{request.url.query}\n".encode()
    return Once(
        admission.keys,
        # A caller's own: nobody is answered with what another one was told.
        caller.id,
        idempotency_key,
        hashlib.sha256(head + await request.body()).digest(),
    )


ServiceDep = Annotated[Service, Depends(_service)]
OnceDep = Annotated[Once, Depends(_once)]


async def _holder(
    admission: AdmissionDep,
    caller: CallerDep,
    veilcam_lease: Annotated[str, Header(max_length=64)] = "",
) -> str:
    """Name of who asks: the token's, or what it was told when it took the lease."""
    return veilcam_lease if admission.tokens is None else caller.id


HolderDep = Annotated[str, Depends(_holder)]


async def _upload_place(admission: AdmissionDep, caller: CallerDep) -> AsyncIterator[None]:
    with (
        admission.uploads_of_one.held(caller.id),
        admission.uploads.held("all callers together"),
    ):
        yield


def uploads() -> Any:
    """For ``dependencies=[uploads()]``: 429 where too many uploads are under way."""
    return Depends(_upload_place)


async def _free(admission: AdmissionDep, holder: HolderDep) -> None:
    admission.lease.require(holder)


def unleased() -> Any:
    """For ``dependencies=[unleased()]``: 423 while somebody else holds the camera."""
    return Depends(_free)
