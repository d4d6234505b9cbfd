"""Every capture is tested before it leaves: what happens where it does not show its mask."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from typing import TYPE_CHECKING

import numpy as np
import pytest
from tests.server.conftest import NOT_SEEN, SEEN, UNDECIDED, FakeMaskTests
from tests.server.devices.clock import Clock

from veilcam_client.wire import calibration
from veilcam_client.wire.events import Event, Fault
from veilcam_client.wire.rotation import EveryCaptures
from veilcam_optics.proof import PROOF, Finding
from veilcam_server.camera.proof import (
    CAPTURES,
    DRIFTED,
    OFTEN,
    Brake,
    Findings,
    HeldTest,
    ShownMasks,
    proof_note,
)
from veilcam_server.devices import DisplayError, SensorError
from veilcam_server.errors import MaskNotSeenError, NotReadyError, SelfTestError

if TYPE_CHECKING:
    from collections.abc import Callable

    from tests.server.conftest import Bench


def light_of(bench: Bench, value: float) -> None:
    """Make all measurements one value, that of the proof another one."""
    bench.sensor.proof = np.full(PROOF.shape, value, np.float32)


def test_a_capture_is_tested_with_its_own_frame_against_its_own_mask(bench: Bench) -> None:
    camera, asked = bench.camera(), []
    test = bench.mask_tests.made[0]

    def find(*given: object) -> Finding:
        asked.append(given)
        return SEEN

    test.find = find  # type: ignore[method-assign, assignment]
    light_of(bench, 0.25)
    bench.sensor.clipped[3, 4] = True
    captured = camera.capture(release=False)
    ((proof, clipped, before),) = asked
    assert proof is bench.sensor.proof
    assert clipped is bench.sensor.clipped
    assert before == []
    assert captured.proof == proof_note(SEEN)
    assert bench.display.shown[-1].tolist() == test.levels.tolist()


def test_a_capture_that_does_not_show_its_mask_does_not_leave(bench: Bench) -> None:
    bench.raw_budget = 1
    camera = bench.camera(policy=EveryCaptures(captures=10))
    before, shown = bench.epochs[-1], len(bench.display.shown)
    bench.states.clear()
    bench.mask_tests.findings = [NOT_SEEN]
    with pytest.raises(MaskNotSeenError):
        camera.capture(release=True)
    # Opaque at once, tested at once, and another mask.
    assert not bench.display.shown[shown].any()
    assert bench.test.runs == 2
    assert [state for state, _ in bench.states] == ["safe", "ready"]
    assert bench.epochs[-1] != before
    assert camera.present == (bench.epochs[-1], 0)
    assert bench.pair_shown() is not None
    # Nothing left, so nothing was spent: as much may leave behind each mask as before.
    for _ in bench.bundle.pairs:
        camera.capture(release=True).done()


def test_the_mask_that_was_not_seen_is_erased(fresh_bench: Bench) -> None:
    camera = fresh_bench.camera()
    active = camera._panel.active
    assert active is not None
    fresh_bench.mask_tests.findings = [NOT_SEEN]
    with pytest.raises(MaskNotSeenError):
        camera.capture(release=True)
    assert active.epoch.erased
    assert not active.epoch.mask.levels.any()
    camera.stop()


@pytest.mark.parametrize(
    ("fault", "state"),
    [(SelfTestError("the panel does not hide"), "safe"), (SensorError("no frame"), "degraded")],
)
def test_a_panel_that_fails_its_test_then_stays_opaque(
    bench: Bench, fault: Exception, state: str
) -> None:
    camera = bench.camera()
    bench.mask_tests.findings = [NOT_SEEN]
    bench.test.faults = [fault]
    with pytest.raises(MaskNotSeenError):
        camera.capture(release=False)
    assert not bench.display.shown[-1].any()
    assert camera.present == (None, 0)
    assert camera.test_due_in() == 0
    # The test, and what failed it, is what the state tells; until it has passed nothing is taken.
    with pytest.raises(NotReadyError):
        camera.capture(release=False)
    camera.test_if_due()
    assert camera.state.state == "ready"
    camera.capture(release=False).done()


def test_a_panel_that_cannot_even_be_made_opaque_is_safe(bench: Bench) -> None:
    camera = bench.camera()
    bench.mask_tests.findings = [NOT_SEEN]
    bench.display.faults = [DisplayError("the bus"), DisplayError("the bus"), DisplayError("bus")]
    bench.test.faults = [DisplayError("the bus")]
    with pytest.raises(MaskNotSeenError):
        camera.capture(release=False)
    assert camera.state.state == "safe"
    assert camera.present == (None, 0)


def test_a_defect_on_the_way_back_hides_nothing(bench: Bench) -> None:
    camera = bench.camera()
    bench.mask_tests.findings = [NOT_SEEN]
    bench.test.faults = [ZeroDivisionError()]
    with pytest.raises(MaskNotSeenError):
        camera.capture(release=False)
    assert camera.state == ("safe", "the self test broke off", "report_defect")


def test_a_lone_mask_is_tested_and_shown_again(lone_bench: Bench) -> None:
    camera = lone_bench.camera()
    lone_bench.mask_tests.findings = [NOT_SEEN]
    with pytest.raises(MaskNotSeenError):
        camera.capture(release=False)
    assert len(set(lone_bench.epochs)) == 2
    assert lone_bench.pair_shown() == 0
    assert camera.capture(release=False).epoch == lone_bench.epochs[-1]


def test_it_is_told_as_what_it_is_whatever_was_asked_for(bench: Bench) -> None:
    told = {str(MaskNotSeenError())}
    camera = bench.camera()
    for release in (True, False):
        for finding in (NOT_SEEN, replace(NOT_SEEN, light=3.0, nearest="before", departure=99.0)):
            bench.mask_tests.findings = [SEEN, finding]
            camera.capture(release=False).done()
            with pytest.raises(MaskNotSeenError) as caught:
                camera.capture(release=release)
            told.add(str(caught.value))
            assert (caught.value.code, caught.value.status) == ("mask_not_seen", 503)
    # No number, no name of what it looks like: the error is no light meter.
    assert len(told) == 1


def test_undecided_captures_leave_for_as_long_as_the_self_test_holds(bench: Bench) -> None:
    camera = bench.camera()
    due = camera.test_due_in()
    bench.mask_tests.findings = [SEEN, UNDECIDED, UNDECIDED, SEEN, UNDECIDED]
    told = [camera.capture(release=True) for _ in range(5)]
    assert [each.proof.verdict for each in told] == [
        *("seen", "undecided", "undecided", "seen", "undecided")
    ]
    # The next test is when it would be in any light: nobody learns from it that it is dim.
    assert due - 5 < camera.test_due_in() <= due
    assert bench.test.runs == 1


def test_then_the_panel_is_tested_before_another_capture_leaves(bench: Bench) -> None:
    camera = bench.camera(test_every=1e-6)
    bench.mask_tests.findings = 3 * [UNDECIDED]
    for runs in (2, 3, 4):
        camera.capture(release=False).done()
        assert bench.test.runs == runs
    bench.test.faults = [SelfTestError("the panel does not hide")]
    with pytest.raises(SelfTestError):
        camera.capture(release=True)
    assert camera.state.state == "safe"


def test_a_capture_that_is_never_seen_pauses_the_camera(bench: Bench) -> None:
    camera = bench.camera()
    bench.mask_tests.findings = OFTEN * [NOT_SEEN]
    for runs in range(1, OFTEN):
        with pytest.raises(MaskNotSeenError):
            camera.capture(release=False)
        assert camera.state.state == "ready"
        assert bench.test.runs == 1 + runs
    with pytest.raises(MaskNotSeenError):
        camera.capture(release=False)
    # Opaque, but not tested once more: the test would pass as it did.
    assert not bench.display.shown[-1].any()
    assert bench.test.runs == OFTEN
    assert (camera.state.state, camera.state.remedy) == ("degraded", "calibrate")
    assert 5 < camera.test_due_in() <= 10
    with pytest.raises(NotReadyError, match="calibrate"):
        camera.capture(release=False)
    assert bench.test.runs == OFTEN
    # After the pause, whoever keeps the camera ready tries again; and again, later, if need be.
    camera.test_if_due()
    assert camera.state.state == "ready"
    assert camera.test_due_in() > 10
    bench.mask_tests.findings = [NOT_SEEN]
    with pytest.raises(MaskNotSeenError):
        camera.capture(release=False)
    assert 15 < camera.test_due_in() <= 20
    camera.test_if_due()
    camera.capture(release=False).done()
    bench.mask_tests.findings = [NOT_SEEN]
    with pytest.raises(MaskNotSeenError):
        camera.capture(release=False)
    assert camera.state.state == "ready"


def test_another_calibration_ends_the_pause(bench: Bench) -> None:
    camera = bench.camera()
    bench.mask_tests.findings = OFTEN * [NOT_SEEN]
    for _ in range(OFTEN):
        with pytest.raises(MaskNotSeenError):
            camera.capture(release=False)
    [signed] = [each.signed for each in calibration.EXAMPLES if hasattr(each, "signed")]
    assert signed is not None
    with camera.exclusive():
        camera.adopt(signed, 0.0, bench.source, bench.mask_tests)
    assert camera.state.state == "ready"
    bench.mask_tests.findings = (OFTEN - 1) * [NOT_SEEN]
    for _ in range(OFTEN - 1):
        with pytest.raises(MaskNotSeenError):
            camera.capture(release=False)
        assert camera.state.state == "ready"


def test_pauses_grow_up_to_ten_minutes_until_a_mask_is_seen() -> None:
    clock = Clock()
    brake, pauses = Brake(clock), []
    for _ in range(12):
        brake.note("not seen")
        # What is undecided says neither.
        brake.note("undecided")
        pauses.append(brake.holds_for())
    assert pauses == [0, 0, 10, 20, 40, 80, 160, 320, 600, 600, 600, 600]
    clock.now += 599
    assert brake.holds_for() == 1
    clock.now += 2
    assert brake.holds_for() == 0
    brake.note("seen")
    for pause in pauses[:4]:
        brake.note("not seen")
        assert brake.holds_for() == pause
    brake.release()
    assert brake.holds_for() == 0


class Told:
    """Masks that a panel is told, and what was made of their tests."""

    def __init__(self, *findings: Finding) -> None:
        self.tests, self.masks = FakeMaskTests(), ShownMasks()
        self.tests.findings = list(findings)

    def show(self, mark: str = "") -> None:
        """Show one more; its epoch holds its test no longer than that here."""
        levels = np.ones((2, 2), np.uint8)
        test = HeldTest(self.tests.prepare(levels), mark)
        self.masks.show(test)
        test.let_go()

    def find(self) -> list[int]:
        """Take a capture, and tell which masks before it was compared with."""
        proof, clipped = np.ones(PROOF.shape, np.float32), np.zeros(PROOF.shape, np.bool_)
        self.masks.find(proof, clipped)
        last = [test for test in self.tests.made if not test.erased][-1]
        return [
            place
            for each in last.before
            for place, test in enumerate(self.tests.made)
            if test is each
        ]

    @property
    def left(self) -> list[int]:
        """Which tests are not erased."""
        return [place for place, test in enumerate(self.tests.made) if not test.erased]


def test_a_mask_may_still_be_there_until_another_is_seen() -> None:
    told = Told(UNDECIDED, UNDECIDED, SEEN)
    told.show()
    assert told.find() == []
    told.show()
    # Twice: a capture that cannot be decided rules nothing out.
    assert told.find() == [0]
    assert told.find() == [0]
    assert told.left == [1]
    assert told.find() == []


def test_where_the_mask_before_was_not_seen_the_last_that_was_may_be_there() -> None:
    told = Told(SEEN, *4 * [UNDECIDED])
    told.show()
    told.find()
    for before in ([0], [1, 0], [2, 0], [3, 0]):
        told.show()
        assert told.find() == before
        assert told.left == sorted([*before, len(told.tests.made) - 1])


def test_without_any_capture_two_masks_are_kept_at_most() -> None:
    told = Told()
    for number in range(5):
        told.show()
        assert len(told.left) == min(number + 1, 3)


def test_a_stored_mask_that_comes_again_is_no_other_one() -> None:
    told = Told(*5 * [UNDECIDED])
    for mark, before in (("a", []), ("a", []), ("b", [1]), ("a", [2]), ("b", [3])):
        told.show(mark)
        assert told.find() == before
    # Drawn masks have no marks, and are all different.
    told.show("")
    told.show("")
    assert told.find() == [5, 3]


def test_nothing_is_left_of_masks_once_something_else_was_shown() -> None:
    told = Told()
    for _ in range(3):
        told.show()
    told.masks.forget()
    assert told.left == []
    told.masks.forget()
    with pytest.raises(ValueError, match="no mask is shown"):
        told.masks.find(np.ones(PROOF.shape, np.float32), np.zeros(PROOF.shape, np.bool_))
    told.show()
    assert told.find() == []


def test_a_mask_that_is_put_back_is_the_same_showing() -> None:
    told = Told(UNDECIDED)
    told.show()
    test = HeldTest(told.tests.prepare(np.ones((2, 2), np.uint8)))
    for _ in range(2):
        told.masks.show(test)
    assert told.find() == [0]
    told.masks.forget()
    assert told.left == [1]
    test.let_go()
    assert told.left == []


def test_what_a_camera_showed_before_is_ruled_out_by_one_capture(fresh_bench: Bench) -> None:
    camera = fresh_bench.camera()
    tests = fresh_bench.mask_tests
    camera.capture(release=False).done()
    camera.rotate()
    camera.await_next()
    shown, present, prepared = tests.made
    assert [test.erased for test in tests.made] == [False, False, False]
    camera.capture(release=False).done()
    assert present.before == [shown]
    assert [test.erased for test in tests.made] == [True, False, False]
    camera.capture(release=False).done()
    assert present.before == []
    camera.stop()
    assert [test.erased for test in (shown, present, prepared)] == [True, True, True]


def test_after_a_self_test_no_mask_before_can_be_there(fresh_bench: Bench) -> None:
    camera = fresh_bench.camera(test_every=1e-6)
    tests = fresh_bench.mask_tests
    camera.rotate()
    assert tests.made[0].erased
    tests.findings = [UNDECIDED]
    camera.capture(release=False).done()
    assert tests.made[1].before == []


def test_a_panel_that_fails_leaves_nothing_of_its_masks(fresh_bench: Bench) -> None:
    camera = fresh_bench.camera()
    camera.await_next()
    fresh_bench.display.faults = [DisplayError("the bus"), DisplayError("the bus")]
    with pytest.raises(DisplayError):
        camera.rotate()
    assert camera.present == (None, 0)
    assert all(test.erased for test in fresh_bench.mask_tests.made)


def departing(by: float) -> Finding:
    return replace(SEEN, departure=by)


def test_means_are_of_the_last_captures() -> None:
    assert Findings().means is None
    findings = Findings()
    findings.add(replace(UNDECIDED, margin=1.0, light=0.1))
    findings.add(replace(SEEN, margin=4.0, departure=1.5, light=0.3))
    means = findings.means
    assert means is not None
    assert (means.captures, means.undecided, means.margin) == (2, 0.5, 2.5)
    assert (means.departure, means.light) == (1.25, 0.2)
    for _ in range(CAPTURES):
        findings.add(departing(0.7))
    means = findings.means
    assert means is not None
    assert (means.captures, means.undecided, means.departure) == (CAPTURES, 0, 0.7)


USUAL = 0.6
"""Departure of captures that fit as well as any."""
HALF = 1 - DRIFTED * (1 - USUAL)
"""That of captures of which a mask leaves half of that."""


def after_usual() -> Findings:
    """Of a camera that took its first captures under a calibration."""
    findings = Findings()
    assert not any(findings.add(departing(USUAL)) for _ in range(CAPTURES))
    return findings


def test_a_drift_is_told_once_until_another_calibration_holds() -> None:
    findings, low = after_usual(), departing(HALF + 0.001)
    # Told with the capture that makes the mean of the last ones too low: here all must be.
    assert not any(findings.add(low) for _ in range(CAPTURES - 1))
    assert findings.add(low)
    assert not any(findings.add(low) for _ in range(2 * CAPTURES))
    findings.forget()
    assert findings.means is None
    # What is usual now is found anew.
    assert not any(findings.add(low) for _ in range(2 * CAPTURES))
    assert sum(findings.add(departing(1.0)) for _ in range(CAPTURES)) == 1


def test_less_than_that_is_no_drift() -> None:
    findings = after_usual()
    assert not any(findings.add(departing(HALF - 0.001)) for _ in range(2 * CAPTURES))
    assert not any(findings.add(departing(0.0)) for _ in range(2 * CAPTURES))


def test_one_odd_scene_is_no_drift() -> None:
    findings = after_usual()
    assert not findings.add(departing(10.0))
    assert not any(findings.add(departing(USUAL)) for _ in range(CAPTURES))


def test_captures_that_could_not_be_decided_are_no_drift() -> None:
    findings = after_usual()
    dark = replace(UNDECIDED, departure=1.0)
    assert not any(findings.add(dark) for _ in range(2 * CAPTURES))
    means = findings.means
    assert means is not None
    assert means.undecided == 1


def test_a_drift_asks_for_a_calibration_and_ends_nothing(bench: Bench) -> None:
    camera, told = bench.camera(), []

    def note(make: Callable[..., Event]) -> None:
        told.append(make(id="", at=datetime.now(UTC)))

    camera.listen(note)
    bench.mask_tests.findings = CAPTURES * [departing(USUAL)] + CAPTURES * [departing(0.99)]
    for _ in range(2 * CAPTURES):
        camera.capture(release=False).done()
    (fault,) = told
    assert isinstance(fault, Fault)
    assert (fault.code, fault.remedy) == ("calibration_due", "calibrate")
    assert not any(character.isdigit() for character in fault.detail)
    assert camera.state.state == "ready"
    means = camera.proof()
    assert means is not None
    assert means.departure == 0.99


def test_captures_that_did_not_leave_are_in_no_mean(bench: Bench) -> None:
    camera = bench.camera()
    assert camera.proof() is None
    bench.mask_tests.findings = [NOT_SEEN]
    with pytest.raises(MaskNotSeenError):
        camera.capture(release=False)
    assert camera.proof() is None


def test_notes_have_six_digits_and_are_of_captures_that_leave() -> None:
    note = proof_note(Finding("seen", 1234.56789, "before", 0.98765432, 1e-7 / 3))
    assert (note.verdict, note.margin, note.departure) == ("seen", 1234.57, 0.987654)
    assert note.light == 3.33333e-8
    with pytest.raises(ValueError, match="was not seen"):
        proof_note(NOT_SEEN)
