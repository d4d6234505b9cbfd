"""REST API of the session of a page in a browser."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from fastapi import APIRouter, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import Response

from veilcam_client.wire.tokens import NewSession, Session
from veilcam_server.api.dependencies import AdmissionDep, CallerDep, problems, requires
from veilcam_server.errors import ProblemError, UnauthorizedError
from veilcam_server.security.admission import Admission
from veilcam_server.security.sessions import SessionStore, cookie_name
from veilcam_server.security.tokens import Caller

PATH = "/v1/session"

router = APIRouter(
    prefix=PATH, dependencies=[requires("read:status")], redirect_slashes=False, tags=["Session"]
)


def _sessions(admission: Admission) -> SessionStore:
    if admission.sessions is None:
        raise ProblemError(
            "not_enabled", "this daemon wants no tokens: start it with --auth tokens"
        )
    return admission.sessions


@router.get("", responses=problems())
async def session(request: Request, admission: AdmissionDep, caller: CallerDep) -> Session:
    """Holder of the session, its scopes, and its end."""
    ends = None if admission.sessions is None else admission.sessions.expires(request.headers)
    return Session(**_told(admission, caller, caller.expires if ends is None else ends))


@router.post("", status_code=201, responses=problems("not_enabled"))
async def begin_session(
    request: Request, response: Response, admission: AdmissionDep, caller: CallerDep
) -> NewSession:
    """Begin a session with the token of this request, for a page that keeps no token.

    One half of it is a cookie that no script can read, the other one is sent as
    ``Veilcam-Session``; neither opens anything alone. It ends with its token, or after a week.
    """
    store = _sessions(admission)
    # A session makes none: whoever stole one could go on for ever.
    if "authorization" not in request.headers:
        raise UnauthorizedError()
    begun = await run_in_threadpool(store.begin, caller)
    _set_cookie(admission, request, response, begun.cookie, int(begun.lifetime))
    return NewSession(**_told(admission, caller, begun.expires), half=begun.half)


@router.delete("", status_code=204, response_class=Response, responses=problems("not_enabled"))
async def end_session(request: Request, response: Response, admission: AdmissionDep) -> None:
    """End the session of this request."""
    await run_in_threadpool(_sessions(admission).end, request.headers)
    _set_cookie(admission, request, response, "", 0)


def _told(admission: Admission, caller: Caller, ends: float | None) -> dict[str, Any]:
    return {
        "tokens": admission.tokens is not None,
        "label": caller.label,
        "scopes": tuple(sorted(caller.scopes)),
        "expires_at": None if ends is None else datetime.fromtimestamp(ends, UTC),
    }


def _set_cookie(
    admission: Admission, request: Request, response: Response, value: str, seconds: int
) -> None:
    root = admission.site.root_path
    response.set_cookie(
        cookie_name(request.headers["host"].lower()),
        value,
        max_age=seconds,
        # Without one it is the folder of the request as the browser sees it: below a proxy's path.
        path=f"{root}/v1" if root else None,
        # The browser says how it came here, also through a proxy that speaks TLS for us.
        secure=request.headers.get("origin", request.url.scheme).startswith("https"),
        httponly=True,
        samesite="strict",
    )
