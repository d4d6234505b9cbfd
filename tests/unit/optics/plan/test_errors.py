"""Errors of a model: how closely each is looked at, and which reaches."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from tests.unit.optics.tensors import bare

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.camera.imperfections import Conditions, Imperfections
from veilcam_optics.effects import Model
from veilcam_optics.effects.mask import DeadSpace
from veilcam_optics.plan import plan
from veilcam_optics.plan.bounds import QUADRATURE, fringe_step
from veilcam_optics.plan.errors import ROUNDING, ErrorModel
from veilcam_optics.plan.probe import relative
from veilcam_optics.simulation.operator import LightOperator
from veilcam_optics.transfer.tables import Reach


def model(cycle: tuple[int, ...] = ()) -> Model:
    """A mask whose apertures are three quarters of a pitch wide."""
    panel = replace(bare(40e-6, 30e-6), rows=8, columns=4, filter_cycle=cycle)
    camera = Camera(
        panel=panel, window=Window(8, 4, 0, 0), sensor=Sensor(24, 24, 10e-6), distance=1e-3
    )
    return Model(camera, Scene(4, 4, 0.02, 0.1), Embedding(4, 4))


def probes_used(tolerance: float, monkeypatch: pytest.MonkeyPatch) -> tuple[float, set[int]]:
    """The error of ignoring dead space, and how many offsets along y were looked at."""
    errors = ErrorModel(model(), tolerance)
    used = set()
    for probe in (errors._fewer, errors._probe):
        transfer = probe.transfer

        def counted(*args: object, transfer=transfer, probe=probe, **kwargs: object):  # type: ignore[no-untyped-def]
            used.add(len(probe.kept_y))
            return transfer(*args, **kwargs)

        monkeypatch.setattr(probe, "transfer", counted)
    return DeadSpace().error(errors), used


def test_errors_far_over_the_tolerance_are_looked_at_in_few_places(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Some 0.4 of the light comes through space that is dead."""
    rough, few = probes_used(0.01, monkeypatch)
    close, all_of_them = probes_used(0.3, monkeypatch)
    assert len(few) == 1
    assert len(all_of_them) == 2
    assert min(all_of_them) == min(few)
    assert rough == pytest.approx(close, rel=0.2)
    assert rough != close


@pytest.mark.parametrize(
    ("cycle", "rows"), [((), {0, 1, 2, 3, 4, 5, 6, 7}), ((0, 1, 2), {0, 3, 6})]
)
def test_reaches_are_those_at_which_rows_meet(cycle: tuple[int, ...], rows: set[int]) -> None:
    found = {reach.rows for reach in ErrorModel(model(cycle), 1e-4).full.errors}
    assert 0 in found
    assert len(found) > 1
    # The farthest reach is what is affordable, whatever meets there.
    assert found - {max(found)} <= rows


def one_aperture(distance: float, pixel: float, shift: float = 0.0) -> Model:
    """An aperture of 0.6 mm, one scene pixel and one embedding pixel of so many metres."""
    panel = replace(bare(1e-3, 6e-4), rows=1, columns=1)
    camera = Camera(panel, Window(1, 1, 0, 0), Sensor(8, 8, pixel / 8), distance)
    moved = Imperfections(shift_y=shift)
    scene = Scene(1, 1, distance, 1e3 * distance)
    return Model(camera, scene, Embedding(1, 1), Conditions(imperfections=moved))


def test_light_that_is_alike_everywhere_is_rounded_by_what_is_said() -> None:
    """All of 10 x 11 sub-pixels interfere, far away: no two entries' rounding averages out.

    Sums are taken in another order by another processor: 1.8e-6 here, where 3e-6 is twice what is
    said, and 1e-7 is what one number alone is rounded by.
    """
    panel = Panel(
        rows=10, columns=11, pitch_y=1.13e-6, pitch_x=3.39e-6, aperture_y=0.68e-6,
        aperture_x=2.71e-6, filter_cycle=(),
    )  # fmt: skip
    camera = Camera(
        panel, Window(10, 11, 0, 0), Sensor(26, 16, 0.93e-6), 0.277, wavelengths=(12e-6,) * 3
    )
    conditions = Conditions(imperfections=Imperfections(rotation=8.5e-4))
    given = Model(camera, Scene(3, 5, 27e-6, 9.4), Embedding(1, 3), conditions)
    given = given.with_sampling(reach=Reach(9, 10), step=0.653e-6)
    weights = torch.rand(8, 10, 11, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    rounded, exact = (
        torch.stack([operator(mask).double() for mask in weights])
        for operator in map(
            LightOperator,
            (given.with_sampling(dtype=dtype) for dtype in (torch.float32, torch.float64)),
        )
    )
    found = relative(rounded, exact)
    assert 1e-7 < found < 2 * ROUNDING[torch.float32]


@pytest.mark.parametrize("pixel", [0.52e-3, 2e-3])
def test_nodes_of_a_plan_integrate_as_well_as_is_said(pixel: float) -> None:
    """A pixel that light overflows, and one that holds all of it."""
    given = one_aperture(55e-3, pixel).with_sampling(reach=Reach(0, 0), dtype=torch.float64)
    step = fringe_step(given, Reach(0, 0))
    weights = torch.ones(1, 1, dtype=torch.float64)
    coarse, planned, fine = (
        LightOperator(given.with_sampling(step=one))(weights) for one in (4 * step, step, step / 8)
    )
    assert relative(planned, fine) < QUADRATURE
    assert relative(coarse, fine) > 30 * relative(planned, fine), "the fourth power of the step"


def test_shadows_beside_the_sensor_are_no_plan_that_reaches() -> None:
    """A mask that is moved by more than the sensor sees leaves it dark: no more is known."""
    seen, moved = one_aperture(10e-6, 0.4e-3), one_aperture(10e-6, 0.4e-3, shift=0.8e-3)
    partly = one_aperture(10e-6, 0.4e-3, shift=0.45e-3)
    errors = [ErrorModel(one, 0.05)._shadow_error for one in (seen, partly, moved)]
    assert errors[0] < 0.01
    assert 1.5 * errors[0] < errors[1] < 0.5  # of 0.4 mm 0.05 are lit
    assert errors[2] == 1
    for given, reached in ((seen, True), (moved, False)):
        chosen = plan(given.camera, given.scene, given.embedding, 0.05, given.conditions)
        assert chosen.reached == reached


def test_middle_of_a_scene_pixel_is_brighter_than_its_corners() -> None:
    """One scene pixel about the axis, of whose image the sensor sees the inner third.

    Over all of it light fades by 4/3 of the square of half its side's tangent on average, over that
    third of each side by a ninth of this: 1.2 times the square are too much.
    """
    given = one_aperture(20e-3, 0.4e-3)
    panel = replace(given.camera.panel, aperture_y=0.1e-3, aperture_x=0.1e-3)
    camera = replace(given.camera, panel=panel)
    scene = Scene(1, 1, height=0.24 * 2.0, distance=2.0)
    found = ErrorModel(Model(camera, scene, Embedding(1, 1)), 1e-3)._uneven
    assert 0.5 * 0.12**2 < found < 2 * 0.12**2
