"""The camera as a program sees it: ``Camera``, and ``AsyncCamera`` with the same surface."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from types import TracebackType
from typing import Self

from veilcam_client import calls
from veilcam_client.events import Event
from veilcam_client.models import Capture, Classification, Rotation, RotationPolicy, Status
from veilcam_client.retry import RetryPolicy
from veilcam_client.transport import (
    AsyncHttpClient,
    AsyncTransport,
    HttpClient,
    Options,
    Transport,
)

DEFAULT_URL = "http://127.0.0.1:8787"


class Camera:
    """One connection to a ``veilcamd``.

    Args:
        url: ``http://HOST:PORT``, or ``unix:///PATH`` for a unix socket.
        connect_timeout: to reach the daemon [s].
        read_timeout: between two pieces of an answer [s]; it must cover settling and exposure.
        max_retries: how often a request that may succeed later is repeated.
        http_client: an ``httpx.Client`` to use instead of an own one; it is not closed.

    Raises:
        ValueError: a URL or timeout that cannot be used.
    """

    def __init__(
        self,
        url: str = DEFAULT_URL,
        *,
        connect_timeout: float = 2.0,
        read_timeout: float = 30.0,
        max_retries: int = 2,
        http_client: HttpClient | None = None,
    ) -> None:
        options = Options(url, connect_timeout, read_timeout, RetryPolicy(retries=max_retries))
        self._transport = Transport(options, http_client)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection."""
        self._transport.close()

    def status(self) -> Status:
        """State, device, bundle, rotation and queue of the daemon."""
        return self._transport.send(calls.status())

    def capture(self) -> Capture:
        """Take one embedding; ``np.asarray`` of the result is the array."""
        return self._transport.send(calls.capture())

    def classify(self, *, include_embedding: bool = False) -> Classification:
        """Take one embedding and classify it on the device."""
        return self._transport.send(calls.classify(include_embedding))

    def rotation(self) -> Rotation:
        """The rotation policy and the present mask epoch."""
        return self._transport.send(calls.rotation())

    def set_rotation(self, policy: RotationPolicy) -> Rotation:
        """Change when masks change."""
        return self._transport.send(calls.set_rotation(policy))

    def rotate(self) -> Rotation:
        """Show another mask now."""
        return self._transport.send(calls.rotate())

    def events(self, *, last_event_id: str | None = None) -> Iterator[Event]:
        """Yield events as they happen; resumes by itself, a ``Gap`` tells of missed ones."""
        return self._transport.events(last_event_id)


class AsyncCamera:
    """:class:`Camera` for asyncio: the same arguments, methods and results."""

    def __init__(
        self,
        url: str = DEFAULT_URL,
        *,
        connect_timeout: float = 2.0,
        read_timeout: float = 30.0,
        max_retries: int = 2,
        http_client: AsyncHttpClient | None = None,
    ) -> None:
        options = Options(url, connect_timeout, read_timeout, RetryPolicy(retries=max_retries))
        self._transport = AsyncTransport(options, http_client)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Close the connection."""
        await self._transport.close()

    async def status(self) -> Status:
        """State, device, bundle, rotation and queue of the daemon."""
        return await self._transport.send(calls.status())

    async def capture(self) -> Capture:
        """Take one embedding; ``np.asarray`` of the result is the array."""
        return await self._transport.send(calls.capture())

    async def classify(self, *, include_embedding: bool = False) -> Classification:
        """Take one embedding and classify it on the device."""
        return await self._transport.send(calls.classify(include_embedding))

    async def rotation(self) -> Rotation:
        """The rotation policy and the present mask epoch."""
        return await self._transport.send(calls.rotation())

    async def set_rotation(self, policy: RotationPolicy) -> Rotation:
        """Change when masks change."""
        return await self._transport.send(calls.set_rotation(policy))

    async def rotate(self) -> Rotation:
        """Show another mask now."""
        return await self._transport.send(calls.rotate())

    def events(self, *, last_event_id: str | None = None) -> AsyncIterator[Event]:
        """Yield events as they happen; resumes by itself, a ``Gap`` tells of missed ones."""
        return self._transport.events(last_event_id)
