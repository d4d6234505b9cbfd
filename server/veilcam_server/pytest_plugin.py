"""Plugin of pytest: the fixture ``fake_camera``, for programs that use the SDK."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from veilcam_server.testing import FakeCamera


@pytest.fixture(scope="session")
def _fake_daemon() -> Iterator[FakeCamera]:
    # Late: pytest loads this plugin wherever it is installed, also where no test wants a camera.
    try:
        from veilcam_server.testing import FakeCamera  # noqa: PLC0415
    except ModuleNotFoundError as error:
        pytest.fail(f"fake_camera needs the extra 'server' of veilcam: {error}")
    with FakeCamera() as camera:
        yield camera


@pytest.fixture
def fake_camera(_fake_daemon: FakeCamera) -> FakeCamera:
    """Return a simulated camera: one for all tests, put back for each."""
    _fake_daemon.put_back()
    return _fake_daemon
