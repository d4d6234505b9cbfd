"""Requests of a camera for asyncio, as ``transport.py`` sends them."""

from __future__ import annotations

import asyncio
import copy
import math
import time
from collections.abc import Mapping
from typing import Self, TypeVar

import httpx
from pydantic import BaseModel

from veilcam_client.arguments import of_type
from veilcam_client.errors import VeilcamError
from veilcam_client.http.answers import Body, Received, check_call, new_call, read
from veilcam_client.http.calls import Call
from veilcam_client.http.clients import ClientHolder
from veilcam_client.http.deadline import CAMERA_TIMEOUT, CallTimeout
from veilcam_client.http.options import Attempts, Options
from veilcam_client.http.transport import headers_of, note, trusted

AsyncHttpClient = httpx.AsyncClient
AnswerT = TypeVar("AnswerT", bound=BaseModel)


class AsyncTransport:
    """Sends calls with ``httpx.AsyncClient``."""

    def __init__(self, options: Options, client: AsyncHttpClient | None = None) -> None:
        if client is not None:
            of_type("http_client", client, httpx.AsyncClient, "an httpx.AsyncClient")
        self.options: Options = options
        self.last: Received | None = None
        """As of ``Transport``."""
        self._holder = ClientHolder(client, lambda: _own_client(options), asyncio.get_running_loop)

    @property
    def client(self) -> AsyncHttpClient:
        """Client of this process and event loop; raises ArgumentError where it is closed."""
        return self._holder.client()

    def for_one_caller(self) -> Self:
        """Return a view of this one that keeps the last answer."""
        return copy.copy(self)

    async def send(
        self,
        call: Call[AnswerT],
        timeout: CallTimeout = CAMERA_TIMEOUT,
        *,
        wait: float | None = None,
    ) -> AnswerT:
        """Send, retry as the policy says, and return the answer."""
        attempts, headers = Attempts(self.options, timeout, wait), headers_of(call, self.options)
        while True:
            try:
                received = await self._ask(call, headers, attempts.deadline)
                answer = read(call.answer, received)
            except VeilcamError as error:
                pause = attempts.pause(error)
            else:
                self.last = received
                return answer
            await asyncio.sleep(pause)

    async def _ask(
        self, call: Call[AnswerT], headers: Mapping[str, str], deadline: float
    ) -> Received:
        options, begun = self.options, time.monotonic()
        left = None if math.isinf(deadline) else max(0.0, deadline - begun)
        with options.translate():
            async with (
                asyncio.timeout(left),
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
                async for piece in response.aiter_bytes():
                    body.add(piece)
        received = body.received()
        note(call, received, begun)
        return received

    async def close(self) -> None:
        """Close the connections of this process and loop, unless the client was handed in."""
        client = self._holder.close()
        if client is not None:
            await client.aclose()


def _own_client(options: Options) -> httpx.AsyncClient:
    from veilcam_client.http.async_sockets import PiecemealTransport  # noqa: PLC0415 - as there

    return httpx.AsyncClient(
        transport=PiecemealTransport(trusted(options), options.socket), trust_env=False
    )
