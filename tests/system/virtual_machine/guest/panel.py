"""The panel's driver on the real py-spidev and gpiod, and what came out of the bus.

panel.py serve      veilcamd, whose simulated panel's bytes also leave over the bus
panel.py write      shows masks, and compares what came out with what an emulator took
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import patch

import numpy as np

from veilcam_optics.camera.geometry import Camera
from veilcam_server.devices import st7735r
from veilcam_server.devices.simulated.panel import PanelEmulator
from veilcam_server.devices.spi import LinuxLines, LinuxSpi
from veilcam_server.devices.st7735r import ST7735R
from veilcam_server.devices.st7735r_glass import TABS

from .prepare import DATA, LABEL, RESET, SHARED, SPI

SPEED = 15_000_000
MASKS = 20

Byte = tuple[bool, int]


class Both:
    """A bus and its lines that passes everything to the hardware and to an emulator."""

    def __init__(self, emulator: PanelEmulator) -> None:
        self._emulator, self._data = emulator, True
        self._spi = LinuxSpi.open(str(SPI), SPEED)
        self._lines = LinuxLines.open(LABEL, data=DATA, reset=RESET)
        self.sent: list[Byte] = []
        self._closed = False

    def write(self, buffer: memoryview | bytes) -> None:
        self._spi.write(buffer)
        self._emulator.write(buffer)
        self.sent += [(self._data, value) for value in bytes(buffer)]

    def read(self, command: int, count: int) -> bytes:
        """Ask the emulator: nobody answers on a bus in user space."""
        return self._emulator.read(command, count)

    def data(self, value: bool, /) -> None:
        self._lines.data(value)
        self._emulator.data(value)
        self._data = value

    def reset(self, value: bool, /) -> None:
        self._lines.reset(value)
        self._emulator.reset(value)

    def close(self) -> None:
        if not self._closed:
            self._closed = True
            self._spi.close()
            self._lines.close()


def came_out(log: bytes) -> Iterator[Byte]:
    at = 0
    while at < len(log):
        data, length = log[at : at + 1] == b"1", int.from_bytes(log[at + 1 : at + 5], "little")
        for value in log[at + 5 : at + 5 + length]:
            yield data, value
        at += 5 + length


def shown(passed: list[Byte], tab: str = "green") -> PanelEmulator:
    panel = PanelEmulator(TABS[tab], reset_time=0.0)
    begin = 0
    for end in range(1, len(passed) + 1):
        if end == len(passed) or passed[end][0] != passed[begin][0]:
            panel.data(passed[begin][0])
            panel.write(bytes(value for _, value in passed[begin:end]))
            begin = end
    return panel


def write(log: Path) -> str:
    camera, random = Camera(), np.random.default_rng(5)
    compared = 0
    for name, tab in TABS.items():
        before = log.stat().st_size
        emulator = PanelEmulator(tab, reset_time=0.0)
        bus = Both(emulator)
        panel = ST7735R(bus, bus, camera=camera, tab=tab)
        for _ in range(MASKS):
            panel.show(random.integers(0, camera.panel.levels, camera.mask_shape, np.uint8))
        shown_last = emulator.framebuffer().copy()
        passed = list(came_out(log.read_bytes()[before:]))
        if passed != bus.sent:
            raise SystemExit(f"{name} tab: {len(passed)} bytes came out, {len(bus.sent)} went in")
        if not shown_last.any() or not np.array_equal(
            shown(passed, name).framebuffer(), shown_last
        ):
            raise SystemExit(f"{name} tab: the panel shows something else")
        panel.close()
        compared += len(passed)
    return f"{compared} bytes, {len(TABS)} tabs, {MASKS} masks each"


def serve() -> None:
    from veilcam_server.cli import main as cli

    def on_both(spi: PanelEmulator, _: object, **more: object) -> ST7735R:
        bus = Both(spi)
        return ST7735R(bus, bus, **more)  # type: ignore[arg-type]

    with patch.object(st7735r, "ST7735R", on_both):
        cli.main()


def main() -> None:
    if sys.argv[1] == "write":
        print(write(SHARED / "bus"))  # noqa: T201
    else:
        serve()


if __name__ == "__main__":
    main()
