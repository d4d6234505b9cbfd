"""Event streams for asyncio, as ``streams.py`` opens them."""

from __future__ import annotations

import asyncio
import os
from collections.abc import AsyncGenerator
from contextlib import aclosing
from types import TracebackType
from typing import Self

import httpx

from veilcam_client.errors import ConnectError, VeilcamError
from veilcam_client.http.answers import Body, check_call, error_of, event_of, new_call
from veilcam_client.http.async_transport import AsyncTransport
from veilcam_client.http.deadline import CAMERA_TIMEOUT
from veilcam_client.http.resumption import Resumption, check_stream
from veilcam_client.http.sse import Decoder
from veilcam_client.wire.events import EVENT_KINDS, Event


class AsyncEventStream:
    """:class:`EventStream` for asyncio: another task may close it while one waits for an event."""

    def __init__(
        self, transport: AsyncTransport, last_event_id: str | None, reconnect: bool
    ) -> None:
        check_stream(last_event_id, reconnect)
        self._transport = transport
        self._closed = False
        self._waiting: asyncio.Timeout | None = None
        self._resumption = Resumption(transport.options, last_event_id, reconnect)
        self._before_fork: list[object] = []
        self._begin()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self.close()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Event:
        self._leave_parent()
        if self._closed:
            raise StopAsyncIteration
        try:
            async with asyncio.timeout(None) as self._waiting:
                return await anext(self._events)
        except TimeoutError:
            # Nothing but close() sets a time.
            raise StopAsyncIteration from None
        finally:
            self._waiting = None

    async def close(self) -> None:
        """End the stream, also while another task waits for an event."""
        self._leave_parent()
        self._closed = True
        if self._waiting is None:
            await self._events.aclose()
        else:
            self._waiting.reschedule(asyncio.get_running_loop().time())

    def _begin(self) -> None:
        self._process = os.getpid()
        self._events = self._follow(self._resumption)

    def _leave_parent(self) -> None:
        """After a fork, go on over a connection of this process."""
        if self._process != os.getpid():
            # Kept, as :class:`EventStream` does.
            self._before_fork.append(self._events)
            self._waiting = None
            self._begin()

    async def _follow(self, resumption: Resumption) -> AsyncGenerator[Event, None]:
        while True:
            try:
                async with aclosing(self._connect(resumption)) as events:
                    async for event in events:
                        resumption.heard(event)
                        yield event
            except VeilcamError as error:
                pause = resumption.pause(error)
            await asyncio.sleep(pause)

    async def _connect(self, resumption: Resumption) -> AsyncGenerator[Event, None]:
        options, decoder = self._transport.options, Decoder()
        with options.translate():
            async with self._transport.client.stream(
                "GET",
                f"{options.base}/v1/events",
                headers={**resumption.headers(), **new_call()},
                timeout=options.limits(stream=True),
            ) as response:
                check_call(response)
                if response.status_code != httpx.codes.OK:
                    body = Body(response, options.until(CAMERA_TIMEOUT))
                    async for piece in response.aiter_bytes():
                        body.add(piece)
                    raise error_of(body.received())
                for gap in resumption.opened():
                    yield gap
                async for piece in response.aiter_bytes():
                    for message in decoder.feed(piece):
                        if message.event in EVENT_KINDS:
                            yield event_of(message)
        raise ConnectError(f"{options.url} ended the stream")
