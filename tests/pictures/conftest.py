"""Settings of the machine that runs the tests are none of the daemon's."""

from tests.unit.server.conftest import _no_settings_from_outside

__all__ = ["_no_settings_from_outside"]
