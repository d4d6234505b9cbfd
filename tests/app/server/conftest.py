"""Fixtures of the server's unit tests, for tests that start a daemon or a process."""

from tests.unit.server.conftest import *  # noqa: F403
from tests.unit.server.conftest import _no_settings_from_outside, _one_plan_for_all, _own_logs

__all__ = ["_no_settings_from_outside", "_one_plan_for_all", "_own_logs"]
