"""Fixtures of the client's unit tests, for tests that start a daemon or a process."""

from tests.unit.client.conftest import *  # noqa: F403
