"""Sockets that keep the deadline of a call, whose peer gains nothing by dribbling."""

from __future__ import annotations

import ssl
from typing import Any

import httpcore
import httpx

from veilcam_client.http.deadline import Limit

PIECE = 4096
"""Read or written at once: how much time is left is asked before each [bytes]."""
LIMITS = httpx.Limits(max_connections=100, max_keepalive_connections=20)
"""Those of httpx."""


class DeadlineTransport(httpx.HTTPTransport):
    """httpx's own transport, on sockets that keep a :class:`Limit`."""

    def __init__(self, trusted: ssl.SSLContext, unix_socket: str | None) -> None:
        super().__init__(verify=trusted)
        # Its constructor takes no network backend; the pool does.
        self._pool = httpcore.ConnectionPool(
            ssl_context=trusted,
            uds=unix_socket,
            max_connections=LIMITS.max_connections,
            max_keepalive_connections=LIMITS.max_keepalive_connections,
            keepalive_expiry=LIMITS.keepalive_expiry,
            network_backend=_Backend(),
        )


class _Backend(httpcore.SyncBackend):
    """Connects as httpcore does, to streams that keep a :class:`Limit`."""

    def connect_tcp(self, *args: Any, **options: Any) -> httpcore.NetworkStream:
        return _Stream(super().connect_tcp(*args, **options))

    def connect_unix_socket(self, *args: Any, **options: Any) -> httpcore.NetworkStream:
        return _Stream(super().connect_unix_socket(*args, **options))


class _Stream(httpcore.NetworkStream):
    """A stream, each operation of which ends with the whole."""

    def __init__(self, stream: httpcore.NetworkStream) -> None:
        self._stream = stream

    def read(self, max_bytes: int, timeout: float | None = None) -> bytes:
        return self._stream.read(min(max_bytes, PIECE), _left(timeout, httpcore.ReadTimeout))

    def write(self, buffer: bytes, timeout: float | None = None) -> None:
        for start in range(0, len(buffer), PIECE):
            piece = buffer[start : start + PIECE]
            self._stream.write(piece, _left(timeout, httpcore.WriteTimeout))

    def close(self) -> None:
        self._stream.close()

    def start_tls(
        self,
        ssl_context: ssl.SSLContext,
        server_hostname: str | None = None,
        timeout: float | None = None,
    ) -> httpcore.NetworkStream:
        try:
            left = _left(timeout, httpcore.ConnectTimeout)
            return _Stream(self._stream.start_tls(ssl_context, server_hostname, left))
        except BaseException:
            # httpcore 1.0 closes it where its own handshake fails, and not where there is no time
            # left to begin one.
            self._stream.close()
            raise

    def get_extra_info(self, info: str) -> Any:
        return self._stream.get_extra_info(info)


def _left(timeout: float | None, late: type[httpcore.TimeoutException]) -> float | None:
    if not isinstance(timeout, Limit):
        return timeout
    left = timeout.left()
    if left <= 0:
        raise late("the deadline of the call is over")
    return left
