"""End of an event stream of asyncio, as ``ends.py`` has it for threads."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager

import httpx


class AsyncEnd:
    """End of a stream of asyncio."""

    def __init__(self) -> None:
        self._set = False
        self._waiting: asyncio.Timeout | None = None

    def is_set(self) -> bool:
        """Return whether the stream is closed."""
        return self._set

    @asynccontextmanager
    async def listening(self) -> AsyncIterator[None]:
        """Wait for an event within the context, which ends when the stream is closed."""
        try:
            async with asyncio.timeout(None) as self._waiting:
                yield
        except TimeoutError:
            pass  # nothing but set() gives it a time
        finally:
            self._waiting = None

    @contextmanager
    def reach(self, response: httpx.Response) -> Iterator[None]:  # noqa: ARG002 - asyncio reaches it
        """Let :meth:`set` end the wait for the next piece of an answer."""
        yield

    async def sleep(self, seconds: float) -> bool:
        """Pause [s]; return whether the stream was closed meanwhile."""
        await asyncio.sleep(seconds)
        return self._set

    async def set(self, events: AsyncGenerator[object, None]) -> None:
        """Close the stream."""
        self._set = True
        if self._waiting is None:
            await events.aclose()
        else:
            self._waiting.reschedule(asyncio.get_running_loop().time())
