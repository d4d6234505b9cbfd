"""What a capture says of its mask, in light that the test did not make."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from tests.optics.proof.rig import (
    CAMERA,
    UNCLIPPED,
    Array,
    Room,
    figure,
    mask,
    measured,
    natural,
    opened,
    wall,
)

from veilcam_optics.camera.imperfections import Imperfections
from veilcam_optics.errors import OpticsError
from veilcam_optics.proof import PROOF, Finding, MaskTest, MaskTests

ROOMS = [natural(1), natural(2, 1.4), figure(3), figure(4)]
BARE = opened(np.full(CAMERA.mask_shape, 63, np.uint8), around=1.0)


@pytest.fixture(scope="module")
def tests() -> MaskTests:
    return MaskTests(CAMERA)


@pytest.fixture(scope="module")
def due(tests: MaskTests) -> MaskTest:
    return tests.prepare(mask(3))


@pytest.fixture(scope="module")
def before(tests: MaskTests) -> list[MaskTest]:
    """Of the masks that were shown before it."""
    return [tests.prepare(mask(2)), tests.prepare(mask(1))]


def _found(
    test: MaskTest,
    panel: Array,
    room: Room,
    seed: int = 0,
    *,
    snr_db: float = 80,
    before: Sequence[MaskTest] = (),
) -> Finding:
    return test.find(measured(room.behind(panel), seed, snr_db), UNCLIPPED, before)


@pytest.mark.parametrize("room", ROOMS)
def test_the_mask_that_is_there_is_seen(due: MaskTest, room: Room) -> None:
    found = _found(due, opened(mask(3)), room)
    assert found.verdict == "seen"
    assert found.margin > 0
    assert 0 < found.departure < 1


@pytest.mark.parametrize("room", ROOMS)
@pytest.mark.parametrize("shown", [2, 1])
def test_a_mask_that_stayed_is_named(
    due: MaskTest, before: list[MaskTest], room: Room, shown: int
) -> None:
    found = _found(due, opened(mask(shown)), room, before=before)
    assert (found.verdict, found.nearest) == ("not seen", "before")
    assert found.margin < 0


def test_a_mask_that_nobody_names_is_no_alternative(due: MaskTest, before: list[MaskTest]) -> None:
    for panel, told in ((2, ()), (2, before[1:]), (1, before[:1])):
        assert _found(due, opened(mask(panel)), natural(1), before=told).verdict == "undecided"
    assert _found(due, opened(mask(3)), natural(1), before=before).verdict == "seen"


@pytest.mark.parametrize("room", ROOMS)
def test_a_mask_of_nobody_is_not_seen_as_the_one_that_is_due(due: MaskTest, room: Room) -> None:
    assert {_found(due, opened(mask(each)), room).verdict for each in range(50, 60)} == {
        "undecided"
    }


@pytest.mark.parametrize("room", [*ROOMS, wall()])
def test_a_panel_without_power_is_found_in_any_light(due: MaskTest, room: Room) -> None:
    # Light of all directions reaches every place of the sensor.
    even = np.full(PROOF.shape, room.scene.mean())
    for snr_db in (80.0, 40.0, 20.0):
        found = due.find(measured(even, 1, snr_db), UNCLIPPED)
        assert (found.verdict, found.nearest) == ("not seen", "transparent")


def test_a_window_that_is_open_is_found(due: MaskTest) -> None:
    top = np.full(CAMERA.mask_shape, 63, np.uint8)
    found = _found(due, opened(top), figure(3), snr_db=80)
    assert (found.verdict, found.nearest) == ("not seen", "transparent")


@pytest.mark.parametrize("room", ROOMS)
def test_an_inverted_panel_is_not_seen_as_its_mask(due: MaskTest, room: Room) -> None:
    inverted = opened((63 - mask(3)).astype(np.uint8), around=1.0)
    share = CAMERA.panel.fill_factor
    light = room.behind(inverted - share) + room.behind_all_of(share)
    assert due.find(measured(light, 0, 80), UNCLIPPED).verdict != "seen"


def test_a_wall_says_nothing_of_the_mask_before_it(due: MaskTest, before: list[MaskTest]) -> None:
    # Behind a window its light falls off to the edges, which a panel without power lacks.
    for panel in (opened(mask(3)), opened(mask(2))):
        assert _found(due, panel, wall(), before=before).verdict == "undecided"


@pytest.mark.parametrize("seed", range(3))
def test_in_the_dark_nothing_is_decided(due: MaskTest, seed: int) -> None:
    chance = np.random.default_rng(seed)
    dark = (9e-5 + 1e-5 * chance.standard_normal(PROOF.shape)).astype(np.float32)
    assert due.find(dark, UNCLIPPED).verdict == "undecided"
    assert due.find(0 * dark, UNCLIPPED).verdict == "undecided"
    # As much light would be that of a panel without power, were it known to be light.
    knowing = MaskTests(CAMERA, dark=1e-6).prepare(mask(3))
    assert knowing.find(dark, UNCLIPPED).nearest == "transparent"


def test_clipped_bins_are_left_out(due: MaskTest) -> None:
    capture = measured(natural(1).behind(opened(mask(3))), 0)
    clipped = np.random.default_rng(1).random(PROOF.shape) < 0.02
    whole = due.find(capture, UNCLIPPED)
    capture[clipped] = 100 * np.max(capture)
    assert due.find(capture, clipped).verdict == "seen"
    assert due.find(capture, clipped).light == pytest.approx(whole.light, rel=0.01)
    assert due.find(capture, UNCLIPPED).verdict == "undecided"
    assert due.find(capture, np.ones(PROOF.shape, bool)).verdict == "undecided"


def test_flicker_and_brightness_do_not_count(due: MaskTest) -> None:
    light = natural(1).behind(opened(mask(3)))
    rows = 1 + 0.2 * np.sin(2 * np.pi * 2.3 * np.arange(PROOF.rows) / PROOF.rows)
    for changed in (1e3 * light, light * rows[:, None]):
        assert due.find(measured(changed, 0), UNCLIPPED).verdict == "seen"


def test_a_place_that_is_off_does_not_count(tests: MaskTests, due: MaskTest) -> None:
    # The camera is as drawn, the test believes otherwise.
    off = Imperfections(shift_y=1e-4, shift_x=-2e-4, distance_error=1e-4, rotation=0.01, gamma=1.1)
    other = MaskTests(CAMERA, imperfections=off).prepare(mask(3))
    for room in ROOMS:
        found = _found(other, opened(mask(3)), room)
        assert found.verdict == "seen"
        assert found.margin > 0.8 * _found(due, opened(mask(3)), room).margin


def test_what_is_known_of_the_panel_counts(tests: MaskTests) -> None:
    dead = Imperfections(dead_rows=tuple(range(0, 51, 2)), dead_transmittance=0.2)
    levels = mask(3)
    levels[::2] = round(0.2 * 63)
    panel = opened(levels)
    knowing = MaskTests(CAMERA, imperfections=dead).prepare(mask(3))
    assert (
        _found(knowing, panel, natural(1)).margin
        > _found(tests.prepare(mask(3)), panel, natural(1)).margin + 1
    )


def test_nothing_of_a_mask_is_left_once_it_is_erased(tests: MaskTests) -> None:
    test = tests.prepare(mask(3))
    test.erase()
    assert not any(each.texture.any() or each.phases.any() for each in (test.mark, test.inverted))
    assert _found(test, opened(mask(3)), natural(1)).verdict == "undecided"
    # What is the panel's is all tests'.
    assert _found(tests.prepare(mask(2)), opened(mask(2)), natural(1)).verdict == "seen"


def test_nothing_of_a_mask_is_printed(due: MaskTest) -> None:
    assert "mark" not in repr(due)
    assert "array" not in repr(due)


def test_what_is_no_capture_is_refused(tests: MaskTests, due: MaskTest) -> None:
    capture = np.ones(PROOF.shape, np.float32)
    with pytest.raises(OpticsError, match="measurement"):
        due.find(capture[1:], UNCLIPPED)
    with pytest.raises(OpticsError, match="clipped"):
        due.find(capture, UNCLIPPED[1:])
    with pytest.raises(OpticsError, match="finite"):
        due.find(np.where(capture == 1, np.nan, capture).astype(np.float32), UNCLIPPED)
    with pytest.raises(OpticsError, match="levels"):
        tests.prepare(mask(1)[1:])
    with pytest.raises(OpticsError, match="levels"):
        tests.prepare(np.full(CAMERA.mask_shape, 64, np.uint8))
    with pytest.raises(OpticsError, match="dark"):
        MaskTests(CAMERA, dark=-1.0)
    with pytest.raises(OpticsError, match="dead_rows"):
        MaskTests(replace(CAMERA), imperfections=Imperfections(dead_rows=(99,)))


def test_many_captures_are_tested_as_each_is(due: MaskTest) -> None:
    captures = np.stack([measured(room.behind(opened(mask(3))), 0) for room in ROOMS])
    clipped = np.random.default_rng(1).random(captures.shape) < 0.02
    together = due.find_each(captures, clipped)
    for found, capture, hidden in zip(together, captures, clipped, strict=True):
        alone = due.find(capture, hidden)
        assert (found.verdict, found.nearest) == (alone.verdict, alone.nearest)
        # In single precision.
        assert found.margin == pytest.approx(alone.margin, rel=1e-3)
