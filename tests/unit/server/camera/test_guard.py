"""The guard: verdicts of opaque frames, on a clock of their own, and answers that are held."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.unit.server.devices.clock import Clock

from veilcam_client.wire.rotation import EveryCaptures
from veilcam_server.camera.capture import Fence
from veilcam_server.camera.guard import (
    REMEMBERED,
    Guard,
    MaskFrame,
    Verdict,
    expected_ratio,
    threshold,
    verdict,
)
from veilcam_server.devices import Device, DisplayError, SensorError, Shown
from veilcam_server.devices.base import Levels, Light
from veilcam_server.devices.errors import SaturatedError
from veilcam_server.errors import PanelNotHidingError, UnsteadyLightError, UnwatchableError

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench

MASK = np.full((9, 5), 31, np.uint8)
SETTLE = 0.1


def light(mean: float) -> Light:
    return Light(min(mean, 1.0), 1e-4, saturated=mean > 1)


def behind(mean: float, ratio: float = 0.0) -> MaskFrame:
    return MaskFrame(light(mean), threshold(ratio))


@pytest.mark.parametrize(
    ("opaque", "masks", "found"),
    [
        (0.0, (0.3, 0.3), "hidden"),
        (0.14, (0.3, 0.3), "hidden"),
        (0.16, (0.3, 0.3), "not hidden"),
        (math.inf, (0.3, 0.3), "not hidden"),
        (math.inf, (math.inf, math.inf), "not hidden"),
        (0.3, (math.inf,), "hidden"),
        # A saturated frame may have had hardly more than the one beside it.
        (0.97, (math.inf, math.inf), "not hidden"),
        # One switch of a lamp, before the frame or after it.
        (0.16, (0.3, 3.0), "light changes"),
        (0.16, (3.0, 0.3), "light changes"),
        (0.0, (0.3, 0.0), "light changes"),
        (0.1, (0.0, 0.0), "not hidden"),
        (1e-4, (2e-4, -1e-4), "too dark"),
    ],
)
def test_verdict_needs_both_neighbours(
    opaque: float, masks: Sequence[float], found: Verdict
) -> None:
    assert verdict(light(opaque), [behind(mean) for mean in masks]) == found


def test_threshold_is_half_way_from_a_sound_camera_to_one_that_hides_nothing() -> None:
    assert expected_ratio(0.0, MASK, 64) == 0
    assert expected_ratio(0.0, np.zeros_like(MASK), 64) == 0
    ratio = expected_ratio(0.2, MASK, 64)
    assert ratio == pytest.approx(0.2 / (0.2 + 0.8 * (31 / 63) ** 2))
    assert verdict(light(0.74), [behind(1.0, ratio)]) == "hidden"
    assert verdict(light(0.76), [behind(1.0, ratio)]) == "not hidden"


@dataclass
class Optics:
    """A panel, a sensor and a lamp on one clock."""

    clock: Clock = field(default_factory=Clock)
    leak: float = 0.1
    panel: str = "sound"
    lamp: Callable[[float], float] = lambda _: 1.0
    name: str = "optics"
    full_scale: float = 1.0
    resets: int = 0
    frames: int = 0
    broken: Exception | None = None

    def __post_init__(self) -> None:
        self.shown: Levels = np.zeros_like(MASK)

    def show(self, levels: Levels) -> Shown:
        if self.panel != "stuck":
            self.shown = levels.copy()
        return Shown(self.clock.now)

    def blank(self) -> None:
        self.show(np.zeros_like(MASK))

    def close(self) -> None:
        pass

    def light(self, not_before: float, timeout: float) -> Light:
        if self.broken is not None:
            raise self.broken
        self.frames += 1
        self.clock.now = max(self.clock.now, not_before) + 0.01
        shown = 63 - self.shown if self.panel == "inverted" else self.shown
        passed = float(np.square(shown / 63).mean())
        if self.panel == "dead":
            passed = 2.5
        mean = self.lamp(self.clock.now) * (self.leak + (1 - self.leak) * passed) / 2
        return light(mean)


def switched(at: float, before: float, after: float) -> Callable[[float], float]:
    """A lamp that is switched once."""
    return lambda now: before if now < at else after


class Rig:
    """A guard whose captures are frames behind the mask that is shown."""

    def __init__(self, optics: Optics, every: float = 0.0) -> None:
        self.optics = optics
        device = Device(optics, optics, simulated=True)  # type: ignore[arg-type]
        self.guard = Guard(device, Fence(SETTLE), every=every, clock=optics.clock)
        self.guard.leak = optics.leak

    def capture(self, *, last: bool = True) -> bool:
        if self.guard.covered or not self.optics.shown.any():
            self.guard.show(MASK)
        seen = self.optics.light(self.guard.completed_at + SETTLE, 1.0)
        return self.guard.vouch(MASK, seen, last=last)


FAULTS = ("stuck", "inverted", "dead")


@pytest.mark.parametrize("leak", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("fault", FAULTS)
def test_fault_is_accused_before_its_first_answer_leaves(fault: str, leak: float) -> None:
    rig = Rig(Optics(leak=leak))
    for _ in range(3):
        assert rig.capture()
    rig.guard.show(MASK)
    rig.optics.panel = fault
    with pytest.raises(PanelNotHidingError):
        rig.capture()


@pytest.mark.parametrize("at", np.arange(0.005, 1.2, 0.02))
@pytest.mark.parametrize("levels", [(1.0, 1 / 30), (1 / 30, 1.0), (1.0, 0.0), (0.0, 1.0)])
def test_one_switch_of_a_lamp_never_accuses_a_sound_panel(
    at: float, levels: tuple[float, float]
) -> None:
    optics = Optics(leak=0.3)
    began, (before, after) = optics.clock.now, levels
    optics.lamp = switched(began + at, before, after)
    rig = Rig(optics)
    for _ in range(6):
        try:
            rig.capture()
        except UnsteadyLightError:
            assert optics.clock.now > began + at or before == 0


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("at", np.arange(0.005, 0.6, 0.02))
def test_one_switch_of_a_lamp_hides_a_fault_from_one_opaque_frame_at_most(
    at: float, fault: str
) -> None:
    for before, after in ((1.0, 1 / 30), (1 / 30, 1.0)):
        rig = Rig(Optics())
        rig.capture()
        rig.guard.show(MASK)
        began = rig.optics.clock.now
        rig.optics.panel = fault
        rig.optics.lamp = switched(began + at, before, after)
        answered = 0
        for _ in range(4):
            with suppress(PanelNotHidingError, UnsteadyLightError):
                rig.capture()
                answered += 1
        # That is where the lamp goes out between the capture and its opaque frame.
        assert answered <= (after < before)


def test_answer_leaves_at_once_while_an_opaque_frame_is_young() -> None:
    rig = Rig(Optics(), every=10.0)
    rig.capture(last=False)
    frames = rig.optics.frames
    rig.optics.clock.sleep(5.0)
    assert not rig.capture(last=False)
    assert rig.optics.frames == frames + 1  # the capture's own
    rig.optics.clock.sleep(6.0)
    assert rig.capture(last=False)
    assert rig.optics.frames == frames + 3
    assert rig.guard.covered


def test_opaque_frame_that_is_old_when_the_capture_comes_vouches_for_nothing() -> None:
    rig = Rig(Optics(), every=10.0)
    rig.guard.show(MASK)
    rig.optics.clock.sleep(3.0)
    rig.optics.panel = "dead"
    with pytest.raises(PanelNotHidingError):
        rig.capture(last=False)


def test_darkness_lets_the_last_verdict_hold_for_ten_minutes() -> None:
    rig = Rig(Optics())
    rig.capture()
    rig.optics.lamp = lambda _: 0.0
    # A mask that was not written looks like this.
    with pytest.raises(UnsteadyLightError):
        rig.capture()
    assert not rig.capture()
    rig.optics.clock.sleep(REMEMBERED)
    with pytest.raises(UnsteadyLightError, match="too dark for too long"):
        rig.capture()
    rig.optics.lamp = lambda _: 1.0
    rig.optics.clock.sleep(5.0)
    assert rig.capture()


def test_mask_that_passes_little_more_than_the_leak_is_not_watched() -> None:
    guard = Rig(Optics(leak=0.3)).guard
    guard.require_watchable(MASK)
    with pytest.raises(UnwatchableError, match="infrared filter"):
        guard.require_watchable(MASK // 8)


def test_sensor_that_fails_keeps_no_mask_off_the_panel_and_no_answer_leaves() -> None:
    rig = Rig(Optics())
    rig.optics.broken = SensorError("no frame")
    rig.guard.show(MASK)
    assert rig.optics.shown.any()
    rig.optics.broken = None
    seen = rig.optics.light(0.0, 1.0)
    rig.optics.broken = SensorError("no frame")
    with pytest.raises(SensorError):
        rig.guard.vouch(MASK, seen, last=True)


def shows_opaque(bench: Bench) -> bool:
    return bench.display.opaque


def test_answers_with_a_mask_each_are_held_and_refused_at_a_fixed_time(bench: Bench) -> None:
    camera = bench.camera(policy=EveryCaptures(captures=1))
    captures, guards = bench.sensor.captures, bench.sensor.guards
    camera.capture(release=False)
    assert (bench.sensor.captures, bench.sensor.guards) == (captures + 1, guards + 1)
    assert shows_opaque(bench)
    assert camera.due_in() == 0
    good = camera.present[0]
    camera.await_next()
    camera.rotate_if_due()
    assert not shows_opaque(bench)
    assert bench.sensor.guards == guards + 1
    bench.sensor.lights = lambda: 1.0
    begun = time.monotonic()
    with pytest.raises(PanelNotHidingError, match=f"0 of epoch {good}"):
        camera.capture(release=True)
    assert time.monotonic() - begun >= camera._guard.refusal
    assert camera.state.state == "safe"
    assert camera.state.remedy == "check_panel_wiring"
    assert bench.display.closed  # it is set up anew
    assert not bench.display.shown[-1].any()
    assert camera.test_due_in() == 0
    tests = bench.test.runs
    bench.sensor.lights = lambda: 0.0 if bench.display.opaque else 1.0
    camera.test_if_due()
    assert bench.test.runs == tests + 1
    camera.capture(release=False)


def test_refused_capture_costs_no_budget(bench: Bench) -> None:
    bench.raw_budget = 1
    camera = bench.camera(guard_every=0.0)
    bench.sensor.lights = lambda: 0.5
    with pytest.raises(PanelNotHidingError):
        camera.capture(release=True)
    bench.sensor.lights = lambda: 0.0 if bench.display.opaque else 1.0
    camera.test_if_due()
    camera.capture(release=True)


def test_mask_is_written_again_after_an_opaque_frame_in_between(bench: Bench) -> None:
    camera = bench.camera(guard_every=0.0)
    camera.capture(release=False)
    assert shows_opaque(bench)
    camera.rotate_if_due()
    assert not shows_opaque(bench)
    assert camera.due_in() == math.inf
    camera.capture(release=False)
    camera.capture(release=False)
    assert camera.present == (bench.epochs[-1], 3)


def test_panel_that_fails_at_an_opaque_frame_answers_nothing(bench: Bench) -> None:
    camera = bench.camera(guard_every=0.0)
    show = bench.display.show

    def broken(levels: Levels) -> Shown:
        raise DisplayError("the bus gave no answer")

    bench.display.show = broken  # type: ignore[method-assign]
    with pytest.raises(DisplayError):
        camera.capture(release=False)
    assert camera.state[0] == "safe"
    bench.display.show = show  # type: ignore[method-assign]
    camera.test_if_due()
    camera.capture(release=False)


@pytest.mark.parametrize(
    ("opaque", "refused"), [(math.inf, PanelNotHidingError), (0.1, SaturatedError)]
)
def test_saturated_capture_is_the_panel_s_fault_if_an_opaque_one_is_too(
    bench: Bench, opaque: float, refused: type[Exception]
) -> None:
    camera = bench.camera()

    def saturated() -> None:
        raise SaturatedError("the sensor is saturated")

    bench.sensor.before = saturated
    bench.sensor.lights = lambda: opaque if bench.display.opaque else math.inf
    with pytest.raises(refused):
        camera.capture(release=False)


def test_camera_that_leaks_too_much_is_degraded_and_says_what_helps(bench: Bench) -> None:
    camera = bench.camera()
    bench.test.leak = 0.6
    bench.display.resets += 1
    with pytest.raises(UnwatchableError):
        camera.rotate()
    assert (camera.state.state, camera.state.remedy) == ("degraded", "shield_light")
    assert not bench.display.shown[-1].any()
    bench.test.leak = 0.1
    camera.test_if_due()
    camera.capture(release=False)
