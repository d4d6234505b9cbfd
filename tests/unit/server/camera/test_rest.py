"""A camera that shall not look: opaque, untested, and awake again when it may."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import pytest

from veilcam_client.wire.rotation import EverySeconds
from veilcam_server.camera.camera import MaskedCamera
from veilcam_server.devices import DisplayError
from veilcam_server.errors import ProblemError, SelfTestError

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench


def state_of(camera: MaskedCamera) -> str:
    """Asked anew each time, which a type checker does not believe of an attribute."""
    return camera.state.state


def opaque(bench: Bench) -> bool:
    return not bench.display.shown[-1].any()


def test_panel_is_opaque_and_nothing_is_taken(bench: Bench) -> None:
    camera = bench.camera()
    camera.rest("it is night")
    assert opaque(bench)
    assert camera.state == ("off", "it is night", None)
    shown, captures = len(bench.display.shown), bench.sensor.captures
    for refused in (
        lambda: camera.capture(release=False),
        lambda: camera.capture(release=True),
        camera.rotate,
        lambda: camera.exclusive().__enter__(),
    ):
        with pytest.raises(ProblemError, match="it is night"):
            refused()
    camera.rotate_if_due()
    assert (len(bench.display.shown), bench.sensor.captures) == (shown, captures)
    camera.stop()


def test_nothing_is_due_meanwhile(bench: Bench) -> None:
    camera = bench.camera(policy=EverySeconds(seconds=0.1), test_every=0.01)
    runs = bench.test.runs
    camera.rest("it is night")
    assert camera.due_in() == math.inf
    assert camera.test_due_in() == math.inf
    camera.test_if_due()
    assert bench.test.runs == runs
    assert opaque(bench)
    camera.stop()


def test_camera_wakes_with_another_mask_after_a_test_if_that_is_due(bench: Bench) -> None:
    camera = bench.camera(test_every=0.01)
    runs, epochs = bench.test.runs, list(bench.epochs)
    camera.rest("it is night")
    camera.wake()
    assert state_of(camera) == "ready"
    assert bench.pair_shown() is not None
    assert len(bench.epochs) == len(epochs) + 1
    assert bench.epochs[-1] not in epochs
    assert bench.test.runs >= runs
    camera.capture(release=False).done()
    camera.wake()  # of what does not rest
    assert len(bench.epochs) == len(epochs) + 1
    camera.stop()


def test_panel_that_fails_is_made_opaque_later(bench: Bench, display_fault: DisplayError) -> None:
    camera = bench.camera()
    bench.display.faults += [display_fault, display_fault]
    with pytest.raises(DisplayError, match="cannot be made opaque"):
        camera.rest("it is night")
    assert state_of(camera) == "safe"
    assert camera.test_due_in() == 0
    with pytest.raises(DisplayError):
        camera.test_if_due()
    camera.test_if_due()
    assert camera.state == ("off", "it is night", None)
    assert opaque(bench)
    assert bench.pair_shown() is None
    camera.stop()


def test_self_test_that_fails_at_waking_leaves_it_opaque_and_is_tried_again(
    bench: Bench,
) -> None:
    camera = bench.camera()
    camera.rest("it is night")
    bench.display.resets += 1
    bench.test.faults.append(SelfTestError("it does not hide the scene"))
    with pytest.raises(SelfTestError):
        camera.wake()
    assert state_of(camera) == "safe"
    assert opaque(bench)
    camera.test_if_due()
    assert state_of(camera) == "ready"
    camera.stop()


def test_holder_of_the_device_keeps_it_until_he_gives_it_back(bench: Bench) -> None:
    camera = bench.camera()
    with camera.exclusive():
        camera.rest("it is night")
        assert state_of(camera) == "calibrating"
    assert camera.state == ("off", "it is night", None)
    assert opaque(bench)
    camera.wake()
    with camera.exclusive():
        camera.rest("it is night")
        camera.wake()
        assert state_of(camera) == "calibrating"
    assert state_of(camera) == "ready"
    camera.stop()


def test_camera_that_stops_neither_rests_nor_wakes(bench: Bench) -> None:
    camera: MaskedCamera = bench.camera()
    camera.stop()
    shown = len(bench.display.shown)
    camera.rest("it is night")
    camera.wake()
    assert state_of(camera) == "stopping"
    assert len(bench.display.shown) == shown
