"""Event streams for asyncio that are opened again until they are closed."""

from __future__ import annotations

import os
from collections.abc import AsyncGenerator
from contextlib import aclosing
from typing import Self

import httpx
from httpx_sse import EventSource

from veilcam_client.errors import ConnectError, VeilcamError
from veilcam_client.http.answers import (
    EventSize,
    error_of,
    event_of,
    media_type,
    new_call,
    unreadable,
)
from veilcam_client.http.async_ends import AsyncEnd
from veilcam_client.http.async_transport import AsyncTransport, async_whole_answer
from veilcam_client.http.deadline import CAMERA_TIMEOUT
from veilcam_client.http.resumption import Resumption, check_stream
from veilcam_client.wire.events import EVENT_KINDS, Event


class AsyncEventStream:
    """Events as they happen, for ever: close it, or use it as a context, to end it.

    A stream that breaks is opened again after the last event, at growing pauses; a ``Gap`` among
    the events says that some were missed. An error that no waiting puts right is raised.

    Args:
        transport: transport of the camera.
        last_event_id: id of the event to go on after; None: from now on.
        reconnect: True: a broken stream is opened again.
    """

    def __init__(
        self, transport: AsyncTransport, last_event_id: str | None, reconnect: bool
    ) -> None:
        check_stream(last_event_id, reconnect)
        self._transport = transport
        self._resumption = Resumption(transport.options, last_event_id, reconnect)
        self._before_fork: list[object] = []
        self._closed = False
        self._begin()

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    def __aiter__(self) -> Self:
        return self

    async def __anext__(self) -> Event:
        self._leave_parent()
        if not self._closed:
            async with self._end.listening():
                return await anext(self._events)
        raise StopAsyncIteration

    async def close(self) -> None:
        """End the stream, also while another thread or task waits for an event."""
        self._leave_parent()
        self._closed = True
        await self._end.set(self._events)

    def _begin(self) -> None:
        self._process = os.getpid()
        self._end = AsyncEnd()
        self._events = _follow(self._transport, self._resumption, self._end)

    def _leave_parent(self) -> None:
        """After a fork, go on over a connection of this process."""
        if self._process != os.getpid():
            # Kept: to let go of it would end a connection of the parent, whose locks may be held.
            self._before_fork += [self._events, self._end]
            self._begin()


# Functions, not methods: a stream that is let go of is closed at once, by no collector of garbage
# that may run while a lock of the connections is held.
async def _follow(
    transport: AsyncTransport, resumption: Resumption, end: AsyncEnd
) -> AsyncGenerator[Event, None]:
    while True:
        try:
            async with aclosing(_connect(transport, resumption, end)) as events:
                async for event in events:
                    for told in resumption.heard(event):
                        yield told
        except VeilcamError as error:
            if end.is_set():
                return
            pause = resumption.pause(error)
        if await end.sleep(pause):
            return


async def _connect(
    transport: AsyncTransport, resumption: Resumption, end: AsyncEnd
) -> AsyncGenerator[Event, None]:
    options = transport.options
    with options.translate():
        async with transport.client.stream(
            "GET",
            f"{options.base}/v1/events",
            headers={**resumption.headers(), **new_call()},
            timeout=options.limits(stream=True),
        ) as response:
            transport.check(response)
            if response.status_code != httpx.codes.OK:
                raise error_of(await async_whole_answer(response, options.until(CAMERA_TIMEOUT)))
            if media_type(response) != "text/event-stream":
                raise unreadable(response, "no event stream")
            with end.reach(response):
                for gap in resumption.opened():
                    yield gap
                size = EventSize()
                bounded = httpx.Response(
                    response.status_code,
                    headers={"Content-Type": "text/event-stream; charset=utf-8"},
                    content=_bounded(response, size),
                )
                async for message in EventSource(bounded).aiter_sse():
                    size.ended()
                    if message.event in EVENT_KINDS and message.data:
                        yield event_of(message)
    # Ended without an error: the daemon stops, or restarts.
    raise ConnectError(f"{options.url} ended the stream")


async def _bounded(response: httpx.Response, size: EventSize) -> AsyncGenerator[bytes, None]:
    async for piece in response.aiter_bytes():
        yield size.checked(piece)
