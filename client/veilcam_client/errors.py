"""What can go wrong between a program and its camera.

``VeilcamError``
    ``ConnectError``: nobody answers at that address.
    ``RequestTimeoutError``: connected or not, no answer in time.
    ``ProtocolError``: an answer that this SDK cannot read.
    ``ApiError``: the daemon answered with a problem.
        ``InvalidRequestError``: HTTP 400 to 428, asking the same again will not help.
        ``BusyError``: HTTP 429, too many captures are waiting.
        ``DeviceError``: HTTP 503; panel, sensor or fence. Nothing mixed was handed out.
        ``ServerError``: any other 5xx, a defect of the daemon.
"""

from __future__ import annotations

from veilcam_client.models import FieldError, Problem


class VeilcamError(Exception):
    """Base of all errors of this SDK.

    Attributes:
        code: stable, machine-readable; for an :class:`ApiError` that of the problem.
        status: HTTP status, None when there was no answer.
        request_id: names the request in the daemon's log, None when there was no answer.
        retryable: whether the same request may succeed later.
        retry_after: what the daemon asked to wait [s], None when it did not.
    """

    def __init__(
        self,
        message: str,
        *,
        code: str,
        status: int | None = None,
        request_id: str | None = None,
        retryable: bool = False,
        retry_after: float | None = None,
    ) -> None:
        super().__init__(message)
        self.code = code
        self.status = status
        self.request_id = request_id
        self.retryable = retryable
        self.retry_after = retry_after


class ConnectError(VeilcamError):
    """Nobody answers at that address, or the connection broke."""

    def __init__(self, message: str) -> None:
        super().__init__(message, code="connection_failed", retryable=True)


class RequestTimeoutError(VeilcamError):
    """No connection or no answer within the time given."""

    def __init__(self, message: str) -> None:
        super().__init__(message, code="timeout", retryable=True)


class ProtocolError(VeilcamError):
    """An answer that is not this API's."""

    def __init__(
        self, message: str, *, status: int | None = None, request_id: str | None = None
    ) -> None:
        super().__init__(message, code="protocol_error", status=status, request_id=request_id)


class ApiError(VeilcamError):
    """The daemon answered with a problem; ``errors`` names the fields at fault."""

    def __init__(self, problem: Problem, retry_after: float | None = None) -> None:
        super().__init__(
            problem.detail,
            code=problem.code,
            status=problem.status,
            request_id=problem.request_id,
            retryable=problem.retryable,
            retry_after=retry_after,
        )
        self.errors: tuple[FieldError, ...] = problem.errors


class InvalidRequestError(ApiError):
    """The request is at fault."""


class BusyError(ApiError):
    """Too many captures are waiting."""


class DeviceError(ApiError):
    """The panel or the sensor failed, or is not ready."""


class ServerError(ApiError):
    """A defect of the daemon."""


def error_from_problem(problem: Problem, retry_after: float | None = None) -> ApiError:
    """Return the error for a problem, chosen by its HTTP status."""
    if problem.status == 429:
        return BusyError(problem, retry_after)
    if problem.status == 503:
        return DeviceError(problem, retry_after)
    if problem.status >= 500:
        return ServerError(problem, retry_after)
    return InvalidRequestError(problem, retry_after)
