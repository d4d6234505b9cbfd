"""A Raspberry Pi that is not there: the daemon's own way to its hardware, on stand-ins for it.

What ``spidev``, ``gpiod`` and ``picamera2`` are given goes to the emulated panel and the fake
camera, so that wiring, drivers, self test and a capture are those of a real device.
"""

from __future__ import annotations

import ctypes
import fcntl
import struct
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch
from structlog.testing import capture_logs

from veilcam_client.wire.simulation import PanelFaults
from veilcam_optics.propagation.sampling import area_average
from veilcam_server.camera.capture import MaskedCapture
from veilcam_server.daemon import build_service
from veilcam_server.devices import DeviceError, DisplayError, SensorError
from veilcam_server.devices.imx477 import HALF
from veilcam_server.devices.raw import Raw
from veilcam_server.devices.registry import DISPLAYS, open_device
from veilcam_server.devices.reopening import ReopeningSensor
from veilcam_server.devices.simulated.panel import PanelEmulator
from veilcam_server.devices.simulated.picamera import FakePicamera2
from veilcam_server.devices.st7735r_glass import TABS
from veilcam_server.errors import StartError
from veilcam_server.settings import Settings
from veilcam_server.wiring import Wiring

if TYPE_CHECKING:
    from collections.abc import Iterator

    from veilcam_training.bundle import Bundle

BLOCK = 4
"""Raw pixels that get the same light, along each side: a frame has three million."""
BUS = 1_000_000
"""File of the bus."""


class Board:
    """What is connected to the pins and to the camera's connector."""

    def __init__(self, bundle: Bundle) -> None:
        self.panel = PanelEmulator(TABS["green"])
        self.window = bundle.camera.window
        self.asked: dict[str, Any] = {}
        self.cameras: list[FakePicamera2] = []
        self.bright = 0.8

    def light(self, begin: float, end: float) -> Raw:
        """A shadow of the window in even light."""
        shown = torch.from_numpy(self.panel.visible(begin) / 63)
        rows = slice(self.window.first_row, self.window.first_row + self.window.rows)
        columns = slice(self.window.first_column, self.window.first_column + self.window.columns)
        seen = area_average(
            shown[rows, columns][None].double(), HALF.rows // BLOCK, HALF.columns // BLOCK
        )[0]
        levels = HALF.black_level + self.bright * seen.numpy() * (
            HALF.white_level - HALF.black_level
        )
        raw: Raw = np.kron(levels, np.ones((BLOCK, BLOCK))).astype(np.uint16)
        return raw

    @property
    def modules(self) -> Iterator[tuple[str, object]]:
        board = self

        class SpiDev:
            mode = max_speed_hz = 0

            def __setattr__(self, name: str, value: object) -> None:
                if name == "threewire":
                    board.asked[name] = value
                super().__setattr__(name, value)

            def fileno(self) -> int:
                return BUS

            def open(self, bus: int, device: int) -> None:
                board.asked["spi"] = f"/dev/spidev{bus}.{device}"

            def writebytes2(self, buffer: memoryview | bytes) -> None:
                assert self.mode == 0
                board.asked["hz"] = self.max_speed_hz
                board.panel.write(buffer)

            def close(self) -> None:
                board.asked["spi closed"] = True

        value = SimpleNamespace(ACTIVE=True, INACTIVE=False)

        class Request:
            def set_value(self, line: int, level: bool) -> None:
                data, _ = board.asked["lines"]
                if line == data:
                    board.panel.data(level)
                else:
                    board.panel.reset(not level)

            def release(self) -> None:
                board.asked["lines closed"] = True

        @contextmanager
        def chip(path: str) -> Iterator[object]:
            label = board.asked.get("label", "pinctrl-rp1")
            yield SimpleNamespace(get_info=lambda: SimpleNamespace(label=label))

        def request_lines(
            path: str, consumer: str, config: dict[tuple[int, int], object]
        ) -> object:
            board.asked["chip"], (board.asked["lines"],) = path, config
            return Request()

        def picamera2(number: int) -> FakePicamera2:
            board.asked["camera"] = number
            # The panel is opaque before anything looks.
            assert not board.panel.framebuffer().any()
            camera = FakePicamera2(board.light, mode=HALF)
            board.cameras.append(camera)
            return camera

        yield "spidev", SimpleNamespace(SpiDev=SpiDev)
        yield (
            "gpiod",
            SimpleNamespace(
                Chip=chip,
                request_lines=request_lines,
                LineSettings=lambda **_: None,
                line=SimpleNamespace(Value=value, Direction=SimpleNamespace(OUTPUT="output")),
            ),
        )
        yield "picamera2", SimpleNamespace(Picamera2=picamera2)


@pytest.fixture
def board(bundle: Bundle, monkeypatch: pytest.MonkeyPatch) -> Board:
    made = Board(bundle)
    for name, stand_in in made.modules:
        module = ModuleType(name)
        vars(module).update(vars(stand_in))
        monkeypatch.setitem(sys.modules, name, module)
    glob = Path.glob

    def find(folder: Path, pattern: str) -> Any:
        chips = folder == Path("/dev") and pattern == "gpiochip*"
        return [folder / "gpiochip4"] if chips else glob(folder, pattern)

    monkeypatch.setattr(Path, "glob", find)
    ioctl = fcntl.ioctl

    def exchange(file: Any, request: int, message: Any) -> Any:
        """What the kernel does with a question to the panel and the room for its answer."""
        if file != BUS:
            return ioctl(file, request, message)
        (asked, _, *_), (_, room, count, *_) = struct.iter_unpack("=QQIIQ", bytes(message))
        (code,) = ctypes.string_at(asked, 1)
        ctypes.memmove(room, made.panel.read(code, count), count)
        made.asked["questions"] = made.asked.get("questions", 0) + 1
        return 1 + count

    monkeypatch.setattr(fcntl, "ioctl", exchange)
    return made


@pytest.fixture
def settings(bundle_file: Path, tmp_path: Path) -> Settings:
    return Settings(bundle=bundle_file, state_dir=tmp_path / "state", panel_tab="green")


@pytest.mark.slow
def test_raspberry_pi_serves(board: Board, settings: Settings) -> None:
    service = build_service(settings)
    try:
        status = service.status()
        assert (status.state, status.detail) == ("ready", None)
        assert not status.device.simulated
        # Nothing leaves a real camera unless it is said.
        assert status.release == "none"
        begun = time.monotonic()
        captured = service._camera.capture(release=False)
        assert isinstance(captured, MaskedCapture)
        assert captured.exposure.started_after_shown_s >= settings.settle
        assert time.monotonic() >= begun
    finally:
        service.stop()
    assert board.asked == {
        "spi": "/dev/spidev0.0",
        "hz": 15_000_000,
        "chip": "/dev/gpiochip4",
        "lines": (25, 24),
        "camera": 0,
        "spi closed": True,
        "lines closed": True,
    }
    assert board.cameras[0].closed
    assert not board.panel.transparent
    assert not board.panel.framebuffer().any()


@pytest.mark.slow
def test_wiring_is_what_the_settings_say(board: Board, settings: Settings, bundle: Bundle) -> None:
    board.asked["label"] = "my expander"
    device = open_device(
        settings.model_copy(
            update={
                "spi": Path("/dev/spidev1.1"),
                "spi_hz": 20_000_000,
                "gpio_chip": "my expander",
                "data_line": 5,
                "reset_line": 6,
                "camera_number": 1,
                "exposure": 0.004,
                "exposure_factor": 3.0,
            }
        ),
        bundle,
    )
    assert not board.asked.keys() - {"label"}
    board.bright = 0.02
    device.display.blank()
    assert isinstance(device.sensor, ReopeningSensor)
    with device.sensor._part.open():
        pass
    device.display.show(np.full(bundle.camera.mask_shape, 63, np.uint8))
    asked = [device.sensor.capture(time.monotonic() + 0.05, 5.0).integration for _ in range(2)]
    assert asked == pytest.approx([0.004, 0.012], abs=2e-5)
    assert board.asked["spi"] == "/dev/spidev1.1"
    assert board.asked["hz"] == 20_000_000
    assert board.asked["lines"] == (5, 6)
    assert board.asked["camera"] == 1
    device.close()


@pytest.mark.slow
def test_dead_panel_takes_no_capture(board: Board, settings: Settings) -> None:
    board.panel.faults = PanelFaults(dead=True)
    # The stand-in for picamera2 is opened although nothing can be opaque here.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(PanelEmulator, "framebuffer", lambda _: np.zeros((384, 160), np.uint8))
        service = build_service(settings)
    status = service.status()
    assert status.state == "safe"
    assert "does not hide the scene" in str(status.detail)
    assert status.rotation.epoch is None
    service.stop()


@pytest.mark.parametrize(("read_back", "turned"), [("miso", False), ("sda", True)])
def test_panel_is_asked_as_it_is_wired(
    board: Board, settings: Settings, bundle: Bundle, *, read_back: str, turned: bool
) -> None:
    device = open_device(settings.model_copy(update={"panel_read_back": read_back}), bundle)
    device.display.blank()
    assert board.asked.get("threewire", False) is turned
    asked = board.asked["questions"]
    assert asked == 4  # three times after setting up, and after that
    device.display.show(np.full(bundle.camera.mask_shape, 9, np.uint8))
    assert board.asked["questions"] == asked + 1
    # A line that nobody drives says nothing: light tells of a dead panel.
    board.panel.faults = PanelFaults(dead=True)
    device.display.show(np.full(bundle.camera.mask_shape, 9, np.uint8))
    device.display.close()


def test_doctor_asks_the_panel_who_it_is(board: Board) -> None:
    wiring = Wiring(panel_read_back="miso")
    identify = DISPLAYS["ST7735R"].identify
    assert identify is not None
    assert identify(wiring) == "identity 7c89f0, status 00610000"
    assert board.asked["spi closed"]
    assert board.asked["lines closed"]
    assert board.panel.transparent
    board.panel.faults = PanelFaults(dead=True)
    del board.asked["spi closed"], board.asked["lines closed"]
    with pytest.raises(DisplayError, match="does not answer"):
        identify(wiring)
    assert board.asked["spi closed"]
    assert board.asked["lines closed"]


def test_wiring_that_cannot_be_says_what_to_do(board: Board, settings: Settings) -> None:
    with pytest.raises(StartError, match="--panel-tab red, black or green") as caught:
        build_service(settings.model_copy(update={"panel_tab": None}))
    assert "\n" not in str(caught.value)
    assert not board.cameras


@pytest.mark.slow
def test_panel_that_is_not_there_yet_is_waited_for(board: Board, settings: Settings) -> None:
    board.asked["label"] = "another"
    service = build_service(settings)
    status = service.status()
    assert (status.state, status.remedy) == ("safe", "run_doctor")
    assert "give --gpio-chip one of another" in str(status.detail)
    assert status.device.display == "ST7735R"
    # Nobody looks through a panel that may be transparent.
    assert not board.cameras
    board.asked["label"] = "pinctrl-rp1"
    time.sleep(1.0)  # the pause before another attempt
    service._camera.test_if_due()
    assert service.status().state == "ready"
    service._camera.capture(release=False)
    service.stop()


def test_camera_that_is_not_there_leaves_the_panel_opaque(
    board: Board, settings: Settings, bundle: Bundle
) -> None:
    def none(_: int) -> None:
        raise IndexError("list index out of range")

    sys.modules["picamera2"].Picamera2 = none  # type: ignore[attr-defined]
    device = open_device(settings, bundle)
    device.display.blank()
    with pytest.raises(SensorError, match="there is no camera 0"):
        device.sensor.capture(0.0, 1.0)
    device.close()
    assert board.asked["spi closed"]
    assert board.asked["lines closed"]
    assert not board.panel.framebuffer().any()


def test_fast_bus_is_warned_of(board: Board, settings: Settings, bundle: Bundle) -> None:
    with capture_logs() as logs:
        open_device(settings.model_copy(update={"spi_hz": 16_000_000}), bundle).close()
    assert [entry["event"] for entry in logs] == ["fast panel bus"]


def test_bundle_for_another_panel_is_refused(board: Board, settings: Settings) -> None:
    from dataclasses import replace

    from tests.unit.server.conftest import make_bundle

    from veilcam_optics.camera.geometry import Camera, Panel, Window

    camera = Camera(panel=Panel(rows=240, columns=320), window=Window(9, 5, 10, 10))
    with pytest.raises(DeviceError, match="for another panel"):
        open_device(settings, replace(make_bundle(), camera=camera))
    assert not board.asked
