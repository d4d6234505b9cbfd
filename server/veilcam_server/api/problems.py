"""Problem details (RFC 9457): every error that leaves the API, with its stable code."""

from __future__ import annotations

import json
from collections.abc import Callable, Coroutine, Mapping
from http import HTTPStatus
from typing import Any

from fastapi import Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import Response
from starlette.exceptions import HTTPException
from starlette.routing import Match
from starlette.types import Scope

from veilcam_client.errors import FieldError
from veilcam_client.wire.base import PROBLEM_MEDIA_TYPE, Problem
from veilcam_server.errors import PROBLEMS, ProblemError, ProblemKind

_OF_HTTP = {400: "bad_request", 404: "not_found", 405: "method_not_allowed", 413: "body_too_large"}
"""What Starlette, FastAPI and the middleware raise by its status alone."""


def _problem(
    kind: ProblemKind,
    detail: str,
    *,
    instance: str,
    request_id: str,
    errors: tuple[FieldError, ...] = (),
) -> Problem:
    return Problem(
        type=f"urn:veilcam:problem:{kind.code}",
        title=kind.title,
        status=kind.status,
        detail=detail,
        instance=instance,
        code=kind.code,
        request_id=request_id,
        retryable=kind.retryable,
        errors=errors,
    )


def problem_response(
    scope: Scope,
    code: str,
    detail: str,
    *,
    errors: tuple[FieldError, ...] = (),
    headers: Mapping[str, str] | None = None,
) -> Response:
    """Return the answer to the request of ``scope``, and leave the code for the log."""
    kind, state = PROBLEMS[code], scope["state"]
    state["problem"] = code
    problem = _problem(
        kind, detail, instance=scope["path"], request_id=state["request_id"], errors=errors
    )
    return Response(
        problem.model_dump_json(exclude_none=True),
        kind.status,
        headers=headers,
        media_type=PROBLEM_MEDIA_TYPE,
    )


def error_response(scope: Scope, error: ProblemError) -> Response:
    """Return the answer to the request of ``scope``, at which the daemon failed."""
    headers = {}
    if error.kind.retryable:
        headers["Retry-After"] = str(error.retry_after)
    if error.code == "unauthorized":
        headers["WWW-Authenticate"] = 'Bearer realm="veilcam"'
    return problem_response(scope, error.code, str(error), headers=headers)


def example_of(code: str) -> dict[str, object]:
    """Return the schema of an answer with this code."""
    kind = PROBLEMS[code]
    problem = _problem(kind, kind.title, instance="/v1/status", request_id="5ca1ab1e0ddba11")
    example: dict[str, object] = json.loads(problem.model_dump_json(exclude_none=True))
    return example


async def _on_error(request: Request, error: ProblemError) -> Response:
    return error_response(request.scope, error)


async def _on_http(request: Request, error: HTTPException) -> Response:
    code = _OF_HTTP.get(error.status_code, "bad_request")
    detail = str(error.detail)
    if detail == HTTPStatus(error.status_code).phrase:
        detail = f"{request.method} {request.url.path}: {PROBLEMS[code].title.lower()}"
    headers = dict(error.headers or {})
    if code == "method_not_allowed":
        headers["Allow"] = ", ".join(_methods(request))
    return problem_response(request.scope, code, detail, headers=headers)


def _methods(request: Request) -> list[str]:
    """Methods that the path of a request takes, of all routes together."""
    asked = {"type": "http", "path": request.scope["path"], "headers": []}
    taken = {
        method
        for method in ("DELETE", "GET", "PATCH", "POST", "PUT")
        for route in request.app.router.routes
        if route.matches({**asked, "method": method})[0] is Match.FULL
    }
    # HEAD is answered wherever GET is.
    return sorted(taken | {"HEAD"} if "GET" in taken else taken)


async def _on_invalid(request: Request, error: RequestValidationError) -> Response:
    # Only where and why: what was sent stays out of answers and logs.
    errors = tuple(
        FieldError(location=".".join(str(part) for part in item["loc"]), message=str(item["msg"]))
        for item in error.errors()
    )
    detail = "; ".join(f"{item.location}: {item.message}" for item in errors)
    return problem_response(request.scope, "invalid_request", detail, errors=errors)


HANDLERS: dict[int | type[Exception], Callable[[Request, Any], Coroutine[Any, Any, Response]]] = {
    HTTPException: _on_http,
    RequestValidationError: _on_invalid,
    ProblemError: _on_error,
}
"""Answers to every known error, for the application."""
