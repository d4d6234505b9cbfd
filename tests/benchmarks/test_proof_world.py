"""Cameras, scenes, faults and captures of the proof's world are what they are said to be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.proof.cameras import MARGIN, Belief, Build, draw_belief, draw_build
from benchmarks.proof.captures import (
    CLIPPED,
    LEVELS,
    MAINS,
    SHARE,
    Plan,
    draw_plan,
    exposed,
    lit,
    row_gains,
    scales,
)
from benchmarks.proof.faults import FAULTS, SHIFTS, fault_patches, shifted_patches
from benchmarks.proof.light import BINS
from benchmarks.proof.scenes import OBSERVED, draw_objects, draw_surroundings
from benchmarks.proof.world import HALF_SPACE, STATES, Batch, Extent, World

from veilcam_optics.camera.geometry import Camera, Scene
from veilcam_optics.camera.imperfections import Imperfections
from veilcam_server.demo_data import BUNDLE, FRESH, load_digits
from veilcam_training.bundle import read_bundle

DIGITS = load_digits()
SMALL = Extent(masks=2, captures=6, objects=4, surroundings=4)
PERFECT = Build(
    camera=Camera(),
    imperfections=Imperfections(),
    leakage=0.0,
    band=0.0,
    full_scale=1.0,
    electrons=1e4,
    read_noise=0.0,
    hot=np.zeros(BINS, bool),
)
TRUE = Belief(Imperfections(), gain=1.0, black=0.0)


def _chance() -> np.random.Generator:
    return np.random.default_rng(3)


def _masks(count: int) -> list[np.ndarray[tuple[int, ...], np.dtype[np.uint8]]]:
    return list(_chance().integers(64, size=(count, *Camera().mask_shape), dtype=np.uint8))


def _plan(count: int) -> Plan:
    return draw_plan(count, 4, 4, _chance())


def test_a_perfect_panel_shows_what_it_is_told_and_is_opaque_around() -> None:
    (levels,) = _masks(1)
    patch = PERFECT.patch(levels)
    np.testing.assert_allclose(patch[MARGIN:-MARGIN, MARGIN:-MARGIN], levels / 63, atol=1e-6)
    patch[MARGIN:-MARGIN, MARGIN:-MARGIN] = 0
    assert not patch.any()


def test_a_built_panel_has_its_gamma_its_floor_and_its_dead_lines() -> None:
    real = Imperfections(gamma=1.3, contrast_floor=0.1, dead_rows=(2,), dead_transmittance=0.7)
    (levels,) = _masks(1)
    patch = replace(PERFECT, imperfections=real).patch(levels)
    assert patch[0, 0] == patch[MARGIN + 2, 0] == pytest.approx(0.1)
    assert patch[MARGIN + 2, MARGIN:-MARGIN] == pytest.approx(0.7)
    shown = 0.1 + 0.9 * (levels[0, 0] / 63) ** 1.3
    assert patch[MARGIN, MARGIN] == pytest.approx(shown)


def test_faults_show_what_they_are_named_for() -> None:
    due, before, earlier = _masks(3)
    shown = dict(zip(FAULTS, fault_patches(PERFECT, due, before, earlier), strict=True))
    assert (shown["dead"][MARGIN:-MARGIN, MARGIN:-MARGIN] == 1).all()
    assert (shown["bare"] == 1).all()
    assert not shown["opaque"].any()
    np.testing.assert_array_equal(shown["stuck"], PERFECT.patch(before))
    np.testing.assert_array_equal(shown["lost"], PERFECT.patch(earlier))
    np.testing.assert_allclose(shown["inverted"], 1 - PERFECT.patch(due), atol=1e-6)


def test_a_shifted_mask_is_the_mask_elsewhere() -> None:
    (due,) = _masks(1)
    for (down, right), patch in zip(SHIFTS, shifted_patches(PERFECT, due), strict=True):
        np.testing.assert_array_equal(np.roll(patch, (-down, -right), (0, 1)), PERFECT.patch(due))


def test_calibrations_differ_from_cameras_by_what_they_leave() -> None:
    chance = _chance()
    builds = [draw_build(Camera(), chance) for _ in range(300)]
    errors = {
        name: [
            getattr(draw_belief(build, chance).imperfections, name)
            - getattr(build.imperfections, name)
            for build in builds
        ]
        for name in ("shift_y", "distance_error", "rotation")
    }
    for name, spread in (("shift_y", 2e-6), ("distance_error", 10e-6), ("rotation", 0.2e-3)):
        # The standard deviation of 300 is known to 4 %.
        assert np.std(errors[name]) == pytest.approx(spread, rel=0.2)
    relative = [
        draw_belief(build, chance).imperfections.gamma / build.imperfections.gamma - 1
        for build in builds
    ]
    assert 0.045 < max(np.abs(relative)) <= 0.05


def test_objects_come_in_pairs_and_surroundings_fill_the_field() -> None:
    objects = draw_objects(6, 60, square=20, digits=DIGITS, tint=0.0, chance=_chance())
    assert objects.shape == (12, 3, 60, 60)
    for still, moved in zip(objects[::2], objects[1::2], strict=True):
        assert still.any()
        # What leaves the field is gone; nothing comes in.
        assert moved.sum() <= still.sum() * (1 + 1e-6)
    around = draw_surroundings(20, 60, 0.0, _chance())
    assert (around >= 0).all()
    np.testing.assert_array_equal(around[:, 0], around[:, 2])
    tinted = draw_surroundings(20, 60, 0.3, _chance())
    np.testing.assert_allclose(np.einsum("c,nchw->nhw", OBSERVED, tinted), around[:, 0], rtol=1e-5)
    assert np.abs(tinted - around).max() > 0.1


def test_flicker_is_gone_where_an_exposure_is_a_whole_period() -> None:
    plan = _plan(400)
    assert set(plan.frequency) == set(MAINS)
    gains = row_gains(plan)
    assert 0.1 < np.abs(gains - 1).max() <= 0.2
    np.testing.assert_allclose(row_gains(replace(plan, exposure=1 / plan.frequency)), 1)


def test_a_capture_adds_its_object_on_its_way_to_its_surroundings() -> None:
    chance = _chance()
    objects, around = (chance.random((count, *BINS)).astype(np.float32) for count in (8, 4))
    plan = replace(_plan(6), flicker=np.zeros((2, 6)), moving=np.full(6, 0.5))
    light = lit(plan, objects, around)
    for place in range(6):
        first, second = (objects[2 * plan.object[place] + each] for each in range(2))
        there = plan.shares[1, place] * around[plan.surroundings[place]]
        for row, went in ((0, 0.0), (-1, 0.5)):
            here = (1 - went) * first[row] + went * second[row]
            expected = plan.shares[0, place] * here + there[row]
            np.testing.assert_allclose(light[place, row], expected, rtol=1e-6)


def test_light_is_as_bright_as_planned_and_clips_no_more() -> None:
    plan, healthy = _plan(300), _chance().random((300, *BINS))
    light = healthy * scales(plan, healthy, PERFECT)[:, None, None]
    _, clipped = exposed(light, plan.peak, PERFECT, TRUE, _chance())
    assert np.max(clipped.mean((1, 2))) <= CLIPPED
    assert clipped.any()
    for place, level in enumerate(LEVELS):
        chosen = plan.level == place
        brightest = np.quantile(light[chosen], 1 - CLIPPED, axis=(1, 2)) * plan.peak[chosen]
        assert (brightest <= SHARE[level]).all()
        assert (brightest >= 0.45 * SHARE[level]).all()
        assert clipped[chosen].any() == (level == "bright")


def test_noise_is_that_of_its_electrons() -> None:
    light = np.full((200, *BINS), 0.25)
    noisy = replace(PERFECT, read_noise=30.0)
    measurements, _ = exposed(light, np.ones(200), noisy, TRUE, _chance())
    # 2,500 electrons of 10,000, and 30 of the reading: the variance of 153,600 is known to 0.4 %.
    assert measurements.var() * 1e8 == pytest.approx(2500 + 900, rel=0.02)
    assert measurements.mean() == pytest.approx(0.25, rel=1e-3)


def test_more_light_is_exposed_for_a_quarter_until_it_fits() -> None:
    light = np.full((2, *BINS), 5.0)
    measurements, clipped = exposed(light, np.ones(2), PERFECT, TRUE, _chance())
    assert not clipped.any()
    assert measurements.mean() == pytest.approx(5, rel=1e-2)


def test_a_calibration_that_is_right_takes_stray_light_off() -> None:
    light = _chance().random((2, *BINS))
    real = Imperfections(stray_light=0.05)
    build = replace(PERFECT, imperfections=real, electrons=1e12, full_scale=2.0)
    measurements, _ = exposed(
        light, np.ones(2), build, replace(TRUE, imperfections=real), _chance()
    )
    np.testing.assert_allclose(measurements, light, atol=1e-5)
    unaware, _ = exposed(light, np.ones(2), build, TRUE, _chance())
    np.testing.assert_allclose(
        unaware, 0.95 * light + 0.05 * light.mean((1, 2))[:, None, None], atol=1e-5
    )


def _world(seed: int = 1) -> World:
    return World(read_bundle(FRESH), DIGITS, seed, SMALL)


@pytest.mark.slow
def test_a_seed_is_a_world() -> None:
    first, again, other = (
        [batch.measurements for batch in _world(seed).healthy()] for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)


def test_light_comes_from_three_squares_to_the_half_space() -> None:
    bundle, few = read_bundle(FRESH), replace(SMALL, objects=1, surroundings=1)
    sides = [World(bundle, DIGITS, seed, few).sides for seed in range(20)]
    limited = [high for high, wide in sides if high == wide]
    assert 3 <= min(limited) < max(limited) <= 7
    assert 1 <= sides.count(HALF_SPACE) == 20 - len(limited) <= 12


def test_an_even_half_space_falls_off_towards_the_edges_of_the_sensor() -> None:
    # Slopes beyond those of HALF_SPACE meet no place of sensor and window (hence the name).
    camera, scene = Camera(), Scene()
    for side, lines, bins, share in zip(
        (camera.sensor.height, camera.sensor.width),
        (camera.row_centres, camera.column_centres),
        BINS,
        HALF_SPACE,
        strict=True,
    ):
        reach = (side / 2 * (1 - 1 / bins) + lines[-1]) / camera.distance
        square = scene.height / scene.distance
        assert reach <= share / 2 * square < 1.1 * reach


def test_cameras_differ_in_what_they_collect_unless_it_is_given() -> None:
    bundle, few = read_bundle(FRESH), replace(SMALL, objects=1, surroundings=1)
    drawn = {World(bundle, DIGITS, seed, few).build.electrons for seed in range(3)}
    assert len(drawn) == 3
    given = World(bundle, DIGITS, 1, replace(few, electrons=2500.0)).build
    assert (given.electrons, given.read_noise) == (2500.0, 0.0)


@pytest.mark.slow
def test_no_mask_comes_again_while_another_is_due() -> None:
    world = World(read_bundle(BUNDLE), DIGITS, 1, replace(SMALL, masks=10))
    for three in zip(world.masks, world.masks[1:], world.masks[2:], strict=False):
        assert len({mask.tobytes() for mask in three}) == 3


@pytest.mark.slow
def test_faults_let_through_the_light_that_they_should() -> None:
    world = _world()
    batches: dict[str, Batch] = {}
    for batch in world.faulty():
        batches.setdefault(batch.state, batch)
    assert tuple(batches) == STATES
    assert batches["stuck"].before is world.masks[1]
    light = {state: float(batch.measurements.mean()) for state, batch in batches.items()}
    healthy = float(next(_world().healthy()).measurements.mean())
    # Uniform amplitudes pass a third of what an open panel passes.
    assert light["dead"] > 2 * healthy
    assert light["opaque"] < 0.1 * healthy
    # Lamps flicker from row to row; along a row light is the same, but for its noise.
    flat = batches["bare"].measurements[batches["bare"].plan.level == 0].mean(1)
    assert (np.abs(flat / flat.mean(1, keepdims=True) - 1) < 0.02).all()
    # Around an inverted window the panel is open: more light than a window lets through.
    assert light["inverted"] > light["dead"]
    assert light["bare"] > light["inverted"]
