"""The oracle against closed forms and against another way, and plans against the oracle."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.camera.imperfections import Conditions
from veilcam_optics.plan import Plan, plan

from . import judge as judging
from . import quadrature, run
from .jobs import BOXES, DISTANCES, PITCHES, WAVELENGTHS, Job, draw, draw_everyday, read
from .judge import Result, judge, judge_job
from .physics import Axis, Beam, Light, extrapolated, transfer
from .run import draw_chart, figures_of, kept, main, reasons

WAVELENGTH = 0.5e-6
FAR = 1e3


def hole(width: float, distance: float, *, sensor: float, pixels: int) -> Light:
    axis = Axis(1, width, 1, 1, sensor, pixels, 1, 1e-6)
    return Light(axis, axis, distance, (Beam(0, WAVELENGTH, FAR, 1.0),))


def test_far_field_of_a_square_hole() -> None:
    """Fraunhofer: (a^2 / lambda d)^2 sinc^2 sinc^2 (Goodman, equation 4-28)."""
    width, distance, pixels = 10e-6, 20e-3, 9
    sensor = 2 * WAVELENGTH * distance / width
    found = transfer(hole(width, distance, sensor=sensor, pixels=pixels), np.ones((1, 3, 1, 1)))
    at = (np.arange(pixels * 40) + 0.5) / (pixels * 40) * sensor - sensor / 2
    line = (np.sinc(width * at / (WAVELENGTH * distance)) ** 2).reshape(pixels, 40).mean(1)
    wanted = (width**2 / (WAVELENGTH * distance)) ** 2 * np.outer(line, line)
    # Angles reach 0.05 rad, whose square is what Fraunhofer leaves out.
    assert np.max(np.abs(found.reshape(pixels, pixels) - wanted)) < 5e-3 * np.max(wanted)


def test_scene_at_an_angle_is_fainter_by_the_fourth_power_of_its_cosine() -> None:
    """Lambert, the tilted plane, and the distance; the sensor sees all of the hole's light."""
    wide = Axis(1, 10e-6, 1, 1, 100e-6, 1, 1, 1e-6)
    steep = Axis(1, 10e-6, 1, 1, 100e-6, 1, 3, 0.25)
    bright = Light(steep, wide, 20e-6, (Beam(0, WAVELENGTH, 1.0, 1.0),))
    found = transfer(bright, np.ones((1, 3, 1, 1)))[0, :, 0]
    assert found[0] / found[1] == pytest.approx(math.cos(math.atan(0.25)) ** 4, rel=2e-2)


@pytest.mark.slow
def test_wide_scene_pixel_is_as_bright_as_all_of_it() -> None:
    """A point in its middle stands for a pixel of 45 degrees as 25 points do, where all is seen."""
    wide = Axis(1, 30e-6, 1, 1, 3e-6, 1, 1, 0.8)
    found = [
        transfer(
            Light(wide, wide, 5e-6, (Beam(0, WAVELENGTH, 1.0, 1.0),), sources=points),
            np.ones((1, 3, 1, 1)),
        ).item()
        for points in (1, 5)
    ]
    # The mean of cos^4 over tangents up to 0.4; the middle alone would be brighter by a fifth.
    assert found[0] == pytest.approx(found[1], rel=2e-2)
    assert found[0] < 0.9


def test_finer_cells_change_nothing() -> None:
    axis = Axis(3, 12e-6, 3, 5, 40e-6, 4, 2, 1e-3)
    turned = Light(axis, axis, 1e-3, (Beam(0, WAVELENGTH, 0.3, 1.0),), rotation=0.02)
    amplitudes = np.random.default_rng(0).random((1, 3, 3, 3))
    coarse, fine = (transfer(turned, amplitudes, finer=finer) for finer in (1, 2))
    assert np.linalg.norm(coarse - fine) < 2e-3 * np.linalg.norm(fine)


def test_box_is_the_middle_of_its_pixel() -> None:
    """A box of a third of the side is the middle one of three by three full ones."""
    found = []
    for pixels, fill in ((2, 1 / 3), (6, 1.0)):
        axis = Axis(3, 12e-6, 3, 5, 40e-6, pixels, 2, 1e-3, fill=fill)
        light = Light(axis, axis, 1e-3, (Beam(0, WAVELENGTH, 0.3, 1.0),), sources=1)
        found.append(transfer(light, np.ones((1, 3, 3, 3)), finer=4).reshape(4, pixels, pixels))
    np.testing.assert_allclose(found[0], found[1][:, 1::3, 1::3], rtol=2e-3)


def test_cells_of_two_sizes_stand_for_none() -> None:
    """What two coarse sizes say together is closer than the finer of them, by far."""
    light = hole(20e-6, 2e-3, sensor=150e-6, pixels=5)
    once, twice, fine = (transfer(light, np.ones((1, 3, 1, 1)), times=n) for n in (1, 2, 5))
    off = [np.linalg.norm(found - fine) for found in (extrapolated(once, twice, 2.0), twice)]
    assert off[0] < off[1] / 3


def test_odd_closed_part_leaves_apertures_in_the_middle() -> None:
    """One part of five is open at one end of its cells: a mirrored mask gives mirrored light."""
    axis = Axis(3, 12e-6, 2, 5, 36e-6, 6, 1, 1e-6)
    straight = Light(axis, axis, 100e-6, (Beam(0, WAVELENGTH, 0.3, 1.0),))
    amplitudes = np.random.default_rng(0).random((1, 3, 3, 3))
    found = transfer(straight, amplitudes, finer=0.25).reshape(6, 6)
    mirrored = transfer(straight, amplitudes[:, :, ::-1, ::-1], finer=0.25).reshape(6, 6)
    np.testing.assert_allclose(mirrored, found[::-1, ::-1], rtol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rotation", "fill", "few"), [(0.0, 1.0, 3e-3), (0.1, 1.0, 3e-3), (0.1, 0.3, 6e-3)]
)
def test_another_way_gives_the_same_light(rotation: float, fill: float, few: float) -> None:
    """Three colours and a mask off the axis, seen at 11 degrees; 24 x 32 um of apertures."""
    y = Axis(3, 4e-6, 3, 5, 14e-6, 3, 3, 0.1, shift=1e-6, fill=fill)
    x = Axis(2, 6e-6, 4, 6, 16e-6, 4, 2, 0.1)
    beams = (Beam(0, 0.6e-6, 0.5, 0.3), Beam(1, 1.5e-6, 0.5, 0.6), Beam(2, 1e-6, 0.3, 0.1))
    job = Light(y, x, 12e-6, beams, rotation, sources=3)
    amplitudes = np.random.default_rng(0).random((2, 3, 3, 2))
    other = quadrature.transfer(job, amplitudes, nodes=(12, 12, 3), pixel=(0, 1))
    found = transfer(job, amplitudes, only=(0, 1))[:, 0]
    # Nine points stand for the whole of a scene pixel that is 0.2 rad wide: that leaves 2e-3, and
    # 5e-3 where a box averages less.
    assert np.linalg.norm(found - other) < few * np.linalg.norm(other)


def test_jobs_are_as_wide_as_they_say() -> None:
    """Ends of every length, all conditions, and the same job from the same seed."""
    drawn = [draw(seed) for seed in range(200)]
    for ends, values in (
        (PITCHES, [job.camera.panel.pitch_y for job in drawn]),
        (DISTANCES, [job.camera.distance for job in drawn]),
        (WAVELENGTHS, [max(job.camera.wavelengths) for job in drawn]),
    ):
        assert min(values) == ends[0]
        assert max(values) == ends[1]
    seen = Counter(effect for job in drawn for effect in job.effects)
    assert len(seen) == 13
    assert min(seen.values()) >= 5
    fills = [job.embedding.fill for job in drawn]
    assert min(fills) == BOXES[0] < max(fills) == 1
    assert draw(3) == drawn[3]


def test_everyday_jobs_have_no_conditions() -> None:
    for job in map(draw_everyday, range(20)):
        assert job.conditions == Conditions()
        assert 40e-6 <= job.camera.panel.pitch_y <= 110e-6


def test_reading_saturates_is_lifted_and_rounded() -> None:
    conditions = Conditions(
        electrons=100.0, full_well=50.0, black_level=0.12, adc_bits=2, adc_range=0.6
    )
    job = replace(draw(0), conditions=conditions)
    np.testing.assert_allclose(read(job, np.array([0.0, 0.15, 0.9])), [0.2, 0.2, 0.6])


def _ordinary() -> Job:
    panel = Panel(4, 4, 25e-6, 25e-6, 20e-6, 20e-6, filter_cycle=())
    camera = Camera(panel, Window(4, 4, 0, 0), Sensor(30, 30, 5e-6), distance=2e-3)
    fills = (5, 4), (5, 4)
    return Job(camera, Scene(2, 2, 0.02, 0.4), Embedding(4, 4), Conditions(), 1e-2, fills)


def test_lying_planner_is_caught() -> None:

    def boast(
        camera: Camera, scene: Scene, embedding: Embedding, tolerance: float, conditions: Conditions
    ) -> Plan:
        cheap = plan(camera, scene, embedding, 0.9, conditions)
        return replace(cheap, tolerance=tolerance, error=tolerance / 2, reached=True)

    lie, truth = judge_job(_ordinary(), planner=boast), judge_job(_ordinary())
    assert not lie.unjudged
    assert not lie.honest
    assert lie.reached_ratio > 3
    assert not truth.unjudged
    assert truth.honest
    figures = figures_of([lie, truth])
    assert figures["oracle_honest_fraction"] == 0.5
    assert figures["oracle_worst_reached_ratio"] > 3


def test_timid_planner_is_caught() -> None:
    """Who promises nothing is honest, and not sharp; what it could have reached is counted."""

    def doubt(
        camera: Camera, scene: Scene, embedding: Embedding, tolerance: float, conditions: Conditions
    ) -> Plan:
        chosen = plan(camera, scene, embedding, tolerance, conditions)
        return replace(chosen, error=1.0, reached=False)

    found = judge_job(_ordinary(), planner=doubt)
    assert found.honest
    assert found.reachable
    figures = figures_of([found])
    assert figures["oracle_sharpness_median"] > 3
    assert figures["oracle_reached_fraction"] == 0


def test_oracle_doubts_masks_that_it_did_not_look_at_closely() -> None:
    """The second mask's light changes three times as much as the first's, and is as bright."""
    larger = np.ones((2, 1, 4))
    smaller = larger + np.array([0.01, 0.03])[:, None, None]
    found = judging._elsewhere([larger, smaller], [0])
    assert found == pytest.approx(math.sqrt((1 + 3**2) / 2), rel=0.05)
    assert judging._elsewhere([larger, larger], [0]) == 1


def test_jobs_without_a_judgement_are_counted_apart() -> None:
    refused = judge_job(replace(_ordinary(), tolerance=2.0))
    late = judge_job(_ordinary(), limit=1e-3)
    unsure = Result(2, 1e-2, (), predicted=1e-3, true=1e-3, oracle_error=1e-3)
    sure = Result(3, 1e-2, (), predicted=1e-3, true=1e-3)
    assert "tolerance" in refused.refused
    assert late.late
    results = [refused, late, unsure, sure]
    assert figures_of(results)["oracle_unjudged_fraction"] == 0.75
    assert sum(reasons(results).values()) == 3
    assert len(reasons(results)) == 3


def test_run_goes_on_where_it_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    judged: list[int] = []

    def quick(seed: int) -> Result:
        judged.append(seed)
        return Result(seed, 1e-2, ("gamma",), predicted=1e-3, true=1e-3, method="transfer")

    monkeypatch.setattr(run, "judge", quick)
    out, chart = tmp_path / "jobs.jsonl", tmp_path / "chart.png"
    main(jobs=3, first=5, out=out)
    text = out.read_text()
    out.write_text(text[: text.rindex("{") + 20])
    main(jobs=4, first=5, out=out, chart=chart)
    assert judged == [5, 6, 7, 7, 8]
    assert sorted(kept(out)) == [5, 6, 7, 8]
    assert chart.stat().st_size > 0
    draw_chart([], chart)


@pytest.mark.slow
@pytest.mark.long
def test_plans_are_honest(*, long_form: bool) -> None:
    """Of the command's thousand the first eight, or the first forty."""
    results = [judge(seed) for seed in range(40 if long_form else 8)]
    found = figures_of(results)
    assert found["oracle_honest_fraction"] >= 0.95
    assert found["oracle_worst_reached_ratio"] <= 3
    assert found["oracle_unjudged_fraction"] <= 0.1
