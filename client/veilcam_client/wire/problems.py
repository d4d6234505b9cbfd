"""Problem details (RFC 9457) with a stable ``code``, and the error that each becomes."""

from __future__ import annotations

from collections.abc import Mapping

from veilcam_client.errors import (
    ApiError,
    BusyError,
    DeviceError,
    FieldError,
    ForbiddenError,
    InvalidRequestError,
    LeasedError,
    ServerError,
    UnauthorizedError,
)
from veilcam_client.wire.base import Answer

PROBLEM_MEDIA_TYPE = "application/problem+json"
_BY_CODE: Mapping[str, type[ApiError]] = {
    "unauthorized": UnauthorizedError,
    "forbidden": ForbiddenError,
    "leased": LeasedError,
}
_BY_STATUS: Mapping[int, type[ApiError]] = {429: BusyError, 503: DeviceError}


class Problem(Answer):
    """Problem details (RFC 9457) with a stable ``code``."""

    type: str
    title: str
    status: int
    detail: str
    instance: str
    code: str
    request_id: str
    retryable: bool
    errors: tuple[FieldError, ...] = ()

    def error(self, retry_after: float | None = None) -> ApiError:
        """Return the error to raise, chosen by the code or else by the HTTP status."""
        other = ServerError if self.status >= 500 else InvalidRequestError
        kind = _BY_CODE.get(self.code) or _BY_STATUS.get(self.status, other)
        return kind(
            self.detail,
            code=self.code,
            status=self.status,
            request_id=self.request_id,
            retryable=self.retryable,
            retry_after=retry_after,
            errors=self.errors,
        )
