"""The adapters to spidev and gpiod, on modules that only note what they are asked."""

from __future__ import annotations

import ctypes
import fcntl
import struct
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from veilcam_server.devices import DeviceMissingError
from veilcam_server.devices import spi as linux_bus
from veilcam_server.devices.spi import LinuxLines, LinuxSpi

FASTEST = 20_000_000


class Value(Enum):
    INACTIVE = 0
    ACTIVE = 1


class SpiDev:
    """The part of spidev's class that is used."""

    fault: OSError | None = None
    last: SpiDev

    def __init__(self) -> None:
        self.path, self.mode, self.max_speed_hz, self.threewire = "", 3, 0, False
        self.sent: list[bytes] = []
        self.closed = False
        SpiDev.last = self

    def open(self, bus: int, device: int) -> None:
        if self.fault is not None:
            raise self.fault
        self.path = f"/dev/spidev{bus}.{device}"

    def writebytes2(self, buffer: memoryview | bytes) -> None:
        self.sent.append(bytes(buffer))

    def fileno(self) -> int:
        return 77

    def close(self) -> None:
        self.closed = True


class Gpiod:
    """The part of gpiod's module that is used."""

    line = SimpleNamespace(Value=Value, Direction=SimpleNamespace(OUTPUT="output"))

    def __init__(self) -> None:
        self.fault: Exception | None = None
        self.asked: dict[str, Any] = {}
        self.values: list[tuple[int, Value]] = []
        self.released = False

    def LineSettings(self, **settings: object) -> dict[str, object]:  # noqa: N802
        return settings

    def request_lines(self, path: str, **asked: object) -> Gpiod:
        if self.fault is not None:
            raise self.fault
        self.asked = {"path": path, **asked}
        return self

    def set_value(self, line: int, value: Value) -> None:
        self.values.append((line, value))

    def release(self) -> None:
        self.released = True


@pytest.fixture
def spidev(monkeypatch: pytest.MonkeyPatch) -> type[SpiDev]:
    module = ModuleType("spidev")
    module.SpiDev = SpiDev  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "spidev", module)
    monkeypatch.setattr(SpiDev, "fault", None)
    return SpiDev


@pytest.fixture
def gpiod(monkeypatch: pytest.MonkeyPatch) -> Gpiod:
    fake = Gpiod()
    monkeypatch.setitem(sys.modules, "gpiod", fake)
    monkeypatch.setattr(linux_bus, "_chip_path", lambda label: f"/dev/{label}")
    return fake


@pytest.mark.parametrize("one_wire", [False, True])
@pytest.mark.parametrize("path", ["/dev/spidev0.0", "/dev/spidev10.1"])
def test_bus_is_mode_0_at_the_clock_asked_for(
    spidev: type[SpiDev], path: str, *, one_wire: bool
) -> None:
    spi = LinuxSpi.open(path, 15_000_000, one_wire=one_wire)
    device = spidev.last
    assert (device.path, device.mode, device.max_speed_hz) == (path, 0, 15_000_000)
    assert device.threewire is one_wire
    spi.write(memoryview(b"abc"))
    assert device.sent == [b"abc"]
    spi.close()
    assert device.closed


def test_question_and_its_answer_are_one_message_of_two_halves(
    spidev: type[SpiDev], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[int, int]] = []
    clocks: list[int] = []

    def kernel(file: int, request: int, message: Any) -> int:
        """As spidev does: ``struct spi_ioc_transfer``, twice."""
        asked.append((file, request))
        first, second = struct.iter_unpack("=QQIIHBBBBBB", bytes(message))
        sent, nothing, length, clock, *rest = first
        assert (nothing, length, rest) == (0, 1, [0] * 7)
        assert ctypes.string_at(sent, length) == b"\x09"
        clocks.append(clock)
        nothing, answer, length, clock, *rest = second
        # Nothing is sent while the panel drives the line, and CS does not rise in between.
        assert (nothing, length, rest) == (0, 5, [0] * 7)
        ctypes.memmove(answer, b"\x72\x31\x82\x00\x00", length)
        clocks.append(clock)
        return 6

    monkeypatch.setattr(fcntl, "ioctl", kernel)
    for speed, expected in ((15_000_000, 2_000_000), (500_000, 500_000)):
        spi = LinuxSpi.open("/dev/spidev0.0", speed)
        assert not spidev.last.threewire
        assert spi.read(0x09, 5) == b"\x72\x31\x82\x00\x00"
        assert asked.pop() == (77, 0x40406B00)  # SPI_IOC_MESSAGE(2)
        assert [clocks.pop(), clocks.pop()] == [expected, expected]
        assert not spidev.last.sent


def test_bus_that_cannot_turn_around_says_how_to_wire_it(
    spidev: type[SpiDev], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As that of a Raspberry Pi 5."""

    class Fixed(SpiDev):
        def __setattr__(self, name: str, value: object) -> None:
            if name == "threewire" and value is True:
                raise OSError(22, "Invalid argument")
            super().__setattr__(name, value)

    sys.modules["spidev"].SpiDev = Fixed  # type: ignore[attr-defined]
    with pytest.raises(
        DeviceMissingError, match=r"cannot turn its wire .*Invalid argument.*--panel-read-back miso"
    ):
        LinuxSpi.open("/dev/spidev0.0", 1_000_000, one_wire=True)
    assert spidev.last.closed


def test_bus_that_is_not_there_says_what_to_do(
    spidev: type[SpiDev], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SpiDev, "fault", FileNotFoundError(2, "No such file or directory"))
    with pytest.raises(DeviceMissingError, match=r"No such file.*raspi-config"):
        LinuxSpi.open("/dev/spidev9.0", 1_000_000)
    assert spidev.last.closed


@pytest.mark.parametrize("path", ["/dev/spi0", "/dev/spidev0", "spidev0.0", "/dev/spidev0.0/x"])
def test_name_that_spidev_cannot_have_is_refused(spidev: type[SpiDev], path: str) -> None:
    with pytest.raises(DeviceMissingError, match=r"is no bus of spidev's: give --spi"):
        LinuxSpi.open(path, 1_000_000)


def test_lines_are_asked_for_together_and_reset_is_low(gpiod: Gpiod) -> None:
    lines = LinuxLines.open("pinctrl-rp1", data=25, reset=24)
    assert gpiod.asked["path"] == "/dev/pinctrl-rp1"
    assert gpiod.asked["config"] == {
        (25, 24): {"direction": "output", "output_value": Value.ACTIVE}
    }
    for drive in (lines.data, lines.reset):
        drive(True)
        drive(False)
    low, high = Value.INACTIVE, Value.ACTIVE
    assert gpiod.values == [(25, high), (25, low), (24, low), (24, high)]
    lines.close()
    assert gpiod.released


def test_lines_that_are_taken_say_what_to_do(gpiod: Gpiod) -> None:
    gpiod.fault = OSError(16, "Device or resource busy")
    with pytest.raises(DeviceMissingError, match=r"busy.*gpioinfo"):
        LinuxLines.open("pinctrl-rp1", data=25, reset=24)


def test_chip_is_found_by_its_label(monkeypatch: pytest.MonkeyPatch) -> None:
    labels = {"gpiochip0": "gpio-brcmstb", "gpiochip4": "pinctrl-rp1", "gpiochip9": None}

    class Chip:
        def __init__(self, path: str) -> None:
            label = labels[path.rsplit("/", 1)[-1]]
            if label is None:
                raise PermissionError(13, "Permission denied")
            self.label = label

        def __enter__(self) -> Chip:
            return self

        def __exit__(self, *_: object) -> None:
            """Nothing is open."""

        def get_info(self) -> Chip:
            return self

    monkeypatch.setitem(sys.modules, "gpiod", SimpleNamespace(Chip=Chip, request_lines=None))
    monkeypatch.setattr(Path, "glob", lambda folder, _: [folder / name for name in labels])
    assert linux_bus._chip_path("pinctrl-rp1") == "/dev/gpiochip4"
    assert linux_bus._chip_path(None) == "/dev/gpiochip4"
    with pytest.raises(
        DeviceMissingError, match="give --gpio-chip one of gpio-brcmstb, pinctrl-rp1"
    ):
        linux_bus._chip_path("pinctrl-bcm2711")
    del labels["gpiochip4"]
    with pytest.raises(DeviceMissingError, match="no GPIO chip pinctrl-rp1 or pinctrl-bcm2711"):
        linux_bus._chip_path(None)


@pytest.mark.parametrize(
    ("used", "consumer", "told"),
    [(False, "", None), (True, "fan", "fan"), (True, None, "the kernel")],
)
def test_holder_of_a_line_is_named(
    monkeypatch: pytest.MonkeyPatch, *, used: bool, consumer: str | None, told: str | None
) -> None:
    @contextmanager
    def chip(path: str) -> Iterator[object]:
        assert path == "/dev/gpiochip4"
        yield SimpleNamespace(
            get_line_info=lambda line: SimpleNamespace(used=used, consumer=consumer)
        )

    monkeypatch.setitem(sys.modules, "gpiod", SimpleNamespace(Chip=chip, request_lines=None))
    assert linux_bus.line_user(Path("/dev/gpiochip4"), 25) == told
