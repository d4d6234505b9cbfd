"""HTTP client of a camera: a process that was forked gets its own, and so does each event loop."""

from __future__ import annotations

import os
import ssl
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar
from urllib.parse import urlsplit

import httpx

from veilcam_client.errors import ArgumentError
from veilcam_client.http.options import Options

ClientT = TypeVar("ClientT", bound=httpx.Client | httpx.AsyncClient)


class ClientHolder(Generic[ClientT]):
    """Client of the present process. All views of one camera share it.

    A client of another process is never closed here: its sockets and locks belong to that process.

    Args:
        given: client of the caller, None where the camera makes its own.
        make: makes an own client.
        place: name of the process, and of the event loop where there is one.
    """

    def __init__(
        self, given: ClientT | None, make: Callable[[], ClientT], place: Callable[[], Hashable]
    ) -> None:
        self._given, self._make, self._place = given, make, place
        # Made at once, so that a file that cannot be used is found where it is named.
        self._client = given or make()
        self._used_in: tuple[int, Hashable] | None = None
        self._closed = False

    def client(self) -> ClientT:
        """Return the client to ask with here.

        Raises:
            ArgumentError: the camera or the given client is closed, or the given client was used
                before this process was forked.
        """
        if self._closed:
            raise ArgumentError("the camera is closed: make another one")
        if self._given is not None and self._given.is_closed:
            raise ArgumentError("http_client is closed: give one that is open")
        here = (os.getpid(), self._place())
        if self._used_in not in (None, here):
            if self._given is None:
                self._client = self._make()
            elif self._used_in is not None and self._used_in[0] != here[0]:
                raise ArgumentError(
                    "http_client was used before this process was forked: make a client and a "
                    "camera in each process"
                )
        self._used_in = here
        return self._client

    def close(self) -> ClientT | None:
        """Note that the camera is closed; return the client that is to be closed here."""
        self._closed = True
        ours = self._given is None and self._used_in in (None, (os.getpid(), self._place()))
        return self._client if ours else None


def async_own_client(options: Options) -> httpx.AsyncClient:
    """Return an own client for asyncio."""
    transport = httpx.AsyncHTTPTransport(verify=_trusted(options), uds=options.socket)
    # trust_env off: a proxy meant for the web must not see a camera on this machine.
    return httpx.AsyncClient(transport=transport, trust_env=False)


def own_client(options: Options) -> httpx.Client:
    """Return an own client."""
    # Late, as httpx does it: half of what an HTTP client loads is for its sockets.
    from veilcam_client.http.sockets import DeadlineTransport  # noqa: PLC0415

    transport = DeadlineTransport(_trusted(options), options.socket)
    return httpx.Client(transport=transport, trust_env=False)


def async_place() -> Hashable:
    """Return the event loop, which a client belongs to."""
    import asyncio  # noqa: PLC0415 - late, as in deadline

    return asyncio.get_running_loop()


def place() -> Hashable:
    """Return None: a client belongs to the whole process."""
    return None


def _trusted(options: Options) -> ssl.SSLContext:
    """Return the trust of TLS; none, and at no cost, for plain HTTP."""
    if urlsplit(options.base).scheme != "https" and options.credentials.ca_file is None:
        return ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    return httpx.create_ssl_context(verify=options.credentials.trusted())
