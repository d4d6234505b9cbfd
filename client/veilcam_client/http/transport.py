"""Requests of a camera: sent, repeated where that may help, and read within limits."""

from __future__ import annotations

import copy
import ssl
import time
from collections.abc import Callable, Mapping
from typing import Self, TypeVar
from urllib.parse import urlsplit

import httpx
from pydantic import BaseModel

from veilcam_client.arguments import of_type
from veilcam_client.errors import VeilcamError
from veilcam_client.http.answers import Body, Received, check_call, new_call, read
from veilcam_client.http.calls import Call
from veilcam_client.http.clients import ClientHolder
from veilcam_client.http.deadline import CAMERA_TIMEOUT, CallTimeout
from veilcam_client.http.options import Attempts, Options, log

HttpClient = httpx.Client
AnswerT = TypeVar("AnswerT", bound=BaseModel)


class Transport:
    """Sends calls with ``httpx.Client``."""

    def __init__(
        self,
        options: Options,
        client: HttpClient | None = None,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        if client is not None:
            of_type("http_client", client, httpx.Client, "an httpx.Client")
        self.options: Options = options
        self.last: Received | None = None
        """Answer of the last call that went well, where this is kept for one caller alone."""
        self._sleep = sleep
        self._holder = ClientHolder(client, lambda: _own_client(options), lambda: None)

    @property
    def client(self) -> HttpClient:
        """Client of this process; raises ArgumentError where the camera is closed."""
        return self._holder.client()

    def for_one_caller(self) -> Self:
        """Return a view of this one that keeps the last answer."""
        return copy.copy(self)

    def send(
        self,
        call: Call[AnswerT],
        timeout: CallTimeout = CAMERA_TIMEOUT,
        *,
        wait: float | None = None,
    ) -> AnswerT:
        """Send, retry as the policy says, and return the answer.

        Args:
            call: call to send.
            timeout: time-out of the answer, repetitions and the pauses before them included [s].
            wait: wait for another's lease to end, before that [s]; None: ``LeasedError`` at once.
        """
        attempts, headers = Attempts(self.options, timeout, wait), headers_of(call, self.options)
        while True:
            try:
                received = self._ask(call, headers, attempts.deadline)
                answer = read(call.answer, received)
            except VeilcamError as error:
                pause = attempts.pause(error)
            else:
                self.last = received
                return answer
            self._sleep(pause)

    def _ask(self, call: Call[AnswerT], headers: Mapping[str, str], deadline: float) -> Received:
        options, begun = self.options, time.monotonic()
        with (
            options.translate(),
            self.client.stream(
                call.method,
                options.base + call.path,
                content=call.content(),
                headers={**headers, **new_call()},
                timeout=options.limits(deadline),
            ) as response,
        ):
            check_call(response)
            body = Body(response, deadline)
            for piece in response.iter_bytes():
                body.add(piece)
        received = body.received()
        note(call, received, begun)
        return received

    def close(self) -> None:
        """Close the connections of this process, unless the client was handed in."""
        client = self._holder.close()
        if client is not None:
            client.close()


def _own_client(options: Options) -> httpx.Client:
    # Late, as httpx does it: half of what an HTTP client loads is for its sockets.
    from veilcam_client.http.sockets import DeadlineTransport  # noqa: PLC0415

    # trust_env off: a proxy meant for the web must not see a camera on this machine.
    return httpx.Client(
        transport=DeadlineTransport(trusted(options), options.socket), trust_env=False
    )


def headers_of(call: Call[AnswerT], options: Options) -> dict[str, str]:
    """Headers of a request and of all its repetitions."""
    return options.headers(call.headers())


def note(call: Call[AnswerT], received: Received, begun: float) -> None:
    """Write an answer to the log: neither what was sent nor what came."""
    log.debug(
        "%s %s: %d, request %r, %.1f ms",
        *(call.method, call.path.partition("?")[0], received.status_code, received.request_id),
        1e3 * (time.monotonic() - begun),
    )


def trusted(options: Options) -> ssl.SSLContext:
    """Return the trust of TLS; none, and at no cost, for plain HTTP."""
    if urlsplit(options.base).scheme != "https" and options.credentials.ca_file is None:
        return ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    return httpx.create_ssl_context(verify=options.credentials.trusted())
