"""Errors between a program and its camera.

``VeilcamError``
    ``ArgumentError``: an argument that cannot be used, or a camera that is closed.
    ``ConnectError``: nobody answers at that address.
    ``RequestTimeoutError``: connected or not, no answer in time.
    ``ProtocolError``: an answer that this SDK cannot read.
    ``FileError``: a recording, a key or a log that cannot be written or read.
    ``SealedError``: a sealed embedding that cannot be opened.
    ``ApiError``: the daemon answered with a problem; these have a class of their own:
        ``AccessError``: HTTP 401, or 403 for a token that lacks a scope.
        ``LeasedError``: HTTP 423, somebody else holds the camera.
        ``BusyError``: HTTP 429, too many captures are waiting, or too many requests are made.
        ``DeviceError``: HTTP 503; panel, sensor or fence. Nothing mixed was handed out.
"""

import copyreg
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FieldError:
    """One field that was refused."""

    location: str
    message: str


class VeilcamError(Exception):
    """Base of all errors of this SDK.

    Attributes:
        code: stable, machine-readable; for an :class:`ApiError` that of the problem.
        status: HTTP status, None when there was no answer.
        request_id: names the request in the daemon's log, None when there was no answer.
        retryable: True where the same request may succeed later.
        retry_after: pause that the daemon asked for [s], None when it did not.
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

    def __reduce__(self) -> tuple[object, ...]:
        """Copy without ``__init__``: pools of processes pickle what their workers raise."""
        return copyreg.__newobj__, (type(self), *self.args), vars(self)  # type: ignore[attr-defined]


class ArgumentError(VeilcamError, ValueError):
    """An argument that cannot be used; the message names it."""

    def __init__(self, message: str) -> None:
        super().__init__(message, code="invalid_argument")


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


class FileError(VeilcamError):
    """A recording, a file of measurements, a key or a log that cannot be written or read."""

    def __init__(self, why: str) -> None:
        super().__init__(why, code="file_failed")


class SealedError(VeilcamError):
    """A sealed embedding that cannot be opened: no key, another key, or it was changed."""

    def __init__(self, why: str) -> None:
        super().__init__(why, code="sealed")


class ApiError(VeilcamError):
    """The daemon answered with a problem; ``errors`` names the fields at fault."""

    def __init__(
        self,
        message: str,
        *,
        code: str,
        status: int,
        request_id: str,
        retryable: bool,
        retry_after: float | None,
        errors: tuple[FieldError, ...],
    ) -> None:
        super().__init__(
            message,
            code=code,
            status=status,
            request_id=request_id,
            retryable=retryable,
            retry_after=retry_after,
        )
        self.errors = errors


class AccessError(ApiError):
    """The daemon wants a valid token, or another one."""


class LeasedError(ApiError):
    """Somebody else holds the camera."""


class BusyError(ApiError):
    """Too much is asked at once, or in a short time."""


class DeviceError(ApiError):
    """The panel or the sensor failed, or is not ready."""
