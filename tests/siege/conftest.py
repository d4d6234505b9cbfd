"""The server's benches, which stress tests put under load."""

from tests.server.conftest import (
    _no_settings_from_outside,
    _own_logs,
    anyio_backend,
    bench,
    bundle,
    fresh_bundle,
)

__all__ = [
    "_no_settings_from_outside",
    "_own_logs",
    "anyio_backend",
    "bench",
    "bundle",
    "fresh_bundle",
]
