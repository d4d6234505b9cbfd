"""A camera on the bench."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from veilcam_server.camera.camera import MaskedCamera

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench


@pytest.fixture
def camera(bench: Bench) -> MaskedCamera:
    return bench.camera()
