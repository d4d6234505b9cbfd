"""The emulated panel against the data sheet, without our driver."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from tests.unit.server.devices.clock import Clock

from veilcam_client.wire.simulation import PanelFaults
from veilcam_server.devices.simulated.panel import Crystal, PanelEmulator
from veilcam_server.devices.st7735r_glass import TABS

AT_ONCE, SOUND = Crystal(scan=0.0), PanelFaults()


class Host:
    """Sends commands to a panel with the plain order of colours and no offsets."""

    def __init__(
        self, *, crystal: Crystal = AT_ONCE, faults: PanelFaults = SOUND, tab: str = "black"
    ) -> None:
        self.clock = Clock()
        self.panel = PanelEmulator(TABS[tab], crystal=crystal, faults=faults, clock=self.clock)

    def send(self, code: int, *parameters: int) -> None:
        self.panel.data(False)
        self.panel.write(bytes([code]))
        self.panel.data(True)
        if parameters:
            self.panel.write(bytes(parameters))

    def wake(self) -> None:
        self.send(0x11)
        self.send(0x29)

    def window(self, left: int, right: int, top: int, bottom: int) -> None:
        self.send(0x2A, 0, left, 0, right)
        self.send(0x2B, 0, top, 0, bottom)

    def clear(self) -> None:
        self.window(0, 127, 0, 159)
        self.send(0x2C)
        self.panel.write(bytes(128 * 160 * 3))

    def pixel(self, column: int, row: int) -> list[int]:
        frame = self.panel.framebuffer()
        return [int(value) for value in frame[3 * column : 3 * column + 3, row]]

    def lit(self) -> set[tuple[int, int]]:
        rows, columns = np.nonzero(self.panel.framebuffer())
        return {(int(row) // 3, int(column)) for row, column in zip(rows, columns, strict=True)}


@pytest.fixture
def host() -> Host:
    host = Host()
    host.wake()
    host.clear()
    return host


def test_asleep_or_off_it_is_transparent(host: Host) -> None:
    fresh = Host()
    assert (fresh.panel.framebuffer() == 63).all()
    fresh.send(0x11)
    assert fresh.panel.transparent
    fresh.send(0x29)
    assert fresh.panel.framebuffer().std() > 10  # chance is in the memory after power-up
    assert not host.panel.framebuffer().any()
    for off, on in ((0x28, 0x29), (0x10, 0x11)):
        host.send(off)
        assert (host.panel.framebuffer() == 63).all()
        host.send(on)
        assert not host.panel.framebuffer().any()


def test_commands_in_one_write_all_count(host: Host) -> None:
    host.panel.data(False)
    host.panel.write(b"\x28\x2a")  # DISPOFF, CASET
    assert (host.panel.visible(host.clock.now) == 63).all()


def test_both_resets_switch_it_off_and_keep_the_memory(host: Host) -> None:
    host.window(5, 5, 6, 6)
    host.send(0x2C, 4, 8, 12)
    for by_line in (False, True):
        if by_line:
            host.panel.reset(True)
        else:
            host.send(0x01)
        assert host.panel.transparent
        host.panel.reset(False)
        host.clock.sleep(0.2)
        host.wake()
        assert host.pixel(5, 6) == [1, 2, 3]


def test_after_a_reset_it_needs_time(host: Host) -> None:
    host.send(0x01)
    host.clock.sleep(0.1)
    host.wake()
    assert host.panel.transparent
    host.clock.sleep(0.03)
    host.wake()
    assert not host.panel.transparent


def test_while_rst_is_low_nothing_is_taken(host: Host) -> None:
    host.panel.reset(True)
    host.clock.sleep(1.0)
    host.wake()
    assert host.panel.transparent


def test_pixels_fill_the_window_by_columns_then_rows_and_start_again(host: Host) -> None:
    host.window(10, 11, 20, 22)
    host.send(0x2C)
    host.panel.write(bytes(value << 2 for pixel in range(1, 8) for value in (pixel, 0, 0)))
    seen = [host.pixel(column, row)[0] for row in (20, 21, 22) for column in (10, 11)]
    assert seen == [7, 2, 3, 4, 5, 6]
    assert host.lit() == {(column, row) for row in (20, 21, 22) for column in (10, 11)}


def test_write_begins_at_the_window_s_first_pixel(host: Host) -> None:
    host.window(0, 3, 0, 0)
    host.send(0x2C, 4, 4, 4, 8, 8, 8)
    host.send(0x2C, 12, 12, 12)
    assert [host.pixel(column, 0)[0] for column in range(3)] == [3, 2, 0]


def test_pixel_survives_a_split_and_not_a_command(host: Host) -> None:
    host.window(0, 1, 0, 0)
    host.send(0x2C, 4)
    host.panel.write(bytes([8]))
    assert host.pixel(0, 0) == [0, 0, 0]
    host.panel.write(bytes([12, 16]))
    assert host.pixel(0, 0) == [1, 2, 3]
    host.send(0x00)  # NOP
    host.panel.write(bytes([20, 24]))
    assert host.lit() == {(0, 0)}
    host.send(0x2C, 40, 44)
    host.send(0x2C, 4, 4, 4)
    assert host.pixel(0, 0) == [1, 1, 1]


def test_complete_parameters_are_kept_and_half_ones_dropped(host: Host) -> None:
    host.window(0, 9, 0, 0)
    host.send(0x2A, 0, 4)
    host.send(0x2C, 4, 4, 4)
    assert host.lit() == {(4, 0)}
    host.send(0x2A, 0, 6, 0)
    host.send(0x2C, *[8] * 12)
    # Columns 6 to 9: the end of before.
    assert host.lit() == {(4, 0), (6, 0), (7, 0), (8, 0), (9, 0)}


def test_unknown_commands_and_windows_that_cannot_be_do_nothing(host: Host) -> None:
    host.send(0xF7, 1, 2, 3)
    host.window(9, 4, 0, 0)
    host.send(0x2C, *[255] * 30)
    host.window(128, 140, 0, 0)
    host.send(0x2C, *[255] * 30)
    assert not host.lit()


@pytest.mark.parametrize(
    ("madctl", "first", "second"),
    [
        (0x00, (1, 2), (2, 2)),
        (0x40, (126, 2), (125, 2)),
        (0x80, (1, 157), (2, 157)),
        (0xC0, (126, 157), (125, 157)),
        (0x20, (2, 1), (2, 2)),
        (0x60, (125, 1), (125, 2)),
        (0xE0, (125, 158), (125, 157)),
    ],
)
def test_directions(
    madctl: int, first: tuple[int, int], second: tuple[int, int], host: Host
) -> None:
    host.send(0x36, madctl)
    host.window(1, 10, 2, 10)
    host.send(0x2C, 4, 8, 12, 16, 20, 24)
    assert (host.pixel(*first), host.pixel(*second)) == ([1, 2, 3], [4, 5, 6])


def test_bgr_swaps_the_outer_colours(host: Host) -> None:
    host.send(0x36, 0x08)
    host.window(0, 0, 0, 0)
    host.send(0x2C, 4, 8, 12)
    assert host.pixel(0, 0) == [3, 2, 1]


def test_inversion(host: Host) -> None:
    host.send(0x21)
    assert (host.panel.framebuffer() == 63).all()
    host.send(0x20)
    assert not host.panel.framebuffer().any()


@pytest.mark.parametrize("split", [1, 2, 3, 4, 5, 100])
@pytest.mark.parametrize(
    ("colmod", "sent", "expected"),
    [
        # 4-4-4: two pixels in three bytes.
        (0x03, [0xF0, 0x12, 0x34, 0x56, 0x78], [[63, 0, 4], [8, 12, 17], [21, 25, 29]]),
        (0x05, [0xF8, 0x1F, 0x07, 0xE0, 0x84, 0x21], [[63, 0, 63], [0, 63, 0], [33, 33, 2]]),
        (0x06, [0xFF, 0x03, 0x04, 0x80, 0x7C, 0x00], [[63, 0, 1], [32, 31, 0]]),
    ],
)
def test_formats(
    colmod: int, sent: list[int], expected: list[list[int]], split: int, host: Host
) -> None:
    host.send(0x3A, colmod)
    host.window(3, 9, 4, 5)
    host.send(0x2C)
    for begin in range(0, len(sent), split):
        host.panel.write(bytes(sent[begin : begin + split]))
    assert [host.pixel(3 + number, 4) for number in range(len(expected))] == expected
    assert host.pixel(3 + len(expected), 4) == [0, 0, 0]


def test_dead_panel_takes_nothing_and_is_transparent() -> None:
    host = Host(faults=PanelFaults(dead=True))
    host.panel.reset(False)
    host.wake()
    host.clear()
    assert (host.panel.framebuffer() == 63).all()


def test_every_so_many_th_write_is_lost(host: Host) -> None:
    # Three writes for the command, its parameters and pixels: the third is the one that is lost.
    host.panel.faults = PanelFaults(lost=3)
    host.panel._writes = 0
    host.window(0, 0, 0, 0)
    before = host.panel.bytes_received
    host.send(0x2C)
    host.panel.write(bytes([4, 8, 12]))
    assert host.panel.bytes_received == before + 4  # they were on the bus
    assert not host.lit()


def shown(host: Host, at: float) -> npt.NDArray[np.float32]:
    """Level of the first sub-pixel of every gate line."""
    lines: npt.NDArray[np.float32] = host.panel.visible(at)[0]
    return lines


def filled(crystal: Crystal) -> Host:
    """All pixels go from opaque to open at 101 s."""
    host = Host(crystal=crystal)
    host.wake()
    host.clear()
    host.clock.now = 101.0
    host.send(0x2C)
    host.panel.write(b"\xff" * (128 * 160 * 3))
    return host


def test_scan_reaches_every_line_once_and_in_its_order() -> None:
    host = filled(Crystal(scan=0.016, phase=100.995))
    # The refresh that began 5 ms ago has passed line 50; it and those before wait for the next.
    now = shown(host, 101.0001)
    assert not now[:50].any()
    assert not now[53:].any()
    later = shown(host, 101.0060)
    assert not later[:50].any()
    assert (later[53:110] == 63).all()
    assert (shown(host, 101.0161) == 63).all()
    assert not host.panel.settled(101.0159)
    assert host.panel.settled(101.0161)


def test_crystal_turns_linearly_from_where_it_is() -> None:
    host = filled(Crystal(scan=0.0, settle=0.1))
    assert shown(host, 101.025)[0] == pytest.approx(63 / 4)
    assert (shown(host, 100.5) == 0).all()
    host.clock.now = 101.05
    host.clear()
    assert shown(host, 101.05)[0] == pytest.approx(63 / 2)
    assert shown(host, 101.10)[0] == pytest.approx(63 / 4)
    assert not shown(host, 101.15).any()
    assert not host.panel.settled(101.149)
    assert host.panel.settled(101.1501)


def test_faults_are_seen_at_once_and_may_end(host: Host) -> None:
    panel = host.panel
    shown = panel.framebuffer()
    for faults in (PanelFaults(dead=True), PanelFaults(gone=True)):
        panel.faults = faults
        assert panel.transparent
        assert (panel.visible(host.clock.now + 10) == 63).all()
    panel.faults = PanelFaults(inverted=True)
    assert np.array_equal(panel.visible(host.clock.now + 10), 63 - shown)
    panel.faults = PanelFaults()
    assert np.array_equal(panel.visible(host.clock.now + 10), shown)


def test_one_that_fell_asleep_is_transparent_until_a_reset(host: Host) -> None:
    shown = host.panel.framebuffer()
    for wake in (host.wake, lambda: setattr(host.panel, "faults", PanelFaults())):
        host.panel.faults = PanelFaults(asleep=True)
        assert host.panel.transparent
        host.panel.faults = PanelFaults(asleep=True, inverted=True)
        assert host.panel.transparent
        wake()
        host.panel.faults = PanelFaults()
        assert np.array_equal(host.panel.framebuffer(), shown)


@pytest.mark.parametrize(
    ("faults", "lit"),
    [
        (PanelFaults(), {(0, 0), (1, 0), (0, 1), (1, 1)}),
        (PanelFaults(half=True), {(0, 0), (1, 0)}),
        (PanelFaults(shifted=True), {(0, 1), (1, 1), (0, 2), (1, 2)}),
    ],
)
def test_write_may_end_half_way_or_land_elsewhere(
    faults: PanelFaults, lit: set[tuple[int, int]], host: Host
) -> None:
    host.panel.faults = faults
    host.window(0, 1, 0, 1)
    host.send(0x2C)
    host.panel.write(b"\xff" * 12)
    assert set(host.lit()) == lit


def test_one_that_is_gone_fails_on_its_bus(host: Host) -> None:
    host.panel.faults = PanelFaults(gone=True)
    with pytest.raises(OSError, match="No such device"):
        host.panel.write(b"\x11")
    with pytest.raises(OSError, match="No such device"):
        host.panel.reset(True)


def test_one_that_is_stuck_shows_what_it_showed(host: Host) -> None:
    shown = host.panel.framebuffer()
    host.panel.faults = PanelFaults(stuck=True)
    host.send(0x28)
    host.panel.reset(True)
    host.panel.reset(False)
    assert np.array_equal(host.panel.framebuffer(), shown)
    host.panel.faults = PanelFaults()
    host.send(0x28)
    assert host.panel.transparent
