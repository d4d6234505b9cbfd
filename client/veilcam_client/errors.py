"""Errors between a program and its camera.

``VeilcamError``
    ``ArgumentError``: an argument that cannot be used, or a camera that is closed.
    ``ConnectError``: nobody answers at that address.
    ``RequestTimeoutError``: connected or not, no answer in time.
    ``ProtocolError``: an answer that this SDK cannot read.
    ``RecordingError``: a recording that cannot be written or read.
    ``KeyFileError``: a key of a receiver that cannot be written or read.
    ``SealedError``: a sealed embedding that cannot be opened.
    ``LogFileError``: a log of captures that cannot be written or read, or gone on with.
    ``DiscoveryError``: cameras cannot be looked for.
    ``ApiError``: the daemon answered with a problem.
        ``UnauthorizedError``: HTTP 401, the token is missing or not valid any more.
        ``ForbiddenError``: the token lacks a scope.
        ``LeasedError``: HTTP 423, somebody else holds the camera.
        ``InvalidRequestError``: any other HTTP 400 to 428, asking the same again will not help.
        ``BusyError``: HTTP 429, too many captures are waiting, or too many requests are made.
        ``DeviceError``: HTTP 503; panel, sensor or fence. Nothing mixed was handed out.
        ``ServerError``: any other 5xx, a defect of the daemon.
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


class RecordingError(VeilcamError):
    """A recording, or a file of measurements, that cannot be written or read."""

    def __init__(self, why: str) -> None:
        super().__init__(why, code="recording_failed")


class KeyFileError(VeilcamError):
    """A receiver's private key that cannot be written or read."""

    def __init__(self, why: str) -> None:
        super().__init__(why, code="key_file_failed")


class SealedError(VeilcamError):
    """A sealed embedding that cannot be opened: no key, another key, or it was changed."""

    def __init__(self, why: str) -> None:
        super().__init__(why, code="sealed")


class LogFileError(VeilcamError):
    """A log of captures that cannot be written or read, or gone on with."""

    def __init__(self, why: str) -> None:
        super().__init__(why, code="log_file_failed")


class DiscoveryError(VeilcamError):
    """Cameras cannot be looked for: an extra is not installed, or there is no network."""

    def __init__(self, why: str) -> None:
        super().__init__(why, code="discovery_failed")


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


class UnauthorizedError(ApiError):
    """The daemon wants a valid token."""


class ForbiddenError(ApiError):
    """The token does not allow this."""


class LeasedError(ApiError):
    """Somebody else holds the camera."""


class InvalidRequestError(ApiError):
    """The request is at fault."""


class BusyError(ApiError):
    """Too much is asked at once, or in a short time."""


class DeviceError(ApiError):
    """The panel or the sensor failed, or is not ready."""


class ServerError(ApiError):
    """A defect of the daemon."""
