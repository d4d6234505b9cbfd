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
from veilcam_server import errors as daemon_errors
from veilcam_server.devices import errors as device_errors
from veilcam_server.errors import ProblemError, UnauthorizedError


class BadRequestError(
    ProblemError, code="bad_request", status=400, title="The request cannot be read"
):
    """A request that is no HTTP or no JSON."""


class NotFoundError(
    ProblemError, code="not_found", status=404, title="There is nothing at this path"
):
    """A path of no route."""


class MethodNotAllowedError(
    ProblemError,
    code="method_not_allowed",
    status=405,
    title="This path does not take this method",
):
    """A method that no route of this path has."""


class NotAcceptableError(
    ProblemError,
    code="not_acceptable",
    status=406,
    title="None of the accepted media types can be given",
):
    """Media types that are not offered."""


class BodyTooLargeError(
    ProblemError, code="body_too_large", status=413, title="The body is too large"
):
    """More bytes than the route takes."""


class UnsupportedMediaTypeError(
    ProblemError,
    code="unsupported_media_type",
    status=415,
    title="The body's media type is not taken here",
):
    """A body that is not said to be what the route takes."""

    def __init__(self, taken: tuple[str, ...]) -> None:
        super().__init__(f"send it with Content-Type: {' or '.join(taken)}")


class InvalidRequestError(
    ProblemError, code="invalid_request", status=422, title="The request is not valid"
):
    """Fields that are missing, unknown or out of range."""


class DefectError(ProblemError, code="internal_error", status=500, title="The daemon has a defect"):
    """An error that nobody foresaw."""


_OF_HTTP = {
    kind.status: kind
    for kind in (BadRequestError, NotFoundError, MethodNotAllowedError, BodyTooLargeError)
}
"""What Starlette, FastAPI and the middleware raise by its status alone."""
PROBLEMS: Mapping[str, type[ProblemError]] = {
    kind.code: kind
    for namespace in (vars(daemon_errors), vars(device_errors), globals())
    for kind in tuple(namespace.values())
    if isinstance(kind, type) and issubclass(kind, ProblemError) and "code" in vars(kind)
}
"""Every kind by its code."""


def _problem(
    kind: type[ProblemError],
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
    kind: type[ProblemError],
    detail: str,
    *,
    errors: tuple[FieldError, ...] = (),
    headers: Mapping[str, str] | None = None,
) -> Response:
    """Return the answer to the request of ``scope``, and leave the code for the audit log."""
    state = scope["state"]
    state["problem"] = kind.code
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
    if error.retryable:
        headers["Retry-After"] = str(error.retry_after)
    if isinstance(error, UnauthorizedError):
        headers["WWW-Authenticate"] = 'Bearer realm="veilcam"'
    return problem_response(scope, type(error), str(error), headers=headers)


def example_of(code: str) -> dict[str, object]:
    """Return the schema of an answer with this code."""
    kind = PROBLEMS[code]
    problem = _problem(kind, kind.title, instance="/v1/status", request_id="5ca1ab1e0ddba11")
    example: dict[str, object] = json.loads(problem.model_dump_json(exclude_none=True))
    return example


async def _on_error(request: Request, error: ProblemError) -> Response:
    return error_response(request.scope, error)


async def _on_http(request: Request, error: HTTPException) -> Response:
    kind = _OF_HTTP.get(error.status_code, BadRequestError)
    detail = str(error.detail)
    if detail == HTTPStatus(error.status_code).phrase:
        detail = f"{request.method} {request.url.path}: {kind.title.lower()}"
    headers = dict(error.headers or {})
    if kind is MethodNotAllowedError:
        headers["Allow"] = ", ".join(_methods(request))
    return problem_response(request.scope, kind, detail, headers=headers)


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
    return problem_response(request.scope, InvalidRequestError, detail, errors=errors)


HANDLERS: dict[int | type[Exception], Callable[[Request, Any], Coroutine[Any, Any, Response]]] = {
    HTTPException: _on_http,
    RequestValidationError: _on_invalid,
    ProblemError: _on_error,
}
"""Answers to every known error, for the application."""
