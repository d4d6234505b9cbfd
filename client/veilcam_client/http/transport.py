"""HTTP: the one module that knows httpx. Sends calls, retries them, reads event streams."""

import asyncio
import random
import time
from collections.abc import AsyncIterator, Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TypeVar
from urllib.parse import urlsplit

import httpx
from pydantic import BaseModel, ValidationError

from veilcam_client.errors import (
    ConnectError,
    ProtocolError,
    RequestTimeoutError,
    VeilcamError,
)
from veilcam_client.http.calls import Call
from veilcam_client.http.credentials import Credentials
from veilcam_client.http.sse import Decoder, Message
from veilcam_client.wire.events import EVENT, EVENT_KINDS, Event
from veilcam_client.wire.problems import PROBLEM_MEDIA_TYPE, Problem


@dataclass(frozen=True, slots=True)
class RetryPolicy:
    """Wait ``uniform(0, min(cap, base 2^attempt))`` [s], plus the server's Retry-After.

    Full jitter spreads clients that failed together (Brooker, "Exponential backoff and jitter",
    2015). A Retry-After longer than ``patience`` [s] is not waited for: the error is raised.
    """

    retries: int = 2
    base: float = 0.25
    cap: float = 4.0
    patience: float = 30.0
    uniform: Callable[[float, float], float] = field(
        default=random.SystemRandom().uniform, repr=False
    )

    def delay(self, attempt: int, error: VeilcamError) -> float:
        """Seconds to wait after failure number ``attempt`` (from 0), or raise it to give up."""
        asked = error.retry_after or 0.0
        if not error.retryable or attempt >= self.retries or asked > self.patience:
            raise error
        return asked + self.uniform(0.0, min(self.cap, self.base * 2.0**attempt))


HttpClient = httpx.Client
AsyncHttpClient = httpx.AsyncClient
AnswerT = TypeVar("AnswerT", bound=BaseModel)

STREAM_SILENCE = 45.0
"""An event stream without even a heartbeat for this long is dead [s]."""


@dataclass(frozen=True, slots=True)
class Options:
    """Where the daemon is, how long to wait for it, and who asks."""

    url: str
    connect_timeout: float
    read_timeout: float
    retry: RetryPolicy
    credentials: Credentials
    base: str = field(init=False)
    socket: str | None = field(init=False)

    def __post_init__(self) -> None:
        parts = urlsplit(self.url)
        if parts.scheme == "unix" and parts.path and not parts.netloc:
            base, socket = "http://localhost", parts.path
        elif parts.scheme in ("http", "https") and parts.hostname:
            base, socket = self.url.rstrip("/"), None
        else:
            raise ValueError(
                f"url = {self.url!r} is not valid: use http://HOST:PORT or unix:///PATH/TO/SOCKET"
            )
        for name in ("connect_timeout", "read_timeout"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} = {getattr(self, name)} s is not valid: use > 0")
        self.credentials.require_safe(self.url)
        object.__setattr__(self, "base", base)
        object.__setattr__(self, "socket", socket)

    def timeout(self, *, stream: bool = False) -> httpx.Timeout:
        """Limits of one request."""
        read = STREAM_SILENCE if stream else self.read_timeout
        return httpx.Timeout(read, connect=self.connect_timeout)

    @contextmanager
    def translate(self) -> Iterator[None]:
        """Turn what httpx raises into this SDK's errors."""
        try:
            yield
        except httpx.TimeoutException as error:
            kind = "connection" if isinstance(error, httpx.ConnectTimeout) else "answer"
            raise RequestTimeoutError(f"no {kind} from {self.url} in time") from error
        except httpx.RequestError as error:
            reason = str(error) or type(error).__name__
            raise ConnectError(
                f"cannot reach {self.url}: {reason} (is veilcamd running there?)"
            ) from error


class Transport:
    """Sends calls with ``httpx.Client``."""

    def __init__(
        self,
        options: Options,
        client: HttpClient | None = None,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.options = options
        self._sleep = sleep
        self._owned = client is None
        # trust_env off: a proxy meant for the web must not see a camera on this machine.
        self._client = client or httpx.Client(
            transport=httpx.HTTPTransport(uds=options.socket, verify=options.credentials.trusted()),
            trust_env=False,
        )

    def send(self, call: Call[AnswerT]) -> AnswerT:
        """Send, retry as the policy says, and return the answer."""
        attempt, headers = 0, self.options.credentials.headers(call.headers())
        while True:
            try:
                with self.options.translate():
                    response = self._client.request(
                        call.method,
                        self.options.base + call.path,
                        content=call.content(),
                        headers=headers,
                        timeout=self.options.timeout(),
                    )
                return _read(call.answer, response)
            except VeilcamError as error:
                delay = self.options.retry.delay(attempt, error)
            self._sleep(delay)
            attempt += 1

    def events(self, last_event_id: str | None) -> Iterator[Event]:
        """Yield events for ever, going on after the last one seen when the stream breaks."""
        attempt = 0
        while True:
            try:
                for event in self._stream(last_event_id):
                    attempt, last_event_id = 0, event.id
                    yield event
            except VeilcamError as error:
                delay = self.options.retry.delay(attempt, error)
            self._sleep(delay)
            attempt += 1

    def _stream(self, last_event_id: str | None) -> Iterator[Event]:
        decoder = Decoder()
        with (
            self.options.translate(),
            self._client.stream(
                "GET",
                f"{self.options.base}/v1/events",
                headers=self.options.credentials.headers(_stream_headers(last_event_id)),
                timeout=self.options.timeout(stream=True),
            ) as response,
        ):
            if response.status_code != httpx.codes.OK:
                response.read()
                raise _error(response)
            for chunk in response.iter_bytes():
                for message in decoder.feed(chunk):
                    if message.event in EVENT_KINDS:
                        yield _event(message)
        # Ended without an error: the daemon stops, or restarts.
        raise ConnectError(f"{self.options.url} ended the stream")

    def close(self) -> None:
        """Close the connections, unless the client was handed in."""
        if self._owned:
            self._client.close()


class AsyncTransport:
    """Sends calls with ``httpx.AsyncClient``."""

    def __init__(self, options: Options, client: AsyncHttpClient | None = None) -> None:
        self.options = options
        self._owned = client is None
        self._client = client or httpx.AsyncClient(
            transport=httpx.AsyncHTTPTransport(
                uds=options.socket, verify=options.credentials.trusted()
            ),
            trust_env=False,
        )

    async def send(self, call: Call[AnswerT]) -> AnswerT:
        """Send, retry as the policy says, and return the answer."""
        attempt, headers = 0, self.options.credentials.headers(call.headers())
        while True:
            try:
                with self.options.translate():
                    response = await self._client.request(
                        call.method,
                        self.options.base + call.path,
                        content=call.content(),
                        headers=headers,
                        timeout=self.options.timeout(),
                    )
                return _read(call.answer, response)
            except VeilcamError as error:
                delay = self.options.retry.delay(attempt, error)
            await asyncio.sleep(delay)
            attempt += 1

    async def events(self, last_event_id: str | None) -> AsyncIterator[Event]:
        """Yield events for ever, going on after the last one seen when the stream breaks."""
        attempt = 0
        while True:
            try:
                async for event in self._stream(last_event_id):
                    attempt, last_event_id = 0, event.id
                    yield event
            except VeilcamError as error:
                delay = self.options.retry.delay(attempt, error)
            await asyncio.sleep(delay)
            attempt += 1

    async def _stream(self, last_event_id: str | None) -> AsyncIterator[Event]:
        decoder = Decoder()
        with self.options.translate():
            async with self._client.stream(
                "GET",
                f"{self.options.base}/v1/events",
                headers=self.options.credentials.headers(_stream_headers(last_event_id)),
                timeout=self.options.timeout(stream=True),
            ) as response:
                if response.status_code != httpx.codes.OK:
                    await response.aread()
                    raise _error(response)
                async for chunk in response.aiter_bytes():
                    for message in decoder.feed(chunk):
                        if message.event in EVENT_KINDS:
                            yield _event(message)
        raise ConnectError(f"{self.options.url} ended the stream")

    async def close(self) -> None:
        """Close the connections, unless the client was handed in."""
        if self._owned:
            await self._client.aclose()


def _stream_headers(last_event_id: str | None) -> dict[str, str]:
    headers: Mapping[str, str] = {} if last_event_id is None else {"Last-Event-ID": last_event_id}
    return {"Accept": "text/event-stream", **headers}


def _read(answer: type[AnswerT], response: httpx.Response) -> AnswerT:
    if not response.is_success:
        raise _error(response)
    try:
        return answer.model_validate_json(response.content or b"{}")
    except ValidationError as error:
        raise _unreadable(response, f"an answer that is no {answer.__name__}") from error


def _event(message: Message) -> Event:
    try:
        return EVENT.validate_json(message.data)
    except ValidationError as error:
        raise ProtocolError(
            f"the server sent a {message.event} event that this SDK cannot read: update veilcam"
        ) from error


def _error(response: httpx.Response) -> VeilcamError:
    media_type = response.headers.get("content-type", "").partition(";")[0]
    if media_type == PROBLEM_MEDIA_TYPE:
        try:
            problem = Problem.model_validate_json(response.content)
        except ValidationError:
            return _unreadable(response, "a problem that cannot be read")
        return problem.error(_retry_after(response))
    return _unreadable(response, f"HTTP {response.status_code} without problem details")


def _unreadable(response: httpx.Response, what: str) -> ProtocolError:
    return ProtocolError(
        f"the server sent {what}: is this a veilcamd, of the same version?",
        status=response.status_code,
        request_id=response.headers.get("x-request-id"),
    )


def _retry_after(response: httpx.Response) -> float | None:
    # The daemon sends seconds; the date form (RFC 9110, 10.2.3) counts as not sent.
    value = response.headers.get("retry-after", "")
    return float(value) if value.isascii() and value.isdigit() else None
