"""No capture without proof that the panel hides the scene: at the start, anew, now and then."""

from __future__ import annotations

import time
from contextlib import suppress
from typing import TYPE_CHECKING

import pytest
from tests.unit.server.devices.clock import Clock

from veilcam_client.wire.rotation import EveryCaptures
from veilcam_server.camera.capture import Fence
from veilcam_server.camera.self_test import SelfTestStatus
from veilcam_server.devices import Device, DisplayError, SensorError
from veilcam_server.errors import FenceError, NotReadyError, SelfTestError
from veilcam_server.errors import UndecidedError as Undecided

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench


@pytest.mark.parametrize(
    ("fault", "state"),
    [
        (SelfTestError("the panel does not hide"), "safe"),
        (DisplayError("the bus"), "safe"),
        (Undecided("it is too dark"), "degraded"),
        (SensorError("no frame"), "degraded"),
        (FenceError("too early"), "degraded"),
    ],
)
def test_without_proof_the_panel_is_opaque_and_nothing_is_captured(
    bench: Bench, fault: Exception, state: str
) -> None:
    camera = bench.unstarted()
    bench.test.faults = [fault, fault]
    for _ in range(2):
        with pytest.raises(type(fault)):
            camera.rotate()
        assert camera.state[:2] == (state, str(fault))
        assert camera.present == (None, 0)
        assert not bench.display.shown[-1].any()
        with pytest.raises(NotReadyError, match=str(fault)):
            camera.capture(release=False)
        assert camera.test_due_in() == 0
    assert bench.sensor.captures == 0
    # Tried again, it says nothing new: one line in a log when it goes down, one when it is back.
    assert [told for told, _ in bench.states] == ["self-test", state]
    camera.test_if_due()
    assert [told for told, _ in bench.states] == ["self-test", state, "ready"]
    assert camera.capture(release=False).epoch == bench.epochs[-1]
    assert 0 < camera.test_due_in() <= 600


def test_panel_that_was_set_up_anew_is_tested_before_the_next_capture(bench: Bench) -> None:
    camera = bench.camera(settle=0.02)
    camera.capture(release=False)
    epoch, mask = camera.present[0], bench.pair_shown()
    bench.display.resets += 1
    assert camera.test_due_in() == 0
    begun = time.monotonic()
    captured = camera.capture(release=False)
    assert bench.test.runs == 2
    # The showing goes on, after the mask has settled again.
    assert (captured.epoch, bench.pair_shown()) == (epoch, mask)
    assert 0.02 <= captured.exposure.started_after_shown_s <= time.monotonic() - begun
    assert camera.present == (epoch, 2)
    camera.capture(release=False)
    assert bench.test.runs == 2


def test_proof_grows_old(bench: Bench) -> None:
    camera = bench.camera(test_every=1e-6)
    for runs in (2, 3, 4):
        camera.capture(release=False)
        assert bench.test.runs == runs
    bench.states.clear()
    camera.test_if_due()
    assert [state for state, _ in bench.states] == ["self-test", "ready"]


def test_mask_that_cannot_be_put_back_after_a_test_leaves_the_panel_opaque(
    bench: Bench, display_fault: DisplayError
) -> None:
    camera = bench.camera()
    bench.display.resets += 1
    bench.display.faults = [display_fault]
    with pytest.raises(NotReadyError, match="made opaque"):
        camera.capture(release=False)
    assert camera.state[0] == "safe"
    assert not bench.display.shown[-1].any()


def test_failed_rotation_after_a_test_is_back_at_the_mask_before(
    bench: Bench, display_fault: DisplayError
) -> None:
    camera = bench.camera(policy=EveryCaptures(captures=1))
    camera.capture(release=False)
    epoch = camera.present[0]
    bench.display.resets += 1
    bench.display.faults = [display_fault]
    with pytest.raises(DisplayError):
        camera.rotate()
    assert camera.state[0] == "ready"
    assert camera.present == (epoch, 1)


def test_lone_pair_is_tested_and_comes_back(lone_bench: Bench) -> None:
    camera = lone_bench.camera()
    epoch = camera.present[0]
    lone_bench.display.resets += 1
    assert camera.capture(release=False).epoch == epoch
    lone_bench.display.resets += 1
    lone_bench.test.faults = [Undecided("it is too dark")]
    with pytest.raises(Undecided):
        camera.capture(release=False)
    camera.test_if_due()
    assert camera.capture(release=False).epoch == lone_bench.epochs[-1] != epoch


def test_stopping_camera_is_tested_no_more(bench: Bench) -> None:
    camera = bench.camera()
    camera.stop()
    assert camera.test_due_in() == float("inf")
    with pytest.raises(NotReadyError, match="stopping"):
        camera.test_if_due()


def test_proof_holds_so_long(bench: Bench) -> None:
    clock = Clock()
    device = Device(bench.display, bench.sensor, simulated=True)
    status = SelfTestStatus(bench.test, device, Fence(0.0), every=10.0, clock=clock)
    assert status.holds_for() == 0
    assert status.age == float("inf")
    status.renew()
    clock.sleep(4)
    assert status.holds_for() == 6
    assert status.age == 4
    clock.sleep(7)
    assert status.holds_for() == 0
    status.renew()
    bench.test.faults = [Undecided("dark")]
    with suppress(Undecided):
        status.renew()
    # What failed last counts, not what passed before.
    assert status.holds_for() == 0
    clock.sleep(2)
    assert status.age == 2


def test_panel_set_up_in_the_middle_of_its_test_is_not_proven(bench: Bench) -> None:
    class Resetting:
        def run(self, device: Device, fence: Fence) -> float:
            bench.display.resets += 1
            return 0.0

    device = Device(bench.display, bench.sensor, simulated=True)
    status = SelfTestStatus(Resetting(), device, Fence(0.0))
    status.renew()
    assert status.holds_for() == 0


@pytest.mark.parametrize("every", [0.0, -1.0, float("nan"), float("inf")])
def test_test_cannot_be_put_off_for_ever(bench: Bench, every: float) -> None:
    device = Device(bench.display, bench.sensor, simulated=True)
    with pytest.raises(ValueError, match="every"):
        SelfTestStatus(bench.test, device, Fence(0.0), every=every)
