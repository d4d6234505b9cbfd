"""The panel's driver: which bytes it sends when, and what is on the glass afterwards."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from veilcam_optics.camera.geometry import Camera, Panel, Window
from veilcam_server.devices import DisplayError
from veilcam_server.devices.reopening import ReopeningDisplay
from veilcam_server.devices.simulated.panel import Crystal, PanelEmulator
from veilcam_server.devices.st7735r import DRIVER, FULL_FRAME, ST7735R
from veilcam_server.devices.st7735r_glass import TABS, Tab

from .clock import Clock

CAMERA = Camera()
RNG = np.random.default_rng(8)


def draw(camera: Camera = CAMERA) -> npt.NDArray[np.uint8]:
    return RNG.integers(0, 64, camera.mask_shape, np.uint8)


def on_glass(levels: npt.NDArray[np.uint8], window: Window) -> npt.NDArray[np.uint8]:
    """What the whole panel should show."""
    frame = np.zeros((384, 160), np.uint8)
    rows = slice(window.first_row, window.first_row + window.rows)
    frame[rows, window.first_column : window.first_column + window.columns] = levels
    return frame


class Wire:
    """Notes all that goes over bus and lines; raises ``fault`` at the ``failing``-th write."""

    def __init__(self, clock: Clock) -> None:
        self.clock = clock
        self.sent: list[tuple[bool, bytes]] = []
        self.resets: list[bool] = []
        self.fault: BaseException | None = None
        self.failing = 0
        self.writes = self.closed = 0
        self.is_data = False
        self.buffers: list[memoryview] = []
        self.took = 0.0

    def write(self, buffer: memoryview | bytes) -> None:
        self.writes += 1
        if isinstance(buffer, memoryview):
            self.buffers.append(buffer)
        if self.fault is not None and self.writes == self.failing:
            raise self.fault
        self.sent.append((self.is_data, bytes(buffer)))
        self.clock.sleep(self.took)

    def read(self, command: int, count: int) -> bytes:
        raise AssertionError(f"{command:02x}h is asked, though nothing says that it can be")

    def data(self, value: bool, /) -> None:
        self.is_data = value

    def reset(self, value: bool, /) -> None:
        self.resets.append(value)

    def close(self) -> None:
        self.closed += 1


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def wire(clock: Clock) -> Wire:
    return Wire(clock)


def driver(wire: Wire, tab: Tab = TABS["green"], camera: Camera = CAMERA) -> ST7735R:
    panel = ST7735R(wire, wire, camera=camera, tab=tab, sleep=wire.clock.sleep, clock=wire.clock)
    wire.sent.clear()
    return panel


def reopening(wire: Wire) -> ReopeningDisplay:
    """The driver as a daemon has it, set up and opaque."""
    display = ReopeningDisplay("ST7735R", lambda: driver(wire), clock=wire.clock)
    display.blank()
    wire.sent.clear()
    return display


def emulated(clock: Clock, tab: Tab, camera: Camera = CAMERA) -> tuple[ST7735R, PanelEmulator]:
    emulator = PanelEmulator(tab, crystal=Crystal(scan=0.0), clock=clock)
    panel = ST7735R(emulator, emulator, camera=camera, tab=tab, sleep=clock.sleep, clock=clock)
    return panel, emulator


@pytest.mark.thorough
@pytest.mark.parametrize("tab", TABS.values(), ids=TABS)
def test_thousand_masks_are_on_the_glass_as_asked(tab: Tab, clock: Clock) -> None:
    panel, emulator = emulated(clock, tab)
    for _ in range(1000):
        levels = draw()
        panel.show(levels)
        assert np.array_equal(emulator.framebuffer(), on_glass(levels, CAMERA.window))
    panel.blank()
    assert not emulator.framebuffer().any()


def test_simulated_panel_is_driven_as_the_real_one(clock: Clock) -> None:
    assert DRIVER.emulate is not None
    set_up, emulator = DRIVER.emulate(CAMERA, scan=0.0, settle=0.5, read_back=False, clock=clock)
    panel = set_up()
    levels = draw()
    panel.show(levels)
    assert np.array_equal(emulator.framebuffer(), on_glass(levels, CAMERA.window))
    assert not emulator.settled(clock.now + 0.4)
    assert emulator.settled(clock.now + 0.6)


@pytest.mark.parametrize("tab", TABS.values(), ids=TABS)
@pytest.mark.parametrize(
    "window",
    [Window(1, 1, 0, 0), Window(1, 1, 383, 159), Window(4, 3, 2, 157), Window(384, 160, 0, 0)],
)
def test_any_window_lands_where_it_should(tab: Tab, window: Window, clock: Clock) -> None:
    camera = Camera(window=window)
    panel, emulator = emulated(clock, tab, camera)
    levels = draw(camera)
    panel.show(levels)
    assert np.array_equal(emulator.framebuffer(), on_glass(levels, window))


def test_mask_change_sends_the_window_and_nothing_else(wire: Wire) -> None:
    levels = draw()
    driver(wire).show(levels)
    # By hand: sub-pixel rows 168 to 218 are pixels 56 to 72, columns 69 to 90 are gate lines.
    pixels = b"".join(
        bytes(int(levels[3 * pixel + colour, line]) << 2 for colour in range(3))
        for line in range(22)
        for pixel in range(17)
    )
    sent = ((b"\x2a", b"\x00\x3a\x00\x4a"), (b"\x2b", b"\x00\x46\x00\x5b"), (b"\x2c", pixels))
    assert wire.sent == 2 * [part for code, data in sent for part in ((False, code), (True, data))]
    assert sum(len(sent) for _, sent in wire.sent) <= 4500 < FULL_FRAME == 61_440


SETUP = """
    reset 1   wait 0.0001
    reset 0   wait 0.12
    01        wait 0.15       # SWRESET
    11        wait 0.5        # SLPOUT
    B1 01 2C 2D               # FRMCTR1
    B2 01 2C 2D               # FRMCTR2
    B3 01 2C 2D 01 2C 2D      # FRMCTR3
    B4 07                     # INVCTR
    C0 A2 02 84               # PWCTR1
    C1 C5                     # PWCTR2
    C2 0A 00                  # PWCTR3
    C3 8A 2A                  # PWCTR4
    C4 8A EE                  # PWCTR5
    C5 0E                     # VMCTR1
    20                        # INVOFF
    36 {turned}               # MADCTL
    3A 06                     # COLMOD
    E0 02 1C 07 12 37 32 29 2D 29 25 2B 39 00 01 03 10  # GMCTRP1
    E1 03 1D 07 06 2E 2C 29 2D 2E 2E 37 3F 00 00 02 10  # GMCTRN1
    13        wait 0.01       # NORON
    2A {columns}              # CASET
    2B {rows}                 # RASET
    2C {black}                # RAMWR
    2A {window_columns}       # the window, twice: its addresses stay
    2B {window_rows}
    2C {window}
    2A {window_columns}
    2B {window_rows}
    2C {window}
    29        wait 0.1        # DISPON
"""
"""All from power to picture: no emulator shows a wrong voltage, a wrong gamma, a missing pause."""
PLACES = ("turned", "columns", "rows", "window_columns", "window_rows")


@pytest.mark.parametrize(
    ("tab", "places"),
    [
        ("red", ("C8", "00 00 00 7F", "00 00 00 9F", "00 38 00 48", "00 45 00 5A")),
        ("black", ("00", "00 00 00 7F", "00 00 00 9F", "00 38 00 48", "00 45 00 5A")),
        ("green", ("C8", "00 02 00 81", "00 01 00 A0", "00 3A 00 4A", "00 46 00 5B")),
    ],
)
def test_set_up_is_the_data_sheet_s(tab: str, places: tuple[str, ...], clock: Clock) -> None:
    done: list[tuple[str, Any]] = []

    class Noting(Wire):
        def write(self, buffer: memoryview | bytes) -> None:
            if self.is_data and done[-1][0] == "data":
                done.append(("data", done.pop()[1] + bytes(buffer)))
            else:
                done.append(("data" if self.is_data else "command", bytes(buffer)))

        def reset(self, value: bool, /) -> None:
            done.append(("reset", value))

    wanted: list[tuple[str, Any]] = []
    given = dict(zip(PLACES, places, strict=True))
    for line in SETUP.strip().splitlines():
        words, _, wait = line.partition("#")[0].partition("wait")
        first, *rest = words.split()
        if first == "reset":
            wanted.append(("reset", rest == ["1"]))
        else:
            wanted.append(("command", bytes.fromhex(first)))
            filled = " ".join(rest).format(black="00" * 61_440, window="00" * 1122, **given)
            wanted += [("data", bytes.fromhex(filled))] if filled else []
        wanted += [("wait", float(wait))] if wait else []
    noting = Noting(clock)
    sleep = lambda seconds: done.append(("wait", seconds))  # noqa: E731
    ST7735R(noting, noting, camera=CAMERA, tab=TABS[tab], sleep=sleep, clock=clock)
    assert done == wanted


@pytest.mark.parametrize("cycle", [(), (0, 1, 2)])
def test_panel_with_or_without_colours_is_driven(cycle: tuple[int, ...], wire: Wire) -> None:
    camera = Camera(panel=Panel(filter_cycle=cycle))
    driver(wire, camera=camera).show(np.full(camera.mask_shape, 63, np.uint8))
    assert wire.sent


def test_driver_that_breaks_off_sets_the_panel_up_anew(wire: Wire) -> None:
    """Whatever it was, nobody knows which bytes were sent."""
    panel = reopening(wire)
    wire.fault, wire.failing = KeyboardInterrupt(), wire.writes + 6
    with pytest.raises(KeyboardInterrupt):
        panel.show(draw())
    assert not any(wire.buffers[-1])
    panel.show(draw())
    assert panel.resets == 1


def test_lines_are_let_go_although_the_bus_is_not(wire: Wire) -> None:
    class Stuck(Wire):
        def close(self) -> None:
            raise OSError("busy")

    panel = ST7735R(Stuck(wire.clock), wire, camera=CAMERA, tab=TABS["red"], sleep=wire.clock.sleep)
    with pytest.raises(OSError, match="busy"):
        panel.close()
    assert wire.closed == 1


@pytest.mark.parametrize("tab", TABS.values(), ids=TABS)
def test_panel_is_never_lit_with_chance(tab: Tab, clock: Clock) -> None:
    class Watched(PanelEmulator):
        def write(self, buffer: memoryview | bytes) -> None:
            super().write(buffer)
            assert self.transparent or not self.framebuffer().any()

    emulator = Watched(tab, clock=clock)
    assert emulator.transparent
    ST7735R(emulator, emulator, camera=CAMERA, tab=tab, sleep=clock.sleep, clock=clock)
    assert not emulator.transparent


def test_time_of_completion_is_after_the_last_byte(wire: Wire) -> None:
    panel = driver(wire)
    wire.took = 0.5
    began = wire.clock.now
    assert panel.show(draw()).completed_at == began + 12 * 0.5


@pytest.mark.parametrize(
    "levels",
    [np.zeros((22, 51), np.uint8), np.zeros((51, 22), np.int64), np.full((51, 22), 64, np.uint8)],
)
def test_levels_it_cannot_show_are_refused_before_the_bus(
    levels: npt.NDArray[np.uint8], wire: Wire
) -> None:
    panel = driver(wire)
    with pytest.raises(DisplayError):
        panel.show(levels)
    assert not wire.sent


@pytest.mark.parametrize(
    "panel", [Panel(rows=240), Panel(columns=161), Panel(levels=32), Panel(filter_cycle=(2, 1, 0))]
)
def test_another_panel_is_refused(panel: Panel) -> None:
    with pytest.raises(DisplayError, match="another panel"):
        DRIVER.check(Camera(panel=panel, window=Window(3, 3, 0, 0)))


@pytest.mark.parametrize("act", [lambda panel: panel.show(draw()), ReopeningDisplay.blank])
def test_failing_bus_is_a_display_error_and_sets_the_panel_up_anew(
    act: Callable[[ReopeningDisplay], None], wire: Wire
) -> None:
    panel = reopening(wire)
    wire.fault, wire.failing = OSError(5, "Input/output error"), wire.writes + 4
    with pytest.raises(DisplayError, match=r"Input/output error.*check") as caught:
        act(panel)
    assert caught.value.__cause__ is None
    assert wire.closed == 2
    resets = len(wire.resets)
    act(panel)
    assert wire.resets[resets:] == [True, False]
    wire.sent.clear()
    act(panel)
    assert wire.sent[0] == (False, b"\x2a")


def test_bus_that_fails_at_the_start_is_an_error(wire: Wire) -> None:
    wire.fault, wire.failing = TimeoutError(), 1
    with pytest.raises(DisplayError, match="TimeoutError"):
        driver(wire)


def test_no_pattern_stays_behind(wire: Wire) -> None:
    panel = driver(wire)
    panel.show(draw())
    assert len(wire.buffers[-1]) == 51 * 22
    assert not any(map(any, wire.buffers))
    wire.fault, wire.failing = OSError(5, "Input/output error"), wire.writes + 6
    with pytest.raises(DisplayError):
        panel.show(draw())
    assert not any(wire.buffers[-1])
    panel.close()
    assert wire.closed == 2


def test_masks_are_not_in_any_repr(clock: Clock) -> None:
    panel, emulator = emulated(clock, TABS["green"])
    panel.show(np.full(CAMERA.mask_shape, 37, np.uint8))
    assert not any("37" in repr(turn) or "array" in repr(turn) for turn in emulator._turns)


class Losing(PanelEmulator):
    """A panel whose bus loses one transfer."""

    sent, lose = 0, -1

    def write(self, buffer: memoryview | bytes) -> None:
        if self.sent != self.lose:
            super().write(buffer)
        self.sent += 1


@pytest.mark.parametrize("tab", TABS.values(), ids=TABS)
def test_one_lost_transfer_of_a_change_leaves_the_right_mask(tab: Tab, clock: Clock) -> None:
    bus = Losing(tab, clock=clock)
    panel = ST7735R(bus, bus, camera=CAMERA, tab=tab, sleep=clock.sleep, clock=clock)
    opaque = np.zeros(CAMERA.mask_shape, np.uint8)
    transfers = 24
    for before in (panel.blank, lambda: panel.show(draw())):
        for lost in range(transfers):
            before()
            bus.sent, bus.lose, levels = 0, lost, draw()
            panel.show(opaque)
            panel.show(levels)
            assert bus.sent == transfers
            bus.lose = -1
            assert np.array_equal(bus.framebuffer(), on_glass(levels, CAMERA.window))
