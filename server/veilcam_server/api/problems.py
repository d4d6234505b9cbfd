"""Problem details (RFC 9457): every error that leaves the API, with its stable code."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from http import HTTPStatus

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import Response
from starlette.exceptions import HTTPException

from veilcam_client.wire.captures import PROBLEM_MEDIA_TYPE, FieldError, Problem
from veilcam_server.devices.errors import DisplayError, SensorError, SensorTimeoutError
from veilcam_server.errors import (
    CalibratingError,
    CalibrationError,
    EpochError,
    FenceError,
    ForbiddenError,
    HostRefusedError,
    IdempotencyError,
    InferenceError,
    KeyringInUseError,
    KeyringInvalidError,
    KeyringsBusyError,
    KeyringsFullError,
    KeyringStoreError,
    KeyringUnfitError,
    LeasedError,
    NotCalibratingError,
    NotReadyError,
    QueueFullError,
    RateLimitError,
    ReplayingError,
    ReplayOverError,
    RotationImpossibleError,
    SceneApiOffError,
    SceneInvalidError,
    SceneNotWantedError,
    TokensOffError,
    TokenStoreError,
    TooManyRequestsError,
    TooManyStreamsError,
    UnauthorizedError,
    UnknownKeyringError,
    UnknownTokenError,
    WithheldError,
)


@dataclass(frozen=True, slots=True)
class ProblemType:
    """What a code always means."""

    status: int
    title: str
    retryable: bool = False


PROBLEMS: Mapping[str, ProblemType] = {
    "bad_request": ProblemType(400, "The request cannot be read"),
    "unauthorized": ProblemType(401, "A valid token is wanted"),
    "forbidden": ProblemType(403, "The token does not allow this"),
    "embedding_withheld": ProblemType(403, "Embeddings are not released"),
    "not_found": ProblemType(404, "There is nothing at this path"),
    "unknown_token": ProblemType(404, "There is no such token"),
    "unknown_keyring": ProblemType(404, "There is no such keyring"),
    "method_not_allowed": ProblemType(405, "This path does not take this method"),
    "not_acceptable": ProblemType(406, "None of the accepted media types can be given"),
    "rotation_impossible": ProblemType(409, "There is no other mask"),
    "keyring_unfit": ProblemType(409, "The keyring does not fit this camera"),
    "keyring_in_use": ProblemType(409, "The keyring is in use"),
    "keyrings_full": ProblemType(409, "Too many keyrings are installed"),
    "not_calibrating": ProblemType(409, "No calibration is under way"),
    "scene_not_wanted": ProblemType(409, "This scene is not waited for"),
    "calibration_impossible": ProblemType(409, "This camera cannot be calibrated"),
    "tokens_off": ProblemType(409, "This daemon wants no tokens"),
    "replaying": ProblemType(409, "A recording cannot do this"),
    "replay_over": ProblemType(409, "The recording is over"),
    "scene_api_off": ProblemType(409, "No scenes are held up by program"),
    "body_too_large": ProblemType(413, "The body is too large"),
    "host_refused": ProblemType(421, "This host name is not served"),
    "invalid_request": ProblemType(422, "The request is not valid"),
    "keyring_invalid": ProblemType(422, "This is no keyring that can be used"),
    "scene_invalid": ProblemType(422, "This is no picture"),
    "idempotency_key_reused": ProblemType(422, "The idempotency key belongs to another request"),
    "leased": ProblemType(423, "Somebody else holds the camera", retryable=True),
    "queue_full": ProblemType(429, "Too many captures are waiting", retryable=True),
    "rate_limited": ProblemType(429, "Too many requests in a short time", retryable=True),
    "too_many_requests": ProblemType(429, "Too many requests at once", retryable=True),
    "too_many_streams": ProblemType(429, "Too many event streams are open", retryable=True),
    "internal_error": ProblemType(500, "The daemon has a defect"),
    "not_ready": ProblemType(503, "The camera takes no captures now", retryable=True),
    "calibrating": ProblemType(503, "The camera is being calibrated", retryable=True),
    "display_failed": ProblemType(503, "The panel failed", retryable=True),
    "sensor_failed": ProblemType(503, "The sensor failed", retryable=True),
    "sensor_timeout": ProblemType(503, "The sensor gave no reading in time", retryable=True),
    "fence_violated": ProblemType(503, "The reading could not be trusted", retryable=True),
    "tokens_unavailable": ProblemType(503, "The tokens are out of reach", retryable=True),
    "inference_failed": ProblemType(503, "The classifier gave no probabilities"),
    "keyrings_busy": ProblemType(503, "The keyrings are being changed", retryable=True),
    "keyring_not_stored": ProblemType(503, "The keyring is not durable", retryable=True),
    "epoch_not_recorded": ProblemType(503, "The mask epoch is not durable", retryable=True),
}

_CODES: tuple[tuple[type[Exception], str], ...] = (
    (HostRefusedError, "host_refused"),
    (UnauthorizedError, "unauthorized"),
    (ForbiddenError, "forbidden"),
    (UnknownTokenError, "unknown_token"),
    (NotCalibratingError, "not_calibrating"),
    (SceneNotWantedError, "scene_not_wanted"),
    (CalibrationError, "calibration_impossible"),
    (UnknownKeyringError, "unknown_keyring"),
    (KeyringUnfitError, "keyring_unfit"),
    (KeyringInUseError, "keyring_in_use"),
    (KeyringsFullError, "keyrings_full"),
    (KeyringInvalidError, "keyring_invalid"),
    (KeyringsBusyError, "keyrings_busy"),
    (KeyringStoreError, "keyring_not_stored"),
    (TokensOffError, "tokens_off"),
    (ReplayOverError, "replay_over"),
    (ReplayingError, "replaying"),
    (SceneApiOffError, "scene_api_off"),
    (SceneInvalidError, "scene_invalid"),
    (TokenStoreError, "tokens_unavailable"),
    (RotationImpossibleError, "rotation_impossible"),
    (WithheldError, "embedding_withheld"),
    (RateLimitError, "rate_limited"),
    (TooManyRequestsError, "too_many_requests"),
    (TooManyStreamsError, "too_many_streams"),
    (LeasedError, "leased"),
    (IdempotencyError, "idempotency_key_reused"),
    (QueueFullError, "queue_full"),
    (CalibratingError, "calibrating"),
    (NotReadyError, "not_ready"),
    (DisplayError, "display_failed"),
    (SensorTimeoutError, "sensor_timeout"),
    (SensorError, "sensor_failed"),
    (FenceError, "fence_violated"),
    (EpochError, "epoch_not_recorded"),
    (InferenceError, "inference_failed"),
)
_HTTP_CODES = {
    code: name
    for name, code in (
        ("bad_request", 400),
        ("not_found", 404),
        ("method_not_allowed", 405),
        ("not_acceptable", 406),
        ("body_too_large", 413),
    )
}
_RETRY_AFTER = 1
"""What to wait after a device failure [s]."""


def code_of(error: Exception) -> str | None:
    """Return the problem code of an error of the daemon, None for one that it does not know."""
    return next((code for kind, code in _CODES if isinstance(error, kind)), None)


def problem_response(
    *,
    code: str,
    detail: str,
    instance: str,
    request_id: str,
    errors: tuple[FieldError, ...] = (),
    headers: Mapping[str, str] | None = None,
) -> Response:
    """Return the answer for one problem."""
    kind = PROBLEMS[code]
    problem = Problem(
        type=f"urn:veilcam:problem:{code}",
        title=kind.title,
        status=kind.status,
        detail=detail,
        instance=instance,
        code=code,
        request_id=request_id,
        retryable=kind.retryable,
        errors=errors,
    )
    return Response(
        problem.model_dump_json(exclude_none=True),
        kind.status,
        headers=headers,
        media_type=PROBLEM_MEDIA_TYPE,
    )


def example_of(code: str) -> dict[str, object]:
    """What an answer with this code can look like."""
    answer = problem_response(
        code=code, detail=PROBLEMS[code].title, instance="/v1/status", request_id="5ca1ab1e0ddba11"
    )
    example: dict[str, object] = json.loads(bytes(answer.body))
    return example


def install(app: FastAPI) -> None:
    """Answer every known error of ``app`` with a problem."""
    app.add_exception_handler(HTTPException, _on_http)
    app.add_exception_handler(RequestValidationError, _on_invalid)
    for kind, _ in _CODES:
        app.add_exception_handler(kind, _on_error)


def error_response(error: Exception, *, instance: str, request_id: str) -> Response:
    """Return the answer for an error of the daemon."""
    code = code_of(error) or "internal_error"
    headers = {}
    if PROBLEMS[code].retryable:
        headers["Retry-After"] = str(getattr(error, "retry_after", _RETRY_AFTER))
    if isinstance(error, UnauthorizedError):
        headers["WWW-Authenticate"] = 'Bearer realm="veilcam"'
    return problem_response(
        code=code, detail=str(error), instance=instance, request_id=request_id, headers=headers
    )


async def _on_error(request: Request, error: Exception) -> Response:
    request.state.problem = code_of(error)
    return error_response(error, instance=request.url.path, request_id=request.state.request_id)


async def _on_http(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)  # noqa: S101 - that is what it is registered for
    code = _HTTP_CODES.get(error.status_code, "bad_request")
    request.state.problem = code
    detail = str(error.detail)
    if detail == HTTPStatus(error.status_code).phrase:
        detail = f"{request.method} {request.url.path}: {PROBLEMS[code].title.lower()}"
    return problem_response(
        code=code,
        detail=detail,
        instance=request.url.path,
        request_id=request.state.request_id,
        headers=error.headers,
    )


async def _on_invalid(request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)  # noqa: S101 - as above
    # Only where and why: what was sent stays out of answers and logs.
    errors = tuple(
        FieldError(location=".".join(str(part) for part in item["loc"]), message=str(item["msg"]))
        for item in error.errors()
    )
    request.state.problem = "invalid_request"
    return problem_response(
        code="invalid_request",
        detail="; ".join(f"{item.location}: {item.message}" for item in errors),
        instance=request.url.path,
        request_id=request.state.request_id,
        errors=errors,
    )
