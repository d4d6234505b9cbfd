"""Limits of a daemon that follow from the number of its callers."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path


class CallerLimits:
    """Limits of connections, event streams, requests and waiting captures."""

    if TYPE_CHECKING:
        callers: int
        tls_certificate: Path | None

    @property
    def connections(self) -> int:
        """Connections that may be open, at most 4096: by default 512, with TLS 128."""
        # asyncio takes 340 kB for each TLS connection, 256 KiB of them a buffer for reading. 128 of
        # them, which strangers may open, are 44 MB. Without TLS a connection takes 20 kB.
        return min(4096, self.callers * (32 if self.tls_certificate is None else 8))

    @property
    def streams(self) -> int:
        """Event streams that may be open: half of the connections."""
        return self.connections // 2

    @property
    def caller_streams(self) -> int:
        """Event streams that one caller may open: by default 16."""
        return min(16, self.streams)

    @property
    def concurrency(self) -> int:
        """Requests of one caller that may be under way, event streams included: by default 64."""
        return 4 * self.callers

    @property
    def rate(self) -> float:
        """Requests of one caller in a second, in the long run: by default 100.

        One caller may be many programs: all of an address count as one where no token is wanted.
        """
        return 6.25 * self.callers

    @property
    def burst(self) -> int:
        """Requests of one caller that may come at once after a quiet time: by default 200."""
        return round(2 * self.rate)

    @property
    def queue(self) -> int:
        """Captures that may wait: by default 8."""
        return max(2, self.callers // 2)
