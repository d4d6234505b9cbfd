"""The engine: one mask per measurement, whatever fails."""

from __future__ import annotations

import threading
import time
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest

from veilcam_client.keys.commitments import calibration_digest
from veilcam_client.wire import calibration
from veilcam_client.wire.rotation import EveryCaptures, EverySeconds
from veilcam_server.camera.camera import MaskedCamera
from veilcam_server.devices import DisplayError, SensorError
from veilcam_server.devices.errors import LightError
from veilcam_server.errors import (
    FenceError,
    NotReadyError,
)
from veilcam_server.masks.pairs import PairReader

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench


def test_capture_carries_its_epoch_and_proof(bench: Bench) -> None:
    camera = bench.camera(settle=0.01)
    captured = camera.capture(release=False)
    assert captured.epoch == bench.epochs[-1]
    assert captured.exposure.started_after_shown_s >= captured.exposure.settle_s == 0.01
    assert camera.present == (captured.epoch, 1)


def test_capture_names_what_vouches_for_it(bench: Bench, camera: MaskedCamera) -> None:
    first, again = (camera.capture(release=False).provenance for _ in range(2))
    assert first.mask == again.mask
    assert 0 < first.tested < again.tested
    assert first.calibration is None
    [signed] = [each.signed for each in calibration.examples() if hasattr(each, "signed")]
    assert signed is not None
    with camera.exclusive():
        camera.adopt(signed, 0.0, bench.source)
    later = camera.capture(release=False).provenance
    assert later.calibration == calibration_digest(signed)
    assert later.mask != first.mask


def test_mask_and_classifier_change_together(bench: Bench, camera: MaskedCamera) -> None:
    for _ in range(12):
        camera.rotate()
        index = bench.pair_shown()
        assert index is not None
        reader = camera.capture(release=False).reader
        assert isinstance(reader, PairReader)
        weight = reader.classifier.network.weights["0.weight"]
        assert bool((weight == bench.bundle.pairs[index].weights["0.weight"]).all())


def order_of(bench: Bench, camera: MaskedCamera, changes: int) -> list[int | None]:
    """Pairs shown, one after the other."""
    shown = [bench.pair_shown()]
    for _ in range(changes):
        camera.rotate()
        shown.append(bench.pair_shown())
    return shown


def test_never_the_same_pair_twice_in_a_row_and_every_pair_in_another_order(bench: Bench) -> None:
    camera = bench.camera()
    order = order_of(bench, camera, 60)
    assert all(one != other for one, other in pairwise(order))
    assert set(order) == {0, 1, 2}
    assert len({tuple(order_of(bench, camera, 20)) for _ in range(4)}) == 4
    # Nor does a name.
    assert len(set(bench.epochs)) == len(bench.epochs) == 141
    assert all(len(name) == 32 for name in bench.epochs)


def test_every_n_captures_never_serves_one_more(bench: Bench) -> None:
    camera = bench.camera(policy=EveryCaptures(captures=3))
    epochs = [camera.capture(release=False).epoch for _ in range(12)]
    assert epochs == [name for name in bench.epochs[:4] for _ in range(3)]


def test_jitter_shortens_every_showing_by_its_own_time(bench: Bench) -> None:
    camera = bench.camera(policy=EverySeconds(seconds=1000.0, jitter=600.0))
    times = []
    for _ in range(8):
        times.append(camera.due_in())
        camera.rotate()
    assert all(390 < seconds <= 1000 for seconds in times)
    assert max(times) - min(times) > 1
    camera.policy = EverySeconds(seconds=1000.0)
    assert camera.due_in() > 990


def test_mask_that_changes_under_the_exposure_is_noticed(bench: Bench) -> None:
    camera = bench.camera()
    # Nothing but a defect can do this: the lock is held. The fence looks all the same.
    bench.sensor.before = camera._rotate
    with pytest.raises(FenceError):
        camera.capture(release=False)


def test_rotation_waits_for_the_capture_under_way(bench: Bench, camera: MaskedCamera) -> None:
    inside, go_on = threading.Event(), threading.Event()

    def hold() -> None:
        inside.set()
        go_on.wait(100)

    bench.sensor.before = hold
    results: list[str] = []
    capturing = threading.Thread(target=lambda: results.append(camera.capture(release=False).epoch))
    capturing.start()
    assert inside.wait(100)
    rotating = threading.Thread(target=camera.rotate)
    rotating.start()
    before = len(bench.display.shown)
    rotating.join(0.05)
    assert rotating.is_alive()
    assert len(bench.display.shown) == before
    go_on.set()
    capturing.join(100)
    rotating.join(100)
    assert results == [bench.epochs[0]]
    assert camera.present == (bench.epochs[1], 0)


def test_failed_write_puts_the_mask_before_back_which_must_settle_again(
    bench: Bench, display_fault: DisplayError
) -> None:
    camera = bench.camera(settle=0.02)
    epoch, index = camera.present[0], bench.pair_shown()
    camera.capture(release=False)
    bench.display.faults = [display_fault]
    begun = time.monotonic()
    with pytest.raises(DisplayError, match="could not be changed"):
        camera.rotate()
    assert bench.pair_shown() == index
    assert camera.state == ("ready", None, None)
    assert camera.present == (epoch, 1)
    captured = camera.capture(release=False)
    assert captured.epoch == epoch
    # Since it was put back, not since it was shown first.
    assert 0.02 <= captured.exposure.started_after_shown_s <= time.monotonic() - begun


@pytest.mark.parametrize("fault", [DisplayError("no answer"), ZeroDivisionError()])
@pytest.mark.parametrize("times", [2, 3])
def test_panel_that_fails_again_is_made_opaque_or_told_and_captures_stop(
    bench: Bench, fault: Exception, times: int, camera: MaskedCamera
) -> None:
    bench.display.faults = [fault] * times
    with pytest.raises(type(fault)):
        camera.rotate()
    reason = "failed and was made opaque" if times == 2 else "cannot be made opaque"
    state, detail, _ = camera.state
    assert state == "safe"
    assert reason in str(detail)
    assert bench.states[-1] == (state, detail)
    assert camera.present == (None, 0)
    with pytest.raises(NotReadyError, match=reason):
        camera.capture(release=False)
    assert bench.sensor.captures == 0
    assert bench.display.opaque == (times == 2)
    camera.rotate()
    assert camera.state == ("ready", None, None)
    assert camera.capture(release=False).epoch == bench.epochs[-1]


def test_mask_that_is_due_but_fails_is_not_used_once_more(
    bench: Bench, display_fault: DisplayError
) -> None:
    camera = bench.camera(policy=EveryCaptures(captures=1))
    camera.capture(release=False)
    bench.display.faults = [display_fault]
    with pytest.raises(DisplayError):
        camera.capture(release=False)
    assert bench.sensor.captures == 1
    assert camera.capture(release=False).epoch == bench.epochs[-1]


def test_sensor_that_fails_leaves_the_mask_usable(bench: Bench, camera: MaskedCamera) -> None:
    bench.sensor.fault = SensorError("no frame")
    with pytest.raises(SensorError):
        camera.capture(release=False)
    bench.sensor.fault = None
    assert camera.capture(release=False).epoch == bench.epochs[0]


def test_stopping_shows_opaque_and_ends_captures(bench: Bench, camera: MaskedCamera) -> None:
    camera.stop()
    camera.stop()
    assert not bench.display.shown[-1].any()
    assert bench.display.closed
    assert bench.sensor.closed
    with pytest.raises(NotReadyError, match="stopping"):
        camera.capture(release=False)
    with pytest.raises(NotReadyError):
        camera.rotate()


def test_holder_of_the_device_has_it_alone(bench: Bench, camera: MaskedCamera) -> None:
    camera.capture(release=False)
    tests = bench.test.runs
    with camera.exclusive() as device:
        assert camera.state[0] == "calibrating"
        assert camera.present == (None, 0)
        assert not bench.display.shown[-1].any()
        for refused in (lambda: camera.capture(release=True), camera.rotate):
            with pytest.raises(NotReadyError):
                refused()
        with pytest.raises(NotReadyError), camera.exclusive():
            pass
        assert np.array_equal(device.sensor.capture(0.0, 1.0).embedding, bench.sensor.measurement)
    assert bench.states[-1] == ("ready", None)
    assert bench.test.runs == tests + 1
    assert camera.capture(release=False).epoch == bench.epochs[-1] != bench.epochs[0]


def test_exclusive_use_that_ends_early_gives_the_device_back(
    bench: Bench, display_fault: DisplayError, camera: MaskedCamera
) -> None:
    bench.display.faults = [display_fault]  # it cannot be made opaque
    with pytest.raises(DisplayError), camera.exclusive():
        pytest.fail("nobody may have a panel that shows a mask")
    assert camera.state[0] == "ready"
    with pytest.raises(ZeroDivisionError), camera.exclusive():
        raise ZeroDivisionError
    assert camera.state[0] == "ready"


def test_secrets_stay_out_of_representations(bench: Bench, camera: MaskedCamera) -> None:
    bench.sensor.measurement = np.full((4, 5), 0.123456, np.float32)
    captured = camera.capture(release=False)
    assert "0.123" not in repr(captured)
    assert "array" not in repr(camera._panel.active)
    assert "tensor" not in repr(captured)


def test_sensor_that_fails_twice_in_a_row_is_given_up_until_a_test_has_passed(
    bench: Bench, camera: MaskedCamera
) -> None:
    for _ in range(3):
        bench.sensor.fault = SensorError("no frame")
        with pytest.raises(SensorError):
            camera.capture(release=False)
        assert camera.state.state == "ready"
        bench.sensor.fault = None
        camera.capture(release=False)  # forgets the one before
    bench.sensor.fault = SensorError("no frame", remedy="run_doctor")
    for _ in range(2):
        with pytest.raises(SensorError):
            camera.capture(release=False)
    assert bench.states[-1] == ("degraded", "no frame")
    assert camera.state.remedy == "run_doctor"
    assert not bench.display.shown[-1].any()
    runs, captures = bench.test.runs, bench.sensor.captures
    with pytest.raises(NotReadyError, match="no frame"):
        camera.capture(release=False)
    assert bench.sensor.captures == captures
    bench.sensor.fault = None
    assert camera.test_due_in() == 0
    camera.test_if_due()
    assert bench.test.runs == runs + 1
    camera.capture(release=False)
    assert camera.state.state == "ready"


def test_for_the_light_no_sensor_is_given_up(bench: Bench, camera: MaskedCamera) -> None:
    bench.sensor.fault = LightError("saturated")
    for _ in range(5):
        with pytest.raises(LightError):
            camera.capture(release=False)
    assert camera.state[0] == "ready"
