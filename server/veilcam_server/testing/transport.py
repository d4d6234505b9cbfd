"""Transports of httpx that lead into an application in this process, event streams included."""

from __future__ import annotations

import asyncio
import queue
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import suppress
from typing import TypeAlias

import anyio
import httpx
from anyio.from_thread import BlockingPortal
from starlette.types import ASGIApp, Message

Said: TypeAlias = Message | BaseException | None
"""By the application: a message, what it failed with, or that it is done."""


class Door:
    """Way into an application that lives on the event loop of another thread."""

    def __init__(self, app: ASGIApp, portal: BlockingPortal) -> None:
        self.app, self._portal = app, portal

    def enter(self, request: httpx.Request, body: bytes, hear: Callable[[Said], None]) -> Visit:
        """Ask the application; ``hear`` is told on its loop what it says."""
        visit = Visit(self.app, request, body, hear)
        self._portal.start_task_soon(visit.run)
        return visit

    def leave(self, visit: Visit) -> None:
        """Tell the application that nobody listens any more."""
        # It may have been switched off before.
        with suppress(RuntimeError):
            self._portal.start_task_soon(visit.leave)


class Visit:
    """One request."""

    def __init__(
        self, app: ASGIApp, request: httpx.Request, body: bytes, hear: Callable[[Said], None]
    ) -> None:
        self._app, self._request, self._hear = app, request, hear
        self._body: bytes | None = body
        self._left = anyio.Event()

    async def run(self) -> None:
        """Let the application answer."""
        failed: Said = None
        try:
            await self._app(self._scope(), self._receive, self._send)
        except Exception as error:  # raised where somebody waits
            failed = error
        self._hear(failed)

    async def leave(self) -> None:
        """Hang up."""
        self._left.set()

    async def _receive(self) -> Message:
        if self._body is not None:
            body, self._body = self._body, None
            return {"type": "http.request", "body": body, "more_body": False}
        await self._left.wait()
        return {"type": "http.disconnect"}

    async def _send(self, message: Message) -> None:
        self._hear(message)

    def _scope(self) -> dict[str, object]:
        url = self._request.url
        return {
            "type": "http",
            "asgi": {"version": "3.0"},
            "http_version": "1.1",
            "method": self._request.method,
            "scheme": url.scheme,
            "path": url.path,
            "raw_path": url.raw_path.partition(b"?")[0],
            "root_path": "",
            "query_string": url.query,
            "headers": [(name.lower(), value) for name, value in self._request.headers.raw],
            "client": ("127.0.0.1", 1),
            "server": (url.host, url.port or 80),
            "state": {},
        }


class AppTransport(httpx.BaseTransport):
    """For ``httpx.Client``."""

    def __init__(self, door: Door) -> None:
        self._door = door

    def handle_request(self, request: httpx.Request) -> httpx.Response:
        """Return the answer as soon as its headers are there."""
        said: queue.SimpleQueue[Said] = queue.SimpleQueue()
        visit = self._door.enter(request, request.read(), said.put)
        stream = _Stream(self._door, visit, said, _patience(request))
        return _response(stream.next(), stream)


class _Stream(httpx.SyncByteStream):
    def __init__(
        self, door: Door, visit: Visit, said: queue.SimpleQueue[Said], patience: float | None
    ) -> None:
        self._door, self._visit, self._said, self._patience = door, visit, said, patience

    def next(self) -> Message | None:
        """Return the application's next message; None: no more."""
        try:
            return _heard(self._said.get(timeout=self._patience))
        except queue.Empty:
            self.close()
            raise httpx.ReadTimeout("the application says nothing") from None

    def __iter__(self) -> Iterator[bytes]:
        while (message := self.next()) is not None:
            yield message.get("body", b"")

    def close(self) -> None:
        self._door.leave(self._visit)


class AsyncAppTransport(httpx.AsyncBaseTransport):
    """For ``httpx.AsyncClient``, on whatever event loop."""

    def __init__(self, door: Door) -> None:
        self._door = door

    async def handle_async_request(self, request: httpx.Request) -> httpx.Response:
        """Return the answer as soon as its headers are there."""
        said: asyncio.Queue[Said] = asyncio.Queue()
        loop = asyncio.get_running_loop()

        def hear(message: Said) -> None:
            # Whoever asked may be gone, and its loop with it.
            with suppress(RuntimeError):
                loop.call_soon_threadsafe(said.put_nowait, message)

        visit = self._door.enter(request, await request.aread(), hear)
        stream = _AsyncStream(self._door, visit, said, _patience(request))
        try:
            first = await stream.next()
        except BaseException:
            await stream.aclose()
            raise
        return _response(first, stream)


class _AsyncStream(httpx.AsyncByteStream):
    def __init__(
        self, door: Door, visit: Visit, said: asyncio.Queue[Said], patience: float | None
    ) -> None:
        self._door, self._visit, self._said, self._patience = door, visit, said, patience

    async def next(self) -> Message | None:
        """Return the application's next message; None: no more."""
        try:
            async with asyncio.timeout(self._patience):
                return _heard(await self._said.get())
        except TimeoutError:
            raise httpx.ReadTimeout("the application says nothing") from None

    async def __aiter__(self) -> AsyncIterator[bytes]:
        while (message := await self.next()) is not None:
            yield message.get("body", b"")

    async def aclose(self) -> None:
        self._door.leave(self._visit)


def _patience(request: httpx.Request) -> float | None:
    """Return the caller's time-out for the next piece [s]."""
    patience: float | None = request.extensions.get("timeout", {}).get("read")
    return patience


def _heard(said: Said) -> Message | None:
    if isinstance(said, BaseException):
        raise said
    return said


def _response(start: Message | None, stream: _Stream | _AsyncStream) -> httpx.Response:
    if start is None:
        raise httpx.RemoteProtocolError("the application answered nothing")
    return httpx.Response(start["status"], headers=start["headers"], stream=stream)
