"""Event streams that are opened again until they are closed."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager, suppress
from functools import partial
from types import TracebackType
from typing import Self

import httpx

from veilcam_client.errors import ConnectError, VeilcamError
from veilcam_client.http.answers import Body, check_call, error_of, event_of, new_call
from veilcam_client.http.deadline import CAMERA_TIMEOUT
from veilcam_client.http.resumption import Resumption, check_stream
from veilcam_client.http.sse import Decoder
from veilcam_client.http.transport import Transport
from veilcam_client.wire.events import EVENT_KINDS, Event


class EventStream:
    """Events as they happen, for ever: close it, or use it as a context, to end it.

    A stream that breaks is opened again after the last event, at growing pauses; a ``Gap`` among
    the events says that some were missed. An error that no waiting puts right is raised.

    Args:
        transport: transport of the camera.
        last_event_id: id of the event to go on after; None: from now on.
        reconnect: True: a broken stream is opened again.
    """

    def __init__(self, transport: Transport, last_event_id: str | None, reconnect: bool) -> None:
        check_stream(last_event_id, reconnect)
        self._transport = transport
        self._resumption = Resumption(transport.options, last_event_id, reconnect)
        self._before_fork: list[object] = []
        self._begin()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Event:
        self._leave_parent()
        if self._closed.is_set():
            raise StopIteration
        return next(self._events)

    def close(self) -> None:
        """End the stream; from whatever thread, also while another waits for an event."""
        self._leave_parent()
        self._closed.set()
        self._hang_up()
        # One that another thread is within ends by itself.
        with suppress(ValueError):
            self._events.close()

    def _begin(self) -> None:
        self._process = os.getpid()
        self._closed = threading.Event()
        self._hang_up: Callable[[], None] = _nothing
        self._events = self._follow(self._resumption)

    def _leave_parent(self) -> None:
        """After a fork, go on over a connection of this process."""
        if self._process != os.getpid():
            closed = self._closed.is_set()
            # Kept: to let go of it would end a connection of the parent, whose locks may be held.
            self._before_fork.append(self._events)
            self._begin()
            if closed:
                self._closed.set()

    def _follow(self, resumption: Resumption) -> Generator[Event, None, None]:
        while True:
            try:
                with closing(self._connect(resumption)) as events:
                    for event in events:
                        resumption.heard(event)
                        yield event
            except VeilcamError as error:
                if self._closed.is_set():
                    return
                pause = resumption.pause(error)
            if self._closed.wait(pause):
                return

    def _connect(self, resumption: Resumption) -> Generator[Event, None, None]:
        options, decoder = self._transport.options, Decoder()
        with (
            options.translate(),
            self._transport.client.stream(
                "GET",
                f"{options.base}/v1/events",
                headers={**resumption.headers(), **new_call()},
                timeout=options.limits(stream=True),
            ) as response,
        ):
            check_call(response)
            if response.status_code != httpx.codes.OK:
                body = Body(response, options.until(CAMERA_TIMEOUT))
                for piece in response.iter_bytes():
                    body.add(piece)
                raise error_of(body.received())
            with self._reachable(response):
                yield from resumption.opened()
                for piece in response.iter_bytes():
                    for message in decoder.feed(piece):
                        if message.event in EVENT_KINDS:
                            yield event_of(message)
        # Ended without an error: the daemon stops, or restarts.
        raise ConnectError(f"{options.url} ended the stream")

    @contextmanager
    def _reachable(self, response: httpx.Response) -> Iterator[None]:
        """Let :meth:`close` end the wait for the next piece."""
        stream = response.extensions.get("network_stream")
        wire = None if stream is None else stream.get_extra_info("socket")
        if wire is not None:
            self._hang_up = partial(_shut_down, wire)
        try:
            # It may have been closed when there was nothing to hang up yet.
            if self._closed.is_set():
                self._hang_up()
            yield
        finally:
            self._hang_up = _nothing


def _nothing() -> None:
    """No connection, nothing to hang up."""


def _shut_down(wire: socket.socket) -> None:
    with suppress(OSError):  # the daemon was faster
        wire.shutdown(socket.SHUT_RDWR)
