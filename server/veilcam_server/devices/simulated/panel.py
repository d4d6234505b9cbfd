"""An ST7735R to the byte, below the bus: what a driver sends is what the crystal shows.

Written from the data sheet (Sitronix ST7735R, V0.2), not from the driver: it takes any order of
commands and any split of the bytes.
"""

from __future__ import annotations

import errno
import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from veilcam_client.wire.simulation import PanelFaults
from veilcam_server.devices.st7735r_glass import COLOURS, PIXEL_COLUMNS, PIXEL_ROWS, Tab

_Bytes = npt.NDArray[np.uint8]
Shown = npt.NDArray[np.float32]
"""What the crystal shows, 0 (opaque) to 63 (open), shape (384, 160): sub-pixels as mounted."""
_TOP = 63
_MEMORY = (162, 132)
"""Rows and columns of pixels that the controller has."""
REFRESH = 0.0123
"""Time of a scan over all lines at the frame rate that the driver sets [s]."""
_KEPT = 8
"""Changes that are remembered, so that an exposure over several of them can be evaluated."""

_NOP, _SWRESET, _SLPIN, _SLPOUT = 0x00, 0x01, 0x10, 0x11
_RDDID, _RDDST, _RDDPM = 0x04, 0x09, 0x0A
_INVOFF, _INVON, _DISPOFF, _DISPON = 0x20, 0x21, 0x28, 0x29
_CASET, _RASET, _RAMWR, _MADCTL, _COLMOD = 0x2A, 0x2B, 0x2C, 0x36, 0x3A
_MY, _MX, _MV, _BGR = 0x80, 0x40, 0x20, 0x08
_VISIBLE_BY_DATA = frozenset({_RAMWR, _MADCTL, _CASET, _RASET, _COLMOD})
"""Commands that change nothing by themselves; all others change nothing by their parameters."""
_BITS_PER_PIXEL = {0x03: 12, 0x05: 16, 0x06: 18}
_PIXEL_FORMATS = {bits: code for code, bits in _BITS_PER_PIXEL.items()}
_IDENTITY = 0x7C89F0
"""A maker writes it to the controller's own memory; bit 15 is always 1 (data sheet, 10.1.3)."""
_DUMMY = "1"
"""What is on the line for the one clock before longer answers is not said: not what follows."""


@dataclass(frozen=True, slots=True)
class Crystal:
    """Crystal: its response to a change in the memory."""

    scan: float = REFRESH
    """Time between two refreshes of a gate line [s]; 0 for at once."""
    phase: float = 0.0
    """When a refresh of the first line began, monotonic [s]."""
    settle: float = 0.0
    """What a sub-pixel takes from its refresh until it has turned, linearly [s]."""


@dataclass(frozen=True)
class _Turn:
    """Turn of the crystal from ``before`` to ``after``, for the changes ``at``."""

    at: float
    before: Shown = field(repr=False)
    after: _Bytes = field(repr=False)


class PanelEmulator:
    """A panel: an ``Spi`` and a ``Lines`` in one, and a crystal that can be looked at.

    Args:
        tab: tab: the way glass and controller are joined.
        crystal: crystal with its response time.
        faults: faults of the panel.
        reset_time: time after a reset in which commands are ignored, 120 ms on the real one [s].
        clock: monotonic time [s].
        seed: seed of the memory's contents after power-up.
    """

    def __init__(
        self,
        tab: Tab,
        *,
        crystal: Crystal = Crystal(),
        faults: PanelFaults = PanelFaults(),  # noqa: B008 - immutable
        reset_time: float = 0.120,
        clock: Callable[[], float] = time.monotonic,
        seed: int = 0,
    ) -> None:
        self.tab, self.crystal, self._faults = tab, crystal, faults
        self._reset_time, self._clock = reset_time, clock
        random = np.random.default_rng(seed)
        self._memory = random.integers(0, _TOP + 1, (*_MEMORY, COLOURS), np.uint8)
        self.bytes_received = 0
        self._writes = 0
        self._is_data = False
        self._in_reset = self._asleep = self._fell = False
        self._busy_until = -math.inf
        self._madctl = 0
        self._reset()
        self._turns: deque[_Turn] = deque(maxlen=_KEPT)
        after = self.framebuffer()
        self._turns.append(_Turn(-math.inf, after.astype(np.float32), after))

    def write(self, buffer: memoryview | bytes) -> None:
        """Receive bytes under the present level of D/C; OSError if it is gone."""
        self._receive(np.frombuffer(buffer, np.uint8))

    def read(self, command: int, count: int) -> bytes:
        """Receive a command, and answer until CS rises; OSError if it is gone.

        A line that nobody drives is low: a Raspberry Pi pulls those of its bus down.
        """
        taken = self._receive(np.array([command], np.uint8))
        said = self._say(command) if taken and not self._is_data else ""
        return int(said.ljust(8 * count, "0")[: 8 * count], 2).to_bytes(count, "big")

    def _receive(self, received: _Bytes) -> bool:
        """Return whether it took the bytes."""
        self._require_connected()
        self.bytes_received += received.size
        self._writes += 1
        lost = self._faults.lost and self._writes % self._faults.lost == 0
        if self._deaf or self._in_reset or lost or self._clock() < self._busy_until:
            return False
        if self._is_data:
            self._take_data(received)
            if self._command in _VISIBLE_BY_DATA:
                self._changed()
            return True
        for code in received.tolist():
            self._take_command(code)
        if not _VISIBLE_BY_DATA.issuperset(received.tolist()):
            self._changed()
        return True

    def _say(self, command: int) -> str:
        """Bits that it sends after a command (data sheet, 9.4.3 and 10.1.3 to 10.1.5)."""
        awake, on = not self._asleep, self._on
        if command == _RDDID:
            return f"{_DUMMY}{_IDENTITY:024b}"
        if command == _RDDPM:
            # BSTON, IDMON, PTLON, SLPOUT, NORON, DISON, and two that are 0.
            return f"{awake:b}00{awake:b}1{on:b}00"
        if command != _RDDST:
            return ""
        # BSTON, then MY, MX, MV, ML, RGB, MH and ST24 as MADCTL has the first six.
        first = f"{awake:b}{self._madctl >> 2:06b}0"
        # ST23, the pixel format, then IDMON, PTLON, SLPOUT and NORON.
        second = f"0{_PIXEL_FORMATS[self._bits]:03b}00{awake:b}1"
        # ST15, ST14, INVON, ST12, ST11, DISON, TEON and GCS2; gamma and others are 0.
        return f"{_DUMMY}{first}{second}00{self._inverted:b}00{on:b}00{0:08b}"

    def data(self, value: bool, /) -> None:
        """D/C."""
        self._is_data = value

    def reset(self, value: bool, /) -> None:
        """RST: the registers fall back, the memory stays."""
        self._require_connected()
        self._in_reset = value
        if not self._deaf:
            self._madctl = 0
            self._reset()
            self._busy_until = self._clock() + self._reset_time
            self._changed()

    def close(self) -> None:
        """Whoever drove it lets go; it goes on showing what it shows."""

    @property
    def faults(self) -> PanelFaults:
        """Faults of the panel."""
        return self._faults

    @faults.setter
    def faults(self, faults: PanelFaults) -> None:
        if faults.asleep != self._faults.asleep:
            # Falling asleep is an event: a reset wakes the panel up, whatever is said here.
            self._asleep = faults.asleep or (self._asleep and not self._fell)
            self._fell = faults.asleep
        self._faults = faults
        self._changed()

    @property
    def transparent(self) -> bool:
        """Return whether it is without power, asleep or off: a white panel is then open."""
        return self._faults.dead or self._faults.gone or self._asleep or not self._on

    @property
    def _deaf(self) -> bool:
        return self._faults.dead or self._faults.stuck

    def _require_connected(self) -> None:
        if self._faults.gone:
            raise OSError(errno.ENODEV, "No such device")

    def framebuffer(self) -> _Bytes:
        """Return the picture of the memory in the present state, 0 to 63, shape (384, 160)."""
        shape = (PIXEL_COLUMNS * COLOURS, PIXEL_ROWS)
        if self.transparent:
            return np.full(shape, _TOP, np.uint8)
        turned = self.tab.filters == "BGR"
        columns, rows = self.tab.memory
        # A tab names the first address as its makers' drivers see it: turned, from the far corner.
        left = columns - PIXEL_COLUMNS - self.tab.column if turned else self.tab.column
        top = rows - PIXEL_ROWS - self.tab.row if turned else self.tab.row
        pixels = self._memory[top : top + PIXEL_ROWS, left : left + PIXEL_COLUMNS]
        if self._madctl & _BGR:
            pixels = pixels[:, :, ::-1]
        lines = pixels.reshape(PIXEL_ROWS, -1)
        if turned:
            lines = lines[::-1, ::-1]
        levels = np.ascontiguousarray(lines.T)
        return _TOP - levels if self._inverted != self._faults.inverted else levels

    def visible(self, at: float) -> Shown:
        """Return the picture of the crystal at a time not before the last few changes [s]."""
        turn = next(
            (turn for turn in reversed(tuple(self._turns)) if turn.at <= at), self._turns[0]
        )
        return self._between(turn, at)

    def settled(self, at: float) -> bool:
        """Return whether nothing turns any more [s]: it shows the framebuffer until then."""
        return self._turns[-1].at + self.crystal.scan + self.crystal.settle <= at

    def _changed(self) -> None:
        """Turn the crystal from what it shows now to what it is asked to show."""
        asked, last, now = self.framebuffer(), self._turns[-1], self._clock()
        if not np.array_equal(asked, last.after):
            self._turns.append(_Turn(now, self._between(last, now), asked))

    def _between(self, turn: _Turn, at: float) -> Shown:
        scan, settle = self.crystal.scan, self.crystal.settle
        if math.isinf(turn.at):
            return turn.before
        refreshed = np.full(PIXEL_ROWS, turn.at)
        if scan > 0:
            # Gate line g is refreshed at phase + (n + g / lines) scan, for all whole n.
            lines = np.arange(PIXEL_ROWS)
            if self.tab.filters == "BGR":
                lines = lines[::-1]
            first = self.crystal.phase + scan * lines / PIXEL_ROWS
            refreshed = first + np.ceil((turn.at - first) / scan) * scan
        since = at - refreshed
        turned = np.clip(since / settle, 0, 1) if settle > 0 else (since >= 0).astype(float)
        return turn.before + (turn.after - turn.before) * turned.astype(np.float32)

    def _reset(self) -> None:
        self._asleep, self._on, self._inverted = True, False, False
        self._fell = False
        self._bits = 18
        columns, rows = self.tab.memory
        self._window = {_CASET: [0, columns - 1], _RASET: [0, rows - 1]}
        self._command, self._pending = _NOP, b""
        self._parameters = 0
        self._pointer = 0

    def _take_command(self, code: int) -> None:
        # What was received of a pixel or parameter is dropped, complete parameters are kept.
        self._command, self._pending, self._parameters = code, b"", 0
        if code == _SWRESET:
            self._reset()
            self._busy_until = self._clock() + self._reset_time
        elif code in (_SLPIN, _SLPOUT):
            self._asleep = code == _SLPIN
        elif code in (_DISPOFF, _DISPON):
            self._on = code == _DISPON
        elif code in (_INVOFF, _INVON):
            self._inverted = code == _INVON
        elif code == _RAMWR:
            self._pointer = 0

    def _take_data(self, received: _Bytes) -> None:
        if self._command in self._window:
            self._take_ends(received.tobytes())
        elif self._command == _RAMWR:
            self._take_pixels(received)
        elif self._parameters == 0 and received.size:
            self._parameters = 1
            value = int(received[0])
            if self._command == _MADCTL:
                self._madctl = value
            elif self._command == _COLMOD:
                self._bits = _BITS_PER_PIXEL.get(value & 0x07, self._bits)

    def _take_ends(self, received: bytes) -> None:
        received = self._pending + received
        whole = len(received) // 2 * 2
        for begin in range(0, whole, 2):
            if self._parameters < 2:
                self._window[self._command][self._parameters] = int.from_bytes(
                    received[begin : begin + 2], "big"
                )
                self._parameters += 1
        self._pending = received[whole:]

    def _take_pixels(self, received: _Bytes) -> None:
        joined = np.concatenate([np.frombuffer(self._pending, np.uint8), received])
        # Twelve-bit pixels come in pairs of three bytes; the first of a pair is whole after two.
        unit = {12: 3, 16: 2, 18: 3}[self._bits]
        whole = joined.size // unit * unit
        pixels = _decode(joined[:whole], self._bits)
        if self._faults.half:
            pixels = pixels[: len(pixels) // 2]
        rest = joined[whole:]
        self._store(pixels)
        if self._bits == 12 and rest.size == 2:
            self._store(_decode(np.append(rest, np.uint8(0)), 12)[:1])
            # Its second half waits for the third byte, and is stored then, in its own place.
            self._pointer -= 1
        self._pending = rest.tobytes()

    def _store(self, pixels: _Bytes) -> None:
        (left, right), (top, bottom) = self._window[_CASET], self._window[_RASET]
        if left > right or top > bottom:
            return
        width, height = right - left + 1, bottom - top + 1
        place = (self._pointer + np.arange(len(pixels))) % (width * height)
        self._pointer = int((self._pointer + len(pixels)) % (width * height))
        x, y = left + place % width, top + place // width + self._faults.shifted
        if self._madctl & _MV:
            x, y = y, x
        columns, rows = self.tab.memory
        if self._madctl & _MX:
            x = columns - 1 - x
        if self._madctl & _MY:
            y = rows - 1 - y
        inside = (x >= 0) & (x < columns) & (y >= 0) & (y < rows)
        self._memory[y[inside], x[inside]] = pixels[inside]


def _decode(received: _Bytes, bits: int) -> _Bytes:
    """Pixels of 6-6-6, shape (count, 3), from whole bytes in 4-4-4, 5-6-5 or 6-6-6."""
    if bits == 18:
        return _as_bytes(received >> 2).reshape(-1, COLOURS)
    if bits == 16:
        high, low = received[0::2], received[1::2]
        red, blue = _as_bytes(high >> 3), _as_bytes(low & 0x1F)
        green = _as_bytes(((high & 0x07) << 3) | (low >> 5))
        # The table from 5 to 6 bits may be loaded (RGBSET); this is the one that keeps both ends.
        return np.stack([_widen(red, 5), green, _widen(blue, 5)], axis=1)
    nibbles = np.stack([_as_bytes(received >> 4), _as_bytes(received & 0x0F)], axis=1)
    return _widen(nibbles.reshape(-1, COLOURS), 4)


def _widen(values: _Bytes, bits: int) -> _Bytes:
    """Return six bits from ``bits``, the highest bits repeated below the lowest."""
    return _as_bytes((values << (6 - bits)) | (values >> (2 * bits - 6)))


def _as_bytes(values: npt.NDArray[np.integer]) -> _Bytes:
    return values.astype(np.uint8, copy=False)
