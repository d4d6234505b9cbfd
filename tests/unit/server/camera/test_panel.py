"""The panel and its state: what is on the glass, what goes for good and what is told."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import suppress
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.unit.server.devices.clock import Clock

from veilcam_client.wire.events import Event, MaskChanged, StateChanged
from veilcam_server.camera.capture import Fence
from veilcam_server.camera.engine import Condition
from veilcam_server.camera.epochs import Epoch
from veilcam_server.camera.guard import Guard
from veilcam_server.camera.panel import MaskedPanel
from veilcam_server.camera.self_test import SelfTestStatus
from veilcam_server.devices import Device, DisplayError, SensorError
from veilcam_server.devices.errors import LightError
from veilcam_server.errors import FenceError, SelfTestError, UndecidedError
from veilcam_server.masks.pairs import load_pairs

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench

EVERY = 60.0
TESTED = Condition("self-test", "the panel is being tested")
READY = Condition("ready")
FAILED = "the panel failed and was made opaque: it is tried again"


class Rig:
    def __init__(self, bench: Bench) -> None:
        self.display, self.test, self.clock = bench.display, bench.test, Clock()
        self.preparation = bench.preparation()
        device = Device(bench.display, bench.sensor, simulated=True)
        self.proof = SelfTestStatus(bench.test, device, Fence(), every=EVERY, clock=self.clock)
        self.guard = Guard(device, Fence(0.0))
        self.panel = MaskedPanel(bench.display, self.preparation, self.proof, self.guard)
        self.states: list[Condition] = []
        self.masks: list[str] = []
        self.panel.publish = self._note

    def _note(self, make: Callable[..., Event]) -> None:
        event = make(id="0-0", at=datetime.now(UTC))
        if isinstance(event, StateChanged):
            self.states.append(Condition(event.state, event.detail, event.remedy))
        else:
            assert isinstance(event, MaskChanged)
            self.masks.append(event.epoch)

    def show(self) -> Epoch:
        """Show the next mask; gives what was shown."""
        epoch = self.preparation.take()
        self.panel.show(epoch)
        return epoch

    def shows(self, epoch: Epoch) -> bool:
        """Whether this mask is on the glass, and the last one that is not to come again."""
        same = np.array_equal(self.display.shown[-1], epoch.mask.levels)
        return same and self.preparation.last_mark == epoch.mask.mark

    @property
    def opaque(self) -> bool:
        """Whether the glass is, and no mask counts as shown."""
        return self.panel.active is None and not self.display.shown[-1].any()

    @property
    def preparing(self) -> bool:
        """Whether the next epoch is ready or on its way."""
        return self.preparation.under_way or self.preparation.ready


@pytest.fixture
def rig(bench: Bench) -> Iterator[Rig]:
    rig = Rig(bench)
    yield rig
    rig.preparation.close()


def test_before_the_first_mask_nothing_is_shown_and_a_test_is_due(rig: Rig) -> None:
    assert rig.panel.state == Condition("starting")
    assert rig.panel.active is None
    assert rig.panel.proven_for() == 0
    rig.panel.test()  # there is no mask to put back
    assert rig.test.runs == 0
    assert not rig.display.shown


def test_first_mask_is_tested_shown_and_told(rig: Rig) -> None:
    first = rig.show()
    showing = rig.panel.active
    assert showing is not None
    assert showing.epoch is first
    assert showing.since == showing.completed_at
    assert rig.shows(first)
    assert rig.test.runs == 1
    assert rig.states == [TESTED, READY]
    assert rig.panel.state == READY
    assert rig.masks == [first.name]
    assert rig.panel.proven_for() == EVERY
    assert rig.preparing


def test_while_the_proof_holds_a_mask_is_changed_without_a_test(rig: Rig) -> None:
    rig.show()
    rig.clock.sleep(EVERY - 0.5)
    second = rig.show()
    assert rig.shows(second)
    assert rig.test.runs == 1
    assert rig.states == [TESTED, READY]
    assert len(rig.masks) == 2


@pytest.mark.parametrize("late", [0.0, 5.0])
def test_mask_is_changed_after_a_test_once_that_is_due(rig: Rig, late: float) -> None:
    rig.show()
    rig.clock.sleep(EVERY + late)
    assert rig.panel.proven_for() == 0
    rig.show()
    assert rig.test.runs == 2
    assert rig.states == [TESTED, READY] * 2


def test_test_that_is_not_due_touches_nothing(rig: Rig) -> None:
    rig.show()
    showing = rig.panel.active
    rig.clock.sleep(EVERY - 0.5)
    rig.panel.test()
    assert rig.panel.active is showing
    assert (rig.test.runs, len(rig.display.shown)) == (1, 1)


@pytest.mark.parametrize("late", [0.0, 5.0])
def test_after_a_test_the_same_mask_is_put_back_and_must_settle(rig: Rig, late: float) -> None:
    first = rig.show()
    showing = rig.panel.active
    assert showing is not None
    since = showing.since
    rig.clock.sleep(EVERY + late)
    rig.panel.test()
    assert rig.test.runs == 2
    assert rig.panel.active is showing
    assert rig.shows(first)
    assert showing.since == since < showing.completed_at
    assert rig.states == [TESTED, READY] * 2
    assert len(rig.masks) == 1  # no new epoch
    assert rig.panel.proven_for() == EVERY


def test_while_the_panel_is_tested_no_mask_counts_as_shown(rig: Rig) -> None:
    rig.show()
    rig.clock.sleep(EVERY)
    seen: list[object] = []
    run = rig.test.run

    def watched(device: Device, fence: Fence) -> float:
        seen.extend((rig.panel.active, rig.panel.state))
        return run(device, fence)

    rig.test.run = watched  # type: ignore[method-assign]
    rig.show()
    assert seen == [None, TESTED]


@pytest.mark.parametrize(
    ("fault", "state"),
    [
        (
            SelfTestError("it lets light through"),
            ("safe", "it lets light through", "check_panel_wiring"),
        ),
        (DisplayError("no answer"), ("safe", "no answer", "check_panel_wiring")),
        (UndecidedError("it is too dark"), ("degraded", "it is too dark", "adjust_light")),
        (SensorError("no frame"), ("degraded", "no frame", "check_camera_cable")),
        (LightError("saturated"), ("degraded", "saturated", "adjust_light")),
        (FenceError("too early"), ("degraded", "too early", "wait")),
        # What nobody foresaw may quote anything, so it is not told.
        (ZeroDivisionError("level 37"), ("safe", "the self test broke off", "report_defect")),
        (KeyboardInterrupt(), ("safe", "the self test broke off", "report_defect")),
    ],
)
def test_test_that_fails_ends_opaque_and_says_who_is_to_blame(
    rig: Rig, fault: BaseException, state: tuple[str, str, str]
) -> None:
    rig.show()
    rig.clock.sleep(EVERY)
    rig.test.faults = [fault]
    with pytest.raises(type(fault)):
        rig.panel.test()
    assert rig.opaque
    assert rig.panel.state == rig.states[-1] == state
    assert rig.panel.proven_for() == 0


@pytest.mark.parametrize("fault", [SelfTestError("dark"), UndecidedError("dark")])
def test_test_from_a_failed_state_tells_no_state_of_its_own(rig: Rig, fault: Exception) -> None:
    rig.test.faults = [fault, fault]
    for _ in range(2):
        with pytest.raises(SelfTestError):
            rig.show()
    failed = rig.panel.state
    rig.show()
    assert rig.states == [TESTED, failed, READY]


def test_failed_write_puts_the_mask_before_back(rig: Rig) -> None:
    first = rig.show()
    showing = rig.panel.active
    rig.display.faults = [DisplayError("no answer")]
    with pytest.raises(DisplayError, match="the mask could not be changed: no answer"):
        rig.show()
    assert rig.panel.active is showing
    assert rig.shows(first)
    assert rig.masks == [first.name]
    assert rig.states == [TESTED, READY]
    assert rig.preparing


@pytest.mark.parametrize(
    ("fault", "remedy"),
    [
        (DisplayError("no answer"), "check_panel_wiring"),
        (DisplayError("no bus", remedy="run_doctor"), "run_doctor"),
        (KeyboardInterrupt(), "report_defect"),
    ],
)
def test_first_mask_that_fails_leaves_the_panel_opaque(
    rig: Rig, fault: Exception, remedy: str
) -> None:
    rig.display.faults = [fault]
    with pytest.raises(type(fault)):
        rig.show()
    assert rig.opaque
    assert rig.panel.state == rig.states[-1] == ("safe", FAILED, remedy)
    assert not rig.masks


def test_panel_that_cannot_be_made_opaque_is_not_called_degraded(rig: Rig) -> None:
    rig.test.faults = [UndecidedError("it is too dark")]
    rig.display.faults = [DisplayError("no answer")]
    with pytest.raises(UndecidedError):
        rig.show()
    reason = "the panel cannot be made opaque: no answer"
    assert rig.panel.state == rig.states[-1] == ("safe", reason, "check_panel_wiring")


def test_remedy_is_that_of_the_last_error(rig: Rig) -> None:
    rig.show()
    rig.display.faults = [DisplayError("no answer"), DisplayError("no bus", remedy="run_doctor")]
    with pytest.raises(DisplayError):
        rig.show()
    assert rig.panel.state == rig.states[-1] == ("safe", FAILED, "run_doctor")
    rig.display.faults = [ZeroDivisionError()] * 3
    with pytest.raises(ZeroDivisionError):
        rig.show()
    reason = "the panel cannot be made opaque: its driver has a defect"
    assert rig.panel.state == rig.states[-1] == ("safe", reason, "report_defect")


def test_panel_that_is_suspended_has_no_mask_until_it_shows_one(rig: Rig) -> None:
    rig.show()
    rig.panel.suspend()
    assert rig.panel.active is None
    lent = Condition("calibrating", "the camera is being calibrated")
    assert rig.panel.state == lent
    rig.proof.void()
    shown = rig.show()
    rig.panel.strand()  # a mask is shown: there is nothing to do
    assert rig.shows(shown)
    assert rig.states == [TESTED, READY, lent, TESTED, READY]


def test_panel_that_is_stranded_is_opaque_and_says_so(rig: Rig) -> None:
    rig.show()
    rig.panel.suspend()
    rig.display.show(np.ones((9, 5), np.uint8))  # what the borrower left
    rig.panel.strand()
    assert rig.opaque
    reason = "no mask is shown after the calibration: it is tried again"
    assert rig.panel.state == rig.states[-1] == ("degraded", reason, "wait")


def test_after_the_end_no_mask_counts_as_shown(rig: Rig) -> None:
    rig.show()
    rig.panel.end()
    assert rig.panel.active is None
    assert rig.panel.state == rig.states[-1] == ("stopping", "the daemon is stopping", None)
    told = len(rig.states)
    rig.panel.end()
    assert len(rig.states) == told  # a state is told once


def test_masks_after_that_of_another_source_come_from_there(rig: Rig, bench: Bench) -> None:
    rig.show()
    other = load_pairs(bench.bundle)
    rig.panel.show(rig.preparation.first_of(other), other)
    after = rig.preparation.take()
    assert any(after.mask is mask for mask in other._masks)


def test_lone_mask_is_not_prepared_again(lone_bench: Bench) -> None:
    rig = Rig(lone_bench)
    rig.show()
    assert not rig.preparing
    rig.display.faults = [DisplayError("no answer")]
    with suppress(DisplayError):
        rig.show()
    assert not rig.preparing
    rig.preparation.close()


def test_panel_needs_no_listener(bench: Bench) -> None:
    rig = Rig(bench)
    panel = MaskedPanel(rig.display, rig.preparation, rig.proof, rig.guard)
    panel.show(rig.preparation.take())
    assert panel.state == READY
    rig.preparation.close()
