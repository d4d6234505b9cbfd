"""Common ground of the wire contract: the REST API, version 1.

The server answers with these models and the SDK reads them. What is asked is closed (a field that
is not known is refused); what is answered is open (a field that a newer server adds is ignored).
What fails is answered with a problem (RFC 9457), of which the SDK makes an error.
Times in seconds, wall-clock times in UTC. ``examples()`` of a module stand in the OpenAPI document.
"""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar

from pydantic import BaseModel, ConfigDict

from veilcam_client.errors import (
    AccessError,
    ApiError,
    BusyError,
    DeviceError,
    FieldError,
    LeasedError,
)

if TYPE_CHECKING:
    import numpy.typing as npt  # loads NumPy, which most answers need not
    from pydantic import GetJsonSchemaHandler  # loads what makes JSON schemas
    from pydantic_core import CoreSchema

API_VERSION = 1
PROBLEM_MEDIA_TYPE = "application/problem+json"
CALL_HEADER = "Veilcam-Call"
"""Header that names a request: 128 random bits, 32 hexadecimal digits. Its answer repeats it."""
RUN_HEADER = "Veilcam-Run"
"""Header of every answer: name of this run of the daemon. Sent with an idempotency key, it is the
run that the key belongs to."""
UNKNOWN_RUN = "unknown"
"""Run of a key that may have come before, to a run whose name its sender never saw."""
UNAUTHORIZED_HINT = "give a token as token= or in VEILCAM_TOKEN"
_BY_CODE: Mapping[str, type[ApiError]] = {
    "unauthorized": AccessError,
    "forbidden": AccessError,
    "leased": LeasedError,
}
_BY_STATUS: Mapping[int, type[ApiError]] = {429: BusyError, 503: DeviceError}


class Described(BaseModel):
    """Base of all models, whose JSON schemas describe each field by its docstring."""

    @classmethod
    def __get_pydantic_json_schema__(
        cls, core_schema: CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        schema = handler(core_schema)
        properties = handler.resolve_ref_schema(schema).get("properties", {})
        for kind in cls.__mro__:
            for name, text in _field_docs(kind).items():
                if name in properties:
                    properties[name].setdefault("description", text)
        return schema


class Result(Described):
    """Base of what a method returns."""

    @property
    def request_id(self) -> str | None:
        """Name of the request in the daemon's log; None for what no request returned."""
        # No field: it is not compared, signed or written, and copies keep it.
        return vars(self).get("_request_id")


class Answer(Result):
    """Base of answers: checked strictly, and open to fields that a newer daemon adds."""

    # Deferred: of some sixty answers a program reads a few, and each takes a millisecond to build.
    # Questions are few, and FastAPI warns of those that it cannot build where it defines a route.
    # A traceback may end up anywhere, and answers and questions may hold tokens: it repeats none.
    model_config: ClassVar[ConfigDict] = ConfigDict(
        strict=True,
        frozen=True,
        extra="ignore",
        allow_inf_nan=False,
        defer_build=True,
        hide_input_in_errors=True,
    )

    def __array__(
        self, dtype: npt.DTypeLike | None = None, copy: bool | None = None
    ) -> npt.NDArray[Any]:
        # NumPy would make an array of one object of it.
        raise TypeError(f"a {type(self).__name__} is no array")


class Nothing(Answer):
    """Nothing but that it was done: HTTP 204, without a body."""


class Problem(Described):
    """Problem details (RFC 9457) with a stable ``code``."""

    model_config: ClassVar[ConfigDict] = Answer.model_config

    type: str
    """URN of the problem."""
    title: str
    """The same for all problems of this code."""
    status: int
    """Status code of HTTP."""
    detail: str
    """Fault, and what to do."""
    instance: str
    """Path of the request."""
    code: str
    """Stable name of the problem."""
    request_id: str
    """Name of the request in the daemon's log."""
    retryable: bool
    """True: the same request may succeed later."""
    errors: tuple[FieldError, ...] = ()
    """Fields that were refused."""

    def error(self, retry_after: float | None = None) -> ApiError:
        """Return the error to raise, chosen by the code or else by the HTTP status."""
        kind = _BY_CODE.get(self.code) or _BY_STATUS.get(self.status, ApiError)
        # A claim goes without a token.
        hint = self.code == "unauthorized" and not self.instance.endswith("/claim")
        return kind(
            f"{self.detail} ({UNAUTHORIZED_HINT})" if hint else self.detail,
            code=self.code,
            status=self.status,
            request_id=self.request_id,
            retryable=self.retryable,
            retry_after=retry_after,
            errors=self.errors,
        )


class Question(Result):
    """Base of requests: checked strictly, and closed to unknown fields."""

    model_config: ClassVar[ConfigDict] = ConfigDict(
        strict=True,
        frozen=True,
        extra="forbid",
        allow_inf_nan=False,
        hide_input_in_errors=True,
    )


@cache
def _field_docs(kind: type) -> dict[str, str]:
    """Docstrings of fields, read late: pydantic would read all of them with each import."""
    from ast import AnnAssign, Constant, Expr, Name, parse  # noqa: PLC0415 - for documents alone
    from inspect import cleandoc, getsource  # noqa: PLC0415

    if not kind.__module__.startswith(__package__ or ""):
        return {}
    body = parse(getsource(kind)).body[0].body  # type: ignore[attr-defined]
    return {
        field.target.id: cleandoc(doc.value.value)
        for field, doc in pairwise(body)
        if isinstance(field, AnnAssign) and isinstance(field.target, Name)
        if isinstance(doc, Expr) and isinstance(doc.value, Constant)
        if isinstance(doc.value.value, str)
    }


@cache
def installed_version() -> str:
    """Version of this package, which is looked for once: that takes milliseconds."""
    # Late: what reads it from the package's metadata loads more than the SDK itself.
    from importlib.metadata import version  # noqa: PLC0415

    return version("veilcam")


EXAMPLE_TIME = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)
EXAMPLE_EPOCH = "9f86d081884c7d659a2feaa0c55ad015"
EXAMPLE_DIGEST = "0f" * 32
