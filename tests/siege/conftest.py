"""Fixtures of the siege."""

from tests.unit.server.conftest import _no_settings_from_outside, _own_logs, anyio_backend

__all__ = ["_no_settings_from_outside", "_own_logs", "anyio_backend"]
