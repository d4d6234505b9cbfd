"""A daemon on a panel and a sensor of other kinds."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.unit.server.devices.test_driver import others

from veilcam_server.daemon import build_service
from veilcam_server.settings import Settings

__all__ = ["others"]


@pytest.mark.slow
@pytest.mark.usefixtures("others")
def test_panel_and_sensor_that_were_added_serve(
    bundle_file: Path, scene_file: Path, tmp_path: Path
) -> None:
    settings = Settings(
        bundle=bundle_file,
        device="simulated",
        panel="PROMPT",
        sensor="OTHER",
        scenes=(str(scene_file),),
        state_dir=tmp_path / "state",
        settle=0.01,
        exposure=0.001,
    )
    service = build_service(settings)
    try:
        status = service.status()
        assert (status.state, status.detail) == ("ready", None)
        assert (status.device.display, status.device.sensor) == ("PROMPT", "OTHER")
        service._camera.capture(release=False)
    finally:
        service.stop()
