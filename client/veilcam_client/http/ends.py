"""End of an event stream, set by another thread while one waits for an event."""

from __future__ import annotations

import socket
import threading
from collections.abc import Generator, Iterator
from contextlib import contextmanager, suppress

import httpx


class End:
    """End of a stream that another thread may close."""

    def __init__(self) -> None:
        self._set = threading.Event()
        self._wire: socket.socket | None = None

    def is_set(self) -> bool:
        """Return whether the stream is closed."""
        return self._set.is_set()

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Wait for an event within the context."""
        yield

    @contextmanager
    def reach(self, response: httpx.Response) -> Iterator[None]:
        """Let :meth:`set` end the wait for the next piece of an answer."""
        stream = response.extensions.get("network_stream")
        self._wire = None if stream is None else stream.get_extra_info("socket")
        try:
            if self._set.is_set():
                self._hang_up()
            yield
        finally:
            self._wire = None

    def sleep(self, seconds: float) -> bool:
        """Pause [s]; return whether the stream was closed meanwhile."""
        return self._set.wait(seconds)

    def set(self, events: Generator[object, None, None]) -> None:
        """Close the stream."""
        self._set.set()
        self._hang_up()
        # One that another thread is within ends by itself.
        with suppress(ValueError):
            events.close()

    def _hang_up(self) -> None:
        wire = self._wire
        if wire is not None:
            with suppress(OSError):  # the daemon was faster
                wire.shutdown(socket.SHUT_RDWR)
