"""Sockets for asyncio that are read in small pieces, and closed when a handshake is given up."""

from __future__ import annotations

import ssl
from typing import Any

import httpcore
import httpx

from veilcam_client.http.sockets import LIMITS, PIECE


class PiecemealTransport(httpx.AsyncHTTPTransport):
    """httpx's own transport, so that a deadline is looked at between two small pieces.

    What one read brings is taken apart without a pause: 64 KiB of empty answers take 0.1 s.
    """

    def __init__(self, trusted: ssl.SSLContext, unix_socket: str | None) -> None:
        super().__init__(verify=trusted)
        # Its constructor takes no network backend; the pool does.
        self._pool = httpcore.AsyncConnectionPool(
            ssl_context=trusted,
            uds=unix_socket,
            max_connections=LIMITS.max_connections,
            max_keepalive_connections=LIMITS.max_keepalive_connections,
            keepalive_expiry=LIMITS.keepalive_expiry,
            network_backend=_Backend(),
        )


class _Backend(httpcore.AnyIOBackend):
    async def connect_tcp(self, *args: Any, **options: Any) -> httpcore.AsyncNetworkStream:
        return _Stream(await super().connect_tcp(*args, **options))

    async def connect_unix_socket(self, *args: Any, **options: Any) -> httpcore.AsyncNetworkStream:
        return _Stream(await super().connect_unix_socket(*args, **options))


class _Stream(httpcore.AsyncNetworkStream):
    def __init__(self, stream: httpcore.AsyncNetworkStream) -> None:
        self._stream = stream

    async def read(self, max_bytes: int, timeout: float | None = None) -> bytes:
        return await self._stream.read(min(max_bytes, PIECE), timeout)

    async def write(self, buffer: bytes, timeout: float | None = None) -> None:
        await self._stream.write(buffer, timeout)

    async def aclose(self) -> None:
        await self._stream.aclose()

    async def start_tls(
        self,
        ssl_context: ssl.SSLContext,
        server_hostname: str | None = None,
        timeout: float | None = None,
    ) -> httpcore.AsyncNetworkStream:
        try:
            return _Stream(await self._stream.start_tls(ssl_context, server_hostname, timeout))
        except BaseException:
            # A handshake that is cancelled is left open by httpcore 1.0.
            await self._stream.aclose()
            raise

    def get_extra_info(self, info: str) -> Any:
        return self._stream.get_extra_info(info)
