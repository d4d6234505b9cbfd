"""Libraries that raise whatever they like: one typed error that blames the right part."""

from __future__ import annotations

import errno
import gc
import importlib
import sys
import weakref
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from veilcam_server.devices import DeviceMissingError, DisplayError, SensorError
from veilcam_server.devices.errors import DeviceError
from veilcam_server.devices.extras import import_extra
from veilcam_server.devices.imx477 import IMX477
from veilcam_server.devices.picamera import open_picamera2
from veilcam_server.devices.raw import SensorMode
from veilcam_server.devices.reopening import ReopeningSensor
from veilcam_server.devices.simulated.picamera import FakePicamera2
from veilcam_server.devices.spi import LinuxLines, LinuxSpi, gpio_chips, line_user

MODE = SensorMode(60, 82, line_time=0.0, frame_duration=0.0)
WHATEVER: tuple[Callable[[], Exception], ...] = (
    lambda: SystemError("error return without exception set"),
    lambda: AttributeError("module has no attribute 'that'"),
    lambda: ImportError("undefined symbol: _ZN9libcamera"),
    lambda: OSError(errno.ENOTTY, "Inappropriate ioctl for device"),
    OSError,
    lambda: KeyError("SensorTimestamp"),
    StopIteration,
    lambda: UnicodeDecodeError("utf-8", b"\xff", 0, 1, "invalid start byte"),
    MemoryError,
)
IDS = [type(make()).__name__ for make in WHATEVER]


class Witness:
    """Something that a library has half made when it raises."""


class Library:
    """Stand-in whose call at one door raises; all others do nothing.

    Args:
        door: name of the call that fails.
        error: makes what it raises.
    """

    def __init__(self, door: str, error: Callable[[], Exception]) -> None:
        self.door, self.error = door, error
        self.made: list[weakref.ref[Witness]] = []
        self.closed = 0

    def enter(self, door: str) -> None:
        if door == self.door:
            made = Witness()
            self.made.append(weakref.ref(made))
            raise self.error()


@pytest.fixture
def install(monkeypatch: pytest.MonkeyPatch) -> Callable[[Library], None]:
    def put(library: Library) -> None:
        def passing(door: str, value: object = None) -> Callable[..., Any]:
            def call(*_: object, **__: object) -> Any:
                library.enter(door)
                return value

            return call

        class SpiDev:
            __init__ = passing("SpiDev")
            open, writebytes2 = passing("open"), passing("writebytes2")
            fileno = passing("fileno", -1)

            def __setattr__(self, name: str, value: object) -> None:
                library.enter(name)
                super().__setattr__(name, value)

            def close(self) -> None:
                library.closed += 1
                library.enter("close")

        info = SimpleNamespace(label="pinctrl-rp1", used=False, consumer="")

        class Chip:
            __init__, __exit__ = passing("Chip"), passing("close chip")
            get_info, get_line_info = passing("get_info", info), passing("get_line_info", info)

            def __enter__(self) -> Chip:
                return self

        lines = SimpleNamespace(set_value=passing("set_value"), release=passing("release"))
        value = SimpleNamespace(ACTIVE=1, INACTIVE=0)
        gpiod = SimpleNamespace(
            Chip=Chip,
            LineSettings=passing("LineSettings"),
            request_lines=passing("request_lines", lines),
            line=SimpleNamespace(Value=value, Direction=SimpleNamespace(OUTPUT="output")),
        )
        camera = passing("Picamera2")
        monkeypatch.setitem(sys.modules, "spidev", SimpleNamespace(SpiDev=SpiDev))
        monkeypatch.setitem(sys.modules, "gpiod", gpiod)
        monkeypatch.setitem(sys.modules, "picamera2", SimpleNamespace(Picamera2=camera))
        monkeypatch.setattr(Path, "glob", lambda *_: iter([Path("/dev/gpiochip0")]))

    return put


def use_spi() -> None:
    spi = LinuxSpi.open("/dev/spidev0.0", 1_000_000, one_wire=True)
    spi.write(b"\x2c")
    spi.close()
    spi.read(0x09, 5)


def use_lines() -> None:
    assert list(gpio_chips()) == ["pinctrl-rp1"]
    assert line_user(Path("/dev/gpiochip0"), 25) is None
    lines = LinuxLines.open(None, data=25, reset=24)
    lines.data(True)
    lines.close()


def use_camera() -> None:
    open_picamera2(0)


def light(*_: float) -> Any:
    return np.full((MODE.rows, MODE.columns), 1000, np.uint16)


def chain(error: BaseException | None) -> list[BaseException]:
    return [] if error is None else [error, *chain(error.__cause__), *chain(error.__context__)]


SETTING = ("open", "mode", "max_speed_hz", "threewire")
REQUESTING = ("get_line_info", "LineSettings", "request_lines")


@pytest.mark.thorough
@pytest.mark.parametrize("error", WHATEVER, ids=IDS)
@pytest.mark.parametrize(
    ("door", "use", "blamed"),
    [
        *((door, use_spi, "/dev/spidev0.0") for door in ("SpiDev", *SETTING)),
        *((door, use_spi, "the panel's bus") for door in ("writebytes2", "close", "fileno")),
        *((door, use_lines, "line.* of /dev/gpiochip0") for door in REQUESTING),
        *((door, use_lines, "the panel's GPIO lines") for door in ("set_value", "release")),
        ("Picamera2", use_camera, "camera 0"),
    ],
)
def test_library_that_raises_whatever_is_blamed_and_nothing_of_it_kept(
    install: Callable[[Library], None],
    door: str,
    use: Callable[[], None],
    blamed: str,
    error: Callable[[], Exception],
) -> None:
    library = Library(door, error)
    install(library)
    with pytest.raises(DeviceError, match=f"{blamed}.*: ") as caught:
        use()
    assert chain(caught.value) == [caught.value]
    assert "\n" not in str(caught.value)
    (made,) = library.made
    assert made() is None
    # A bus that was opened and could not be set is let go.
    assert library.closed == 1 or door not in SETTING


@pytest.mark.parametrize("error", WHATEVER, ids=IDS)
@pytest.mark.parametrize("door", ["Chip", "get_info", "close chip"])
def test_chips_that_cannot_be_looked_at_are_left_out_or_blamed(
    install: Callable[[Library], None], door: str, error: Callable[[], Exception]
) -> None:
    install(Library(door, error))
    if isinstance(error(), OSError) and door != "close chip":
        assert gpio_chips() == {}
    elif not isinstance(error(), OSError):
        with pytest.raises(DeviceMissingError, match="lines of /dev/gpiochip0 cannot be used"):
            gpio_chips()


@pytest.mark.parametrize("name", ["spidev", "gpiod", "picamera2", "libcamera"])
@pytest.mark.parametrize("error", WHATEVER, ids=IDS)
def test_package_that_raises_whatever_at_its_import_is_named(
    monkeypatch: pytest.MonkeyPatch, name: str, error: Callable[[], Exception]
) -> None:
    def fail(_: str) -> None:
        raise error()

    monkeypatch.setattr(importlib, "import_module", fail)
    with pytest.raises(DeviceMissingError, match=f"{name} cannot be imported .*install") as caught:
        import_extra(name)
    assert chain(caught.value) == [caught.value]


def test_gpiod_1_is_named_with_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    class Chip:
        def __init__(self, name: str) -> None:
            self.name = name

        def label(self) -> str:
            return "pinctrl-rp1"

    old = SimpleNamespace(Chip=Chip, LINE_REQ_DIR_OUT=3, version_string=lambda: "1.6.3")
    monkeypatch.setitem(sys.modules, "gpiod", old)
    told = r"gpiod is version 1, and version 2 is needed: .*pip install 'gpiod>=2"
    for use in (gpio_chips, use_lines, lambda: line_user(Path("/dev/gpiochip0"), 25)):
        with pytest.raises(DeviceMissingError, match=told):
            use()


@pytest.mark.parametrize("taken", [None, 3])
def test_short_write_is_named(install: Callable[[Library], None], taken: int | None) -> None:
    """As py-spidev tells of it, or as a count."""
    install(Library("", OSError))
    spi = LinuxSpi.open("/dev/spidev0.0", 1_000_000)

    def writebytes2(buffer: bytes) -> int:
        if taken is None:
            raise SystemError("<method 'writebytes2'> returned NULL without setting an exception")
        return min(taken, len(buffer))

    spi._device.writebytes2 = writebytes2
    with pytest.raises(DisplayError, match=r"panel's bus failed \(short write"):
        spi.write(b"\x15\x16\x17\x18")
    if taken is not None:
        spi.write(b"\x15\x16\x17")


@pytest.mark.parametrize("error", WHATEVER, ids=IDS)
@pytest.mark.parametrize(
    "door", ["create_video_configuration", "configure", "camera_configuration", "set_controls"]
)
def test_camera_that_cannot_be_set_up_is_let_go_and_not_kept(
    monkeypatch: pytest.MonkeyPatch, door: str, error: Callable[[], Exception]
) -> None:
    """Neither by who holds the error, nor by the sensor that is to open it again."""
    made: list[weakref.ref[FakePicamera2]] = []
    closed: list[bool] = []

    def fail(*_: object, **__: object) -> None:
        raise error()

    def start() -> IMX477:
        def open_camera() -> FakePicamera2:
            camera = FakePicamera2(light, mode=MODE)
            made.append(weakref.ref(camera))
            return camera

        return IMX477(open_camera, shape=(4, 5), mode=MODE)

    monkeypatch.setattr(FakePicamera2, "close", lambda _: closed.append(True))
    sensor = ReopeningSensor("IMX477", 1.0, start)
    monkeypatch.setattr(FakePicamera2, door, fail)
    told = f"the camera cannot be set up .{type(error()).__name__}"
    with pytest.raises(SensorError, match=told) as caught:
        start()
    with pytest.raises(SensorError, match=told) as opened:
        sensor.capture(0.0, 1.0)
    for kept in (caught, opened):
        assert chain(kept.value) == [kept.value]
    assert [camera() for camera in made] == [None, None]
    assert closed == [True, True]
    # Between two attempts the reason is raised again.
    with pytest.raises(SensorError, match=told):
        sensor.capture(0.0, 1.0)


@pytest.mark.parametrize("error", WHATEVER, ids=IDS)
@pytest.mark.parametrize("door", ["captured_request", "_take"])
def test_capture_that_fails_is_the_camera_s(
    monkeypatch: pytest.MonkeyPatch, door: str, error: Callable[[], Exception]
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error()

    sensor = IMX477(lambda: FakePicamera2(light, mode=MODE), shape=(4, 5), mode=MODE)
    monkeypatch.setattr(FakePicamera2, door, fail)
    with pytest.raises(SensorError, match=r"the camera failed .*it is opened again") as caught:
        sensor.capture(0.0, 1.0)
    assert chain(caught.value) == [caught.value]


def test_half_made_picamera2_is_dead_before_the_error_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It refers to itself, as the real one does, and the collector need not run by itself."""
    made: list[weakref.ref[Any]] = []

    class Half:
        def __init__(self, _: int) -> None:
            self.helpers = SimpleNamespace(camera=self)
            made.append(weakref.ref(self))
            raise RuntimeError("Camera __init__ sequence did not complete.")

    monkeypatch.setitem(sys.modules, "picamera2", SimpleNamespace(Picamera2=Half))
    gc.disable()
    try:
        with pytest.raises(DeviceMissingError, match="end whatever else uses it") as caught:
            open_picamera2(0)
        assert made[0]() is None
    finally:
        gc.enable()
    assert chain(caught.value) == [caught.value]
