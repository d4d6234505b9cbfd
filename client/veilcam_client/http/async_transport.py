"""Requests of a camera for asyncio: sent, repeated where that may help, and read within limits."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from typing import TypeVar

import httpx
from pydantic import BaseModel

from veilcam_client.arguments import of_type
from veilcam_client.errors import ArgumentError, VeilcamError
from veilcam_client.http.answers import Body, Received, check_call, keep, new_call, note, read
from veilcam_client.http.calls import Call
from veilcam_client.http.clients import ClientHolder, async_own_client, async_place
from veilcam_client.http.deadline import CAMERA_TIMEOUT, CallTimeout, async_within
from veilcam_client.http.options import Attempts, Options
from veilcam_client.wire.base import RUN_HEADER

AsyncHttpClient = httpx.AsyncClient
AnswerT = TypeVar("AnswerT", bound=BaseModel)


class AsyncTransport:
    """Sends calls with ``httpx.AsyncClient``."""

    def __init__(self, options: Options, client: httpx.AsyncClient | None = None) -> None:
        if client is not None:
            of_type("http_client", client, httpx.AsyncClient, "an httpx.AsyncClient")
            if options.credentials.certificate is not None:
                raise ArgumentError(
                    "http_client checks no certificate of a profile: give no client"
                )
        self.options: Options = options
        self._run: str | None = None
        self._holder = ClientHolder(client, lambda: async_own_client(options), async_place)

    @property
    def client(self) -> httpx.AsyncClient:
        """Client of this process and event loop; raises ArgumentError where it is closed."""
        return self._holder.client()

    async def send(
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
        attempts = Attempts(self.options, timeout, wait)
        headers = self.options.headers(call.headers())
        while True:
            try:
                run = attempts.run_header(self._run) if call.once else {}
                received = await self._ask(call, {**headers, **run}, attempts.deadline)
                answer = read(call.answer, received)
            except VeilcamError as error:
                pause = attempts.pause(error)
            else:
                keep(received)
                return answer
            await asyncio.sleep(pause)

    async def _ask(
        self, call: Call[AnswerT], headers: Mapping[str, str], deadline: float
    ) -> Received:
        options, begun = self.options, time.monotonic()
        with options.translate():
            async with (
                async_within(deadline),
                self.client.stream(
                    call.method,
                    options.base + call.path,
                    content=call.content(),
                    headers={**headers, **new_call()},
                    timeout=options.limits(deadline),
                ) as response,
            ):
                self.check(response)
                received = await async_whole_answer(response, deadline)
        note(call, received, begun)
        return received

    def check(self, response: httpx.Response) -> None:
        """Note the run of the daemon that answers; raises as :func:`check_call`."""
        check_call(response)
        run = response.headers.get(RUN_HEADER, "")
        if run and run.isascii():
            self._run = run

    async def close(self) -> None:
        """Close the connections of this process, unless the client was handed in."""
        client = self._holder.close()
        if client is not None:
            await client.aclose()


async def async_whole_answer(response: httpx.Response, deadline: float) -> Received:
    """Return an answer with its whole body, within its limits."""
    body = Body(response, deadline)
    async for piece in response.aiter_bytes():
        body.add(piece)
    return body.received()
