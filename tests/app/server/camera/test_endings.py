"""Every way out: the sensor is stopped, the panel opaque, and its display on."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from structlog.testing import capture_logs

from veilcam_server.camera.self_test import OpticalSelfTest
from veilcam_server.daemon import build_service, serve
from veilcam_server.devices import Device, DisplayError, SensorError
from veilcam_server.devices.imx477 import IMX477
from veilcam_server.devices.reopening import ReopeningDisplay
from veilcam_server.devices.simulated.device import simulated_device
from veilcam_server.devices.simulated.light import planned_light
from veilcam_server.devices.simulated.panel import PanelEmulator
from veilcam_server.devices.simulated.picamera import FakePicamera2
from veilcam_server.devices.st7735r import ST7735R
from veilcam_server.errors import SelfTestError
from veilcam_server.settings import Settings

planned_once = cache(planned_light)


class Watched:
    """The simulated device of a daemon, and the order in which it was let go."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.steps: list[str] = []
        self.cameras: list[FakePicamera2] = []
        self.device: Device | None = None
        make = simulated_device

        def made(*arguments: Any, **more: Any) -> Device:
            self.device = make(*arguments, **more)
            return self.device

        monkeypatch.setattr("veilcam_server.devices.simulated.device.simulated_device", made)
        monkeypatch.setattr("veilcam_server.devices.simulated.light.planned_light", planned_once)
        start = FakePicamera2.start

        def started(camera: FakePicamera2) -> None:
            self.cameras.append(camera)
            start(camera)

        monkeypatch.setattr(FakePicamera2, "start", started)
        for kind, name in ((IMX477, "close"), (ST7735R, "blank"), (ST7735R, "close")):
            self._note(monkeypatch, kind, name)

    def _note(self, monkeypatch: pytest.MonkeyPatch, kind: type, name: str) -> None:
        method = getattr(kind, name)

        def noted(device: object) -> None:
            self.steps.append(f"{kind.__name__}.{name}")
            method(device)

        monkeypatch.setattr(kind, name, noted)

    @property
    def panel(self) -> PanelEmulator:
        assert self.device is not None
        assert isinstance(self.device.display, ReopeningDisplay)
        open_display = self.device.display._part._open_part
        assert isinstance(open_display, partial)
        spi = open_display.args[0]
        assert isinstance(spi, PanelEmulator)
        return spi

    def check(self) -> None:
        assert self.steps[-2:] == ["ST7735R.blank", "ST7735R.close"]
        if self.cameras:  # nobody looks as long as it is not needed
            assert self.steps[-3] == "IMX477.close"
            assert self.cameras[-1].closed
        assert not self.panel.transparent
        assert not self.panel.framebuffer().any()


@pytest.fixture
def watched(monkeypatch: pytest.MonkeyPatch) -> Watched:
    return Watched(monkeypatch)


@pytest.fixture
def settings(tmp_path: Path, bundle_file: Path, scene_file: Path) -> Settings:
    return Settings(
        device="simulated",
        bundle=bundle_file,
        scenes=(str(scene_file),),
        state_dir=tmp_path / "state",
        socket=tmp_path / "v.sock",
        settle=0.002,
        exposure=0.0,
        auth="none",
    )


def signalled(number: int) -> Callable[[str], None]:
    return lambda _: os.kill(os.getpid(), number)


def broken(_: str) -> None:
    raise ZeroDivisionError


def break_off(monkeypatch: pytest.MonkeyPatch, ending: BaseException) -> None:
    def broken_off(_: object, device: Device, *__: object) -> None:
        device.display.show(np.full((9, 5), 63, np.uint8))
        raise ending

    monkeypatch.setattr(OpticalSelfTest, "run", broken_off)


@pytest.fixture
def interruptible() -> Iterator[None]:
    """A shell starts its background jobs with Ctrl-C ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.slow
@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize(
    ("happens", "ending"),
    [
        pytest.param(signalled(signal.SIGTERM), SystemExit, id="SIGTERM"),
        pytest.param(signalled(signal.SIGINT), KeyboardInterrupt, id="SIGINT"),
        pytest.param(broken, ZeroDivisionError, id="defect"),
    ],
)
def test_daemon_that_is_ended(
    watched: Watched,
    settings: Settings,
    happens: Callable[[str], None],
    ending: type[BaseException],
) -> None:
    with pytest.raises(ending) as caught:
        serve(settings, happens)
    if isinstance(caught.value, SystemExit):
        assert caught.value.code == 0
    watched.check()


@pytest.mark.slow
@pytest.mark.parametrize("ending", [SystemExit(0), KeyboardInterrupt()])
def test_start_that_is_broken_off_in_the_test(
    watched: Watched, settings: Settings, monkeypatch: pytest.MonkeyPatch, ending: BaseException
) -> None:
    break_off(monkeypatch, ending)
    with pytest.raises(type(ending)):
        serve(settings, lambda _: None)
    watched.check()


@pytest.mark.parametrize(
    ("fault", "condition"),
    [
        (SelfTestError("the panel does not hide the scene"), ("safe", "check_panel_wiring")),
        (DisplayError("the panel's bus failed"), ("safe", "check_panel_wiring")),
        (SensorError("it gave no frame in time"), ("degraded", "check_camera_cable")),
        (SensorError("there is no camera 0", remedy="run_doctor"), ("degraded", "run_doctor")),
    ],
)
def test_start_without_proof_serves_and_says_why(
    watched: Watched,
    settings: Settings,
    monkeypatch: pytest.MonkeyPatch,
    fault: Exception,
    condition: tuple[str, str],
) -> None:
    break_off(monkeypatch, fault)
    service = build_service(settings)
    status = service.status()
    assert ((status.state, status.remedy), status.detail) == (condition, str(fault))
    assert status.rotation.epoch is None
    assert not watched.panel.framebuffer().any()
    service.stop()
    watched.check()


def test_start_that_meets_a_defect_serves_and_tells_nothing_of_it(
    watched: Watched, settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    break_off(monkeypatch, ZeroDivisionError("63 17 4"))
    with capture_logs() as logs:
        service = build_service(settings)
    status = service.status()
    assert (status.state, status.remedy) == ("safe", "report_defect")
    assert not watched.panel.framebuffer().any()
    assert [entry["error"] for entry in logs if entry["event"] == "defect"] == ["ZeroDivisionError"]
    assert "63 17" not in str(logs) + str(status)
    service.stop()
    watched.check()


@pytest.mark.slow
def test_panel_that_cannot_be_made_opaque_does_not_keep_the_sensor_running(
    watched: Watched, settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    service = build_service(settings)

    def fail(*_: object) -> None:
        raise DisplayError("the panel's bus failed")

    monkeypatch.setattr(ST7735R, "blank", fail)
    with pytest.raises(DisplayError):
        service.stop()
    assert watched.steps[-2:] == ["IMX477.close", "ST7735R.close"]
    service.stop()
