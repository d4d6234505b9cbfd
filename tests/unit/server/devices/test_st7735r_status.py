"""What the panel says of itself, and what the driver that asks it after every mask makes of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest

from veilcam_client.wire.simulation import PanelFaults
from veilcam_optics.camera.geometry import Camera
from veilcam_server.devices import DisplayError
from veilcam_server.devices.reopening import ReopeningDisplay
from veilcam_server.devices.simulated.panel import Crystal, PanelEmulator
from veilcam_server.devices.st7735r import DRIVER, ST7735R
from veilcam_server.devices.st7735r_glass import TABS
from veilcam_server.devices.st7735r_status import identify, is_read, require_sound

from .clock import Clock

CAMERA = Camera()
LEVELS = np.full(CAMERA.mask_shape, 21, np.uint8)


@dataclass
class Line:
    """A bus on which the same bits come back to whatever is asked."""

    bits: str = ""
    asked: list[tuple[bool, int, int]] = field(default_factory=list)
    is_data: bool = True

    def write(self, buffer: memoryview | bytes) -> None:
        raise AssertionError("nothing is written to ask")

    def read(self, command: int, count: int) -> bytes:
        self.asked.append((self.is_data, command, count))
        return int(self.bits[: 8 * count], 2).to_bytes(count, "big")

    def data(self, value: bool, /) -> None:
        self.is_data = value

    def reset(self, value: bool, /) -> None:
        raise AssertionError("nothing is reset to ask")

    def close(self) -> None:
        """Nothing is open."""


SOUND = "1 110010 0  0 110 0 0 1 1  00 0 00 1 0 0  00000000"
"""Status of a green tab's panel: BSTON, MADCTL (C8h) from MY to MH, ST24; ST23, 6-6-6, IDMON,
PTLON, SLPOUT, NORON; ST15, ST14, INVON, ST12, ST11, DISON, TEON, GCS2; GCS1, GCS0, TEM, ST4 to ST0.
"""


def status(bits: str = SOUND, *, dummy: str = "0", after: str = "0") -> Line:
    """One clock that says nothing, the status, and what the line does until CS rises."""
    return Line(dummy + bits.replace(" ", "") + 7 * after)


@pytest.mark.parametrize("dummy", "01")
@pytest.mark.parametrize("after", "01")
def test_sound_panel_is_asked_once_and_its_dummy_clock_is_passed_over(
    dummy: str, after: str
) -> None:
    line = status(dummy=dummy, after=after)
    assert is_read(line, line, 0xC8)
    assert line.asked == 3 * [(False, 0x09, 5)]
    require_sound(line, line, 0xC8)
    assert line.asked == 4 * [(False, 0x09, 5)]


def test_status_bits_that_say_nothing_of_the_picture_are_passed_over() -> None:
    """ST24, ST23, ST15, ST14, ST12, ST11 and TEON; gamma curves and the tearing line's mode."""
    free = [7, 8, 16, 17, 19, 20, 22, *range(23, 32)]
    bits = list(SOUND.replace(" ", ""))
    for at in free:
        bits[at] = "1"
    require_sound(status("".join(bits)), status(), 0xC8)


@pytest.mark.parametrize(
    ("bit", "told"),
    [
        (0, "its voltages are off"),
        *((bit, "its memory is turned") for bit in range(1, 7)),
        *((bit, "it takes another pixel format") for bit in range(9, 12)),
        (12, "it shows eight colours"),
        (13, "it shows a part of its lines"),
        (14, "it sleeps"),
        (15, "it shows a part of its lines"),
        (18, "it shows light for dark"),
        (21, "its display is off"),
    ],
)
def test_status_bits_that_are_not_as_set_are_said(bit: int, told: str) -> None:
    bits = list(SOUND.replace(" ", ""))
    bits[bit] = "10"[int(bits[bit])]
    line = status("".join(bits))
    with pytest.raises(DisplayError) as caught:
        require_sound(line, line, 0xC8)
    assert str(caught.value) == f"the panel answers that {told}: check its power and wiring"


@pytest.mark.parametrize("level", "01")
def test_line_that_nobody_drives_is_no_answer(level: str) -> None:
    line = status(32 * level, dummy=level, after=level)
    assert not is_read(line, line, 0xC8)
    require_sound(line, line, 0xC8)
    with pytest.raises(DisplayError, match="does not answer command 04h"):
        identify(line, line)


def woken(faults: PanelFaults = PanelFaults()) -> tuple[PanelEmulator, Clock]:  # noqa: B008
    clock = Clock()
    emulator = PanelEmulator(TABS["green"], crystal=Crystal(scan=0.0), clock=clock)
    emulator.faults = faults
    return emulator, clock


def test_panel_says_who_it_is_before_it_was_set_up() -> None:
    emulator, _ = woken()
    shown = emulator.framebuffer()
    # As after power-up (10.1.5): 6-6-6, asleep, normal mode, off.
    assert identify(emulator, emulator) == "identity 7c89f0, status 00610000"
    assert np.array_equal(emulator.framebuffer(), shown)


def test_answers_that_contradict_each_other_are_no_identity() -> None:
    emulator, _ = woken()

    class Late(PanelEmulator):
        """Its answers of 32 bits come another clock late."""

        def read(self, command: int, count: int) -> bytes:
            answer = int.from_bytes(super().read(command, count), "big")
            return (answer >> (command == 0x09)).to_bytes(count, "big")

    late = Late(TABS["green"], clock=Clock())
    with pytest.raises(
        DisplayError, match="status 80308000 and power mode 08: check the wire of its SDA"
    ):
        identify(late, late)
    assert identify(emulator, emulator)


@dataclass
class Register(Line):
    """A bus on which every question has the answer of its own."""

    power: int = 0
    status: int = 0

    def read(self, command: int, count: int) -> bytes:
        answers = {
            0x04: f"0{0x7C89F0:024b}",
            0x09: f"0{self.status:032b}",
            0x0A: f"{self.power:08b}",
        }
        return int(answers[command].ljust(8 * count, "0"), 2).to_bytes(count, "big")


REPEATED = {31: 7, 19: 6, 18: 5, 17: 4, 16: 3, 10: 2}
"""BSTON, IDMON, PTLON, SLPOUT, NORON and DISON: where the status has them, and the power mode."""


@pytest.mark.parametrize(("bit", "repeated"), REPEATED.items())
def test_power_mode_is_the_part_of_the_status_that_it_should_be(bit: int, repeated: int) -> None:
    for status in (1 << bit, 0xFFFF_FFFE ^ 1 << bit):
        power = sum(1 << REPEATED[each] for each in REPEATED if status >> each & 1)
        line = Register(power=power, status=status)
        assert identify(line, line) == f"identity 7c89f0, status {status:08x}"
        line.power ^= 1 << repeated
        with pytest.raises(DisplayError, match="do not fit together"):
            identify(line, line)


def reading(
    emulator: PanelEmulator, clock: Clock, *, read_back: bool = True, tab: str = "green"
) -> ST7735R:
    return ST7735R(
        *(emulator, emulator),
        camera=CAMERA,
        tab=TABS[tab],
        read_back=read_back,
        sleep=clock.sleep,
        clock=clock,
    )


@pytest.mark.parametrize("tab", TABS)
def test_sound_panel_shows_the_same_whether_it_is_asked_or_not(tab: str) -> None:
    pictures, sent = [], []
    for read_back in (False, True):
        clock = Clock()
        emulator = PanelEmulator(TABS[tab], crystal=Crystal(scan=0.0), clock=clock)
        panel = reading(emulator, clock, read_back=read_back, tab=tab)
        before = emulator.bytes_received
        panel.show(LEVELS)
        pictures.append(emulator.framebuffer())
        sent.append(emulator.bytes_received - before)
        panel.blank()
        assert not emulator.framebuffer().any()
    assert np.array_equal(pictures[0], pictures[1])
    assert sent[1] == sent[0] + 1  # one command, and what follows it comes from the panel


ASLEEP = (0x8061_0400 << 7).to_bytes(5, "big")
"""Answer of a panel that sleeps."""


def act_show(panel: ST7735R) -> None:
    panel.show(LEVELS)


@pytest.mark.parametrize("act", [act_show, ST7735R.blank])
@pytest.mark.parametrize(
    ("told", "command", "parameters"),
    [
        ("it sleeps", b"\x10", b""),
        ("its display is off", b"\x28", b""),
        ("it shows light for dark", b"\x21", b""),
        ("its voltages are off, it sleeps, its display is off", b"\x01", b""),
        *(("its memory is turned", b"\x36", order) for order in (b"\x00", b"\x48")),
        *(("it takes another pixel format", b"\x3a", bits) for bits in (b"\x05", b"\x03")),
    ],
)
def test_panel_that_was_told_something_else_is_found_after_the_next_write(
    told: str, command: bytes, parameters: bytes, act: Callable[[ST7735R], None]
) -> None:
    emulator, clock = woken()
    asking, silent = (reading(emulator, clock, read_back=asked) for asked in (True, False))
    emulator.data(False)
    emulator.write(command)
    emulator.data(True)
    emulator.write(parameters)
    clock.sleep(1.0)
    act(silent)
    with pytest.raises(DisplayError, match=told):
        act(asking)


@pytest.mark.parametrize("fault", ["dead", "stuck", "inverted"])
def test_silence_and_inverted_glass_are_for_light_to_tell(fault: str) -> None:
    """Its controller knows nothing of inverted glass."""
    emulator, clock = woken()
    panel = reading(emulator, clock)
    emulator.faults = PanelFaults.model_validate({fault: True})
    for act in (act_show, ST7735R.blank):
        act(panel)
    reading(emulator, clock).show(LEVELS)


def test_wrong_wiring_never_fails_a_sound_panel() -> None:
    random = np.random.default_rng(1)

    class Elsewhere(PanelEmulator):
        """Its data line is not wired to where it is read."""

        def read(self, command: int, count: int) -> bytes:
            super().read(command, count)
            return random.bytes(count)

    clock = Clock()
    panel = reading(Elsewhere(TABS["green"], crystal=Crystal(scan=0.0), clock=clock), clock)
    for _ in range(200):
        panel.show(LEVELS)


def test_answer_is_believed_if_it_comes_three_times() -> None:
    emulator, clock = woken()
    panel = reading(emulator, clock)
    read = emulator.read
    answers: list[bytes] = []

    def said(command: int, count: int) -> bytes:
        return answers.pop() if answers else read(command, count)

    emulator.read = said  # type: ignore[method-assign]
    for wrong in (1, 2):
        answers += [ASLEEP] * wrong
        panel.show(LEVELS)
        assert not answers
    emulator.read = lambda *_: ASLEEP  # type: ignore[method-assign]
    with pytest.raises(DisplayError, match="it sleeps"):
        panel.show(LEVELS)


def test_question_that_is_lost_has_no_answer() -> None:
    """The thirteenth write of a mask is the question; pixels that are lost are answered as ever."""
    emulator, clock = woken()
    panel = reading(emulator, clock)
    emulator.faults = PanelFaults(lost=13)
    emulator._writes = 0
    panel.show(LEVELS)
    before = emulator.framebuffer()
    emulator.faults = PanelFaults(lost=6)
    emulator._writes = 0
    panel.show(LEVELS + 1)
    assert np.array_equal(emulator.framebuffer(), before)


def test_question_with_data_s_level_is_a_parameter_and_not_answered() -> None:
    emulator, clock = woken()
    reading(emulator, clock)
    emulator.data(True)
    assert emulator.read(0x09, 5) == bytes(5)
    emulator.data(False)
    assert emulator.read(0x09, 5) != bytes(5)
    assert emulator.read(0x00, 5) == bytes(5)
    emulator.reset(True)
    assert emulator.read(0x09, 5) == bytes(5)


def test_mask_is_in_no_buffer_after_a_wrong_answer() -> None:
    emulator, clock = woken()
    panel = reading(emulator, clock)
    emulator.read = lambda *_: ASLEEP  # type: ignore[method-assign]
    with pytest.raises(DisplayError) as caught:
        panel.show(LEVELS)
    assert not panel._pixels.any()
    assert "21" not in str(caught.value)


def test_time_of_completion_is_before_the_question() -> None:
    class Slow(PanelEmulator):
        def read(self, command: int, count: int) -> bytes:
            clock.sleep(0.5)
            return super().read(command, count)

    clock = Clock()
    panel = reading(Slow(TABS["green"], clock=clock), clock)
    began = clock.now
    assert panel.show(LEVELS).completed_at == began
    assert clock.now == began + 0.5


@pytest.mark.parametrize("read_back", [False, True])
def test_emulated_panel_is_asked_if_it_should_be(*, read_back: bool) -> None:
    """And set up anew, as it is after every failure."""
    clock = Clock()
    assert DRIVER.emulate is not None
    open_display, emulated = DRIVER.emulate(
        CAMERA, scan=0.0, settle=0.0, read_back=read_back, clock=clock
    )
    display = ReopeningDisplay("ST7735R", open_display, clock=clock)
    display.show(LEVELS)
    emulated.faults = PanelFaults(asleep=True)
    if not read_back:
        display.show(LEVELS)
        return
    with pytest.raises(DisplayError, match="it sleeps"):
        display.show(LEVELS)
    assert display.resets == 1
    clock.sleep(2.0)
    display.show(LEVELS)
