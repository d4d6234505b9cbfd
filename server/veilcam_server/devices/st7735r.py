"""The ST7735R panel: masks as bytes on a 4-line serial bus (Sitronix data sheet, V0.2).

One project column is one gate line of the panel, and three project rows, R, G and B, are one of its
pixels. A mask change writes the pixels of the window and nothing else; all others were made opaque
when the panel was initialised and stay so. Nothing on the bus is acknowledged, so a window is
written twice, each time with its addresses: one lost transfer then changes nothing.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np
import numpy.typing as npt

from veilcam_optics.camera.geometry import Camera
from veilcam_server.devices.base import Levels, OpenDisplay, Shown
from veilcam_server.devices.driver import DisplayDriver, EmulatedPanel
from veilcam_server.devices.errors import DisplayError, Refused
from veilcam_server.devices.spi import Lines, Spi, bus_failed, open_bus
from veilcam_server.devices.st7735r_glass import COLOURS, PIXEL_COLUMNS, PIXEL_ROWS, TABS, Tab
from veilcam_server.devices.st7735r_status import identify, is_read, require_sound
from veilcam_server.wiring import Wiring

FULL_FRAME = PIXEL_COLUMNS * PIXEL_ROWS * COLOURS
"""Bytes of all visible pixels in 6-6-6."""
MOST_PER_SECOND = 15_151_515
"""Fastest clock of the bus that the data sheet allows, 66 ns a bit [Hz]."""

_BITS = 2
"""Of every byte, the two lowest carry nothing in 6-6-6."""
_OPAQUE = bytes(4096)


@dataclass(frozen=True, slots=True)
class _Command:
    code: int
    parameters: bytes = b""
    wait: float = 0.0
    """What the panel needs before the next command [s]."""


_SETUP = (
    _Command(0x01, wait=0.150),  # SWRESET
    _Command(0x11, wait=0.500),  # SLPOUT
    _Command(0xB1, bytes.fromhex("012C2D")),  # FRMCTR1 to 3: 81 frames a second
    _Command(0xB2, bytes.fromhex("012C2D")),
    _Command(0xB3, bytes.fromhex("012C2D012C2D")),
    _Command(0xB4, bytes.fromhex("07")),  # INVCTR: line inversion
    _Command(0xC0, bytes.fromhex("A20284")),  # PWCTR1 to 5
    _Command(0xC1, bytes.fromhex("C5")),
    _Command(0xC2, bytes.fromhex("0A00")),
    _Command(0xC3, bytes.fromhex("8A2A")),
    _Command(0xC4, bytes.fromhex("8AEE")),
    _Command(0xC5, bytes.fromhex("0E")),  # VMCTR1
    _Command(0x20),  # INVOFF
)
_GAMMA = (
    _Command(0xE0, bytes.fromhex("021C07123732292D29252B3900010310")),
    _Command(0xE1, bytes.fromhex("031D07062E2C292D2E2E373F00000210")),
)
_MADCTL, _COLMOD, _CASET, _RASET, _RAMWR = 0x36, 0x3A, 0x2A, 0x2B, 0x2C
_TURNED_BGR = 0x80 | 0x40 | 0x08
"""MADCTL of MY, MX and BGR."""
_666 = b"\x06"


class ST7735R:
    """A panel on a bus. Constructing one initialises it and makes it opaque.

    Args:
        spi: the bus; closed with this.
        lines: D/C and RST; closed with this.
        camera: camera whose window is the mask.
        tab: place of the glass in the controller's memory.
        read_back: True: the panel is asked after every write if it shows its memory,
            provided that it gives its known status three times at the start.
        sleep: waits so many seconds.
        clock: monotonic time [s].

    Raises:
        DisplayError: the bus failed.
    """

    def __init__(
        self,
        spi: Spi,
        lines: Lines,
        *,
        camera: Camera,
        tab: Tab,
        read_back: bool = False,
        sleep: Callable[[float], None] = time.sleep,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        panel, window = camera.panel, camera.window
        self._spi, self._lines, self._tab = spi, lines, tab
        self._sleep, self._clock, self._read_back = sleep, clock, False
        self._madctl = _TURNED_BGR if tab.filters == "BGR" else 0
        self._shape, self._levels = camera.mask_shape, panel.levels
        first = window.first_row // COLOURS
        last = (window.first_row + window.rows - 1) // COLOURS
        self._columns = (first, last)
        self._rows = (window.first_column, window.first_column + window.columns - 1)
        # The only copy of a mask in this object, and only while it is being written. Sub-pixels
        # that share a pixel with the window's edge, but lie outside it, stay 0: opaque.
        self._pixels = np.zeros((window.columns, (last - first + 1) * COLOURS), np.uint8)
        lead = window.first_row - first * COLOURS
        self._window: npt.NDArray[np.uint8] = self._pixels[:, lead : lead + window.rows]
        with Refused(bus_failed), self._wiped():
            self._initialise()
            # Where nothing known comes back, the panel is not asked: light tells how it is.
            self._read_back = read_back and is_read(spi, lines, self._madctl)

    def show(self, levels: Levels) -> Shown:
        """Write a mask to the window."""
        if levels.shape != self._shape or levels.dtype != np.uint8:
            raise DisplayError(f"the panel takes uint8 levels of shape {self._shape}")
        if int(np.max(levels)) >= self._levels:
            raise DisplayError(f"the panel takes levels 0 to {self._levels - 1}")
        with Refused(bus_failed), self._wiped():
            np.left_shift(levels.T, _BITS, out=self._window)
            self._write_window()
            shown = Shown(self._clock())
            self._confirm()
        return shown

    def blank(self) -> None:
        """Make all visible pixels opaque, not the window alone."""
        with Refused(bus_failed), self._wiped():
            self._blank()
            self._confirm()

    def close(self) -> None:
        """Let go of the bus; the panel goes on showing what it shows."""
        self._pixels.fill(0)
        with closing(self._lines):
            self._spi.close()

    @contextmanager
    def _wiped(self) -> Iterator[None]:
        """Leave no mask behind, whatever goes wrong."""
        try:
            yield
        finally:
            self._pixels.fill(0)

    def _initialise(self) -> None:
        self._lines.reset(True)
        self._sleep(1e-4)
        self._lines.reset(False)
        self._sleep(0.120)
        for command in _SETUP:
            self._send(command)
        self._send(_Command(_MADCTL, bytes([self._madctl])))
        self._send(_Command(_COLMOD, _666))
        for command in _GAMMA:
            self._send(command)
        self._send(_Command(0x13, wait=0.010))  # NORON
        # The memory holds chance after power-up: opaque comes before the display is on.
        self._blank()
        self._send(_Command(0x29, wait=0.100))  # DISPON

    def _blank(self) -> None:
        self._address((0, PIXEL_COLUMNS - 1), (0, PIXEL_ROWS - 1))
        self._send(_Command(_RAMWR))
        for begin in range(0, FULL_FRAME, len(_OPAQUE)):
            self._spi.write(_OPAQUE[: FULL_FRAME - begin])
        # From here on the addresses are those of masks: one that is lost leaves them right.
        self._pixels.fill(0)
        self._write_window()

    def _write_window(self) -> None:
        for _ in range(2):
            self._address(self._columns, self._rows)
            self._send(_Command(_RAMWR))
            self._spi.write(self._pixels.data.cast("B"))

    def _confirm(self) -> None:
        if self._read_back:
            require_sound(self._spi, self._lines, self._madctl)

    def _address(self, columns: tuple[int, int], rows: tuple[int, int]) -> None:
        """Choose the pixels that are written next; both ends belong to them."""
        for code, (first, last), offset in (
            (_CASET, columns, self._tab.column),
            (_RASET, rows, self._tab.row),
        ):
            ends = (first + offset).to_bytes(2, "big") + (last + offset).to_bytes(2, "big")
            self._send(_Command(code, ends))

    def _send(self, command: _Command) -> None:
        self._lines.data(False)
        self._spi.write(bytes([command.code]))
        self._lines.data(True)
        if command.parameters:
            self._spi.write(command.parameters)
        if command.wait:
            self._sleep(command.wait)


def check(camera: Camera) -> None:
    """Raise :class:`DisplayError` for a camera with another panel."""
    panel = camera.panel
    if (panel.rows, panel.columns) != (PIXEL_COLUMNS * COLOURS, PIXEL_ROWS) or (
        panel.levels != 64 or panel.filter_cycle not in ((), (0, 1, 2))
    ):
        raise DisplayError(
            "the bundle is for another panel than an ST7735R: use one for 384 x 160 sub-pixels "
            "of 64 levels, with the colours R, G, B"
        )


def _open(wiring: Wiring, camera: Camera) -> ST7735R:
    assert wiring.panel_tab is not None  # noqa: S101 - the panel needs it
    with open_bus(wiring) as (spi, lines):
        return ST7735R(
            *(spi, lines),
            camera=camera,
            tab=TABS[wiring.panel_tab],
            read_back=wiring.panel_read_back is not None,
        )


def _identify(wiring: Wiring) -> str:
    with open_bus(wiring) as (spi, lines):
        answer = identify(spi, lines)
    with closing(lines):
        spi.close()
    return answer


def _emulate(
    camera: Camera, *, scan: float, settle: float, read_back: bool, clock: Callable[[], float]
) -> tuple[Callable[[], OpenDisplay], EmulatedPanel]:
    # Imported late: no real panel needs it.
    from veilcam_server.devices.simulated.panel import Crystal, PanelEmulator  # noqa: PLC0415

    emulator = PanelEmulator(
        TABS["green"],
        crystal=Crystal(scan=scan, settle=settle),
        # Nobody need wait for an emulated panel to wake up.
        reset_time=0.0,
        clock=clock,
    )
    open_display = partial(
        ST7735R,
        *(emulator, emulator),
        camera=camera,
        tab=emulator.tab,
        read_back=read_back,
        sleep=lambda _: None,
        clock=clock,
    )
    return open_display, emulator


DRIVER: Final = DisplayDriver(
    name="ST7735R",
    open=_open,
    check=check,
    identify=_identify,
    emulate=_emulate,
    packages=("spidev", "gpiod"),
    needs={"panel_tab": "red, black or green, the colour of the tab on its film (docs/device.md)"},
    fastest=MOST_PER_SECOND,
)
