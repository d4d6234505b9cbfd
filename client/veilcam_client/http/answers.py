"""Answers of a daemon: read whole within limits, and turned into models or errors."""

from __future__ import annotations

import secrets
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import httpx
from httpx_sse import ServerSentEvent
from pydantic import BaseModel, ValidationError

from veilcam_client.errors import ArgumentError, ProtocolError, RequestTimeoutError, VeilcamError
from veilcam_client.http.calls import Call
from veilcam_client.http.options import log
from veilcam_client.wire.base import CALL_HEADER, PROBLEM_MEDIA_TYPE, UNAUTHORIZED_HINT, Problem
from veilcam_client.wire.captures import NPY_MEDIA_TYPE, Capture
from veilcam_client.wire.events import EVENT, Event

MAX_ANSWER = 8 * 2**20
"""More than any answer of a daemon has: the largest is a page of the log [bytes]."""
MAX_EVENT = 2**20
"""No event of a daemon comes near [bytes]."""

AnswerT = TypeVar("AnswerT", bound=BaseModel)
ResultT = TypeVar("ResultT")


@dataclass(frozen=True, slots=True)
class Received:
    """One answer as it came.

    Attributes:
        status_code: status code of HTTP.
        headers: names in any case.
        content: the body.
    """

    status_code: int
    headers: Mapping[str, str] = field(repr=False)
    content: bytes = field(repr=False)

    @property
    def request_id(self) -> str | None:
        """Names the request in the daemon's log."""
        return self.headers.get("x-request-id")


@dataclass(frozen=True, slots=True)
class RawResponse(Received, Generic[ResultT]):
    """An answer as it came, beside what the SDK makes of it."""

    _result: ResultT = field(repr=False)

    def parse(self) -> ResultT:
        """Return the method's result where the raw answer is not asked for."""
        return self._result


_KEPT: ContextVar[list[Received] | None] = ContextVar("kept", default=None)


@contextmanager
def kept_answers() -> Iterator[list[Received]]:
    """Keep the answers that calls within the context get, as they came."""
    kept: list[Received] = []
    before = _KEPT.set(kept)
    try:
        yield kept
    finally:
        _KEPT.reset(before)


def keep(received: Received) -> None:
    """Keep an answer, where somebody asked for it as it came."""
    kept = _KEPT.get()
    if kept is not None:
        kept.append(received)


def raw_response(kept: list[Received], result: ResultT) -> RawResponse[ResultT]:
    """Return what a method made of the last answer beside it."""
    if not kept:
        raise ArgumentError("this method asks the daemon for nothing: use one that does")
    last = kept[-1]
    return RawResponse(last.status_code, last.headers, last.content, result)


def new_call() -> dict[str, str]:
    """Return the header that names one request, and no repetition of it."""
    return {CALL_HEADER: secrets.token_hex(16)}


def check_call(response: httpx.Response) -> None:
    """Raise ProtocolError for the answer to another request; an older daemon names none."""
    named = response.headers.get(CALL_HEADER)
    if named is not None and named != response.request.headers.get(CALL_HEADER):
        raise ProtocolError(
            "this is the answer to another request: share no connection between processes, and "
            "check proxies on the way"
        )


class Body:
    """A body that grows piece by piece, neither beyond its limit nor after the deadline.

    Raises:
        ProtocolError: it is longer than any answer, or compressed, which nobody asked for.
        RequestTimeoutError: the deadline is over.
    """

    def __init__(self, response: httpx.Response, deadline: float) -> None:
        self._response, self._deadline = response, deadline
        self._pieces: list[bytes] = []
        self._size = 0
        said = response.headers.get("content-length", "")
        if said.isascii() and said.isdigit() and len(said) < 20 and int(said) > MAX_ANSWER:
            raise self._too_long()
        if response.headers.get("content-encoding", "identity") != "identity":
            raise unreadable(response, "a compressed answer, which was not asked for")

    def add(self, piece: bytes) -> None:
        """Take the next piece."""
        self._pieces.append(piece)
        self._size += len(piece)
        if self._size > MAX_ANSWER:
            raise self._too_long()
        if time.monotonic() >= self._deadline:
            raise RequestTimeoutError(f"no whole answer from {self._response.url.host} in time")

    def received(self) -> Received:
        """Return the whole body."""
        response = self._response
        return Received(response.status_code, response.headers, b"".join(self._pieces))

    def _too_long(self) -> ProtocolError:
        return unreadable(self._response, f"an answer of more than {MAX_ANSWER >> 20} MiB")


class EventSize:
    """Size of one event of a stream, which must end within a limit."""

    def __init__(self) -> None:
        self._size = 0

    def ended(self) -> None:
        """Note the end of an event."""
        self._size = 0

    def checked(self, piece: bytes) -> bytes:
        """Return the next piece of a stream; raises ProtocolError for an event without an end."""
        self._size += len(piece)
        if self._size > MAX_EVENT:
            raise ProtocolError(f"the server sent an event of more than {MAX_EVENT >> 20} MiB")
        if piece.endswith((b"\n\n", b"\r\n\r\n")):
            self._size = 0  # a heartbeat is no event
        return piece


def read(kind: type[AnswerT], received: Received) -> AnswerT:
    """Return the model of an answer with its ``request_id``, or raise the error that it is."""
    if not 200 <= received.status_code < 300:
        raise error_of(received)
    try:
        if media_type(received) != NPY_MEDIA_TYPE:
            answer = kind.model_validate_json(received.content or b"{}")
        else:
            capture = Capture.from_npy(received.content, received.headers)
            if not isinstance(capture, kind):
                raise ValueError("only a capture comes as an array")
            answer = capture
        vars(answer)["_request_id"] = received.request_id
        return answer
    except ValueError as error:
        raise unreadable(received, f"an answer that is no {kind.__name__}") from error


def event_of(message: ServerSentEvent) -> Event:
    """Return the event in a message; raises ``ProtocolError``."""
    try:
        return EVENT.validate_json(message.data)
    except ValidationError as error:
        raise ProtocolError(
            f"the server sent a {message.event} event that this SDK cannot read: update veilcam"
        ) from error


def error_of(received: Received) -> VeilcamError:
    """Return the error that an answer is."""
    if media_type(received) == PROBLEM_MEDIA_TYPE:
        try:
            problem = Problem.model_validate_json(received.content)
        except ValidationError:
            return unreadable(received, "a problem that cannot be read")
        return problem.error(_retry_after(received))
    # A proxy on the way wants to know who asks, too.
    who = f" ({UNAUTHORIZED_HINT})" if received.status_code == httpx.codes.UNAUTHORIZED else ""
    return unreadable(received, f"HTTP {received.status_code} without problem details{who}")


def note(call: Call[AnswerT], received: Received, begun: float) -> None:
    """Write an answer to the log: neither what was sent nor what came."""
    log.debug(
        "%s %s: %d, request %r, %.1f ms",
        *(call.method, call.path.partition("?")[0], received.status_code, received.request_id),
        1e3 * (time.monotonic() - begun),
    )


def media_type(received: Received | httpx.Response) -> str:
    """Return the media type of an answer."""
    return received.headers.get("content-type", "").partition(";")[0]


def unreadable(response: Received | httpx.Response, what: str) -> ProtocolError:
    """Return the error for what is not this API's."""
    return ProtocolError(
        f"the server sent {what}: is this a veilcamd, of the same version?",
        status=response.status_code,
        request_id=response.headers.get("x-request-id"),
    )


def _retry_after(received: Received) -> float | None:
    # The daemon sends seconds; the date form (RFC 9110, 10.2.3) counts as not sent.
    value = received.headers.get("retry-after", "")
    return float(value) if value.isascii() and value.isdigit() else None
