"""Imperfections: drawn as their spreads say, and shown."""

from __future__ import annotations

from dataclasses import asdict

import pytest
import torch

from veilcam_optics.camera.geometry import Camera, Window
from veilcam_optics.camera.imperfections import NOMINAL, Imperfections, Spreads
from veilcam_optics.errors import OpticsError

COUNT = 4000


def draws(spreads: Spreads) -> list[Imperfections]:
    generator = torch.Generator().manual_seed(3)
    return [Imperfections.sample(spreads, generator) for _ in range(COUNT)]


@pytest.mark.parametrize(
    ("spreads", "names"),
    [
        (Spreads(shift=2e-5), {"shift_y", "shift_x"}),
        (Spreads(distance=3e-5), {"distance_error"}),
        (Spreads(gamma=0.2), {"gamma"}),
        (Spreads(contrast_floor=0.1), {"contrast_floor"}),
        (Spreads(), set()),
    ],
)
def test_imperfections_without_spread_stay_nominal(spreads: Spreads, names: set[str]) -> None:
    one = Imperfections.sample(spreads)
    changed = {name for name, value in asdict(one).items() if value}
    assert changed - {"gamma"} == names - {"gamma"}
    assert (one.gamma != 1) == ("gamma" in names)


def test_ends_of_uniform_spreads() -> None:
    found = draws(Spreads(shift=2e-5, distance=3e-5, gamma=0.2, contrast_floor=0.1))
    for name, low, high in (
        ("shift_y", -2e-5, 2e-5),
        ("shift_x", -2e-5, 2e-5),
        ("distance_error", -3e-5, 3e-5),
        ("gamma", 0.8, 1.2),
        ("contrast_floor", 0.0, 0.1),
    ):
        values = [getattr(each, name) for each in found]
        # All within the ends, and of 4000 one within 1 % of each but for a chance of 1e-8.
        margin = 0.01 * (high - low)
        assert low <= min(values) < low + margin
        assert high - margin < max(values) <= high


def test_normal_spreads_are_standard_deviations() -> None:
    found = draws(Spreads(shift=2e-6, distance=5e-6, normal=True))
    for name, deviation in (("shift_y", 2e-6), ("shift_x", 2e-6), ("distance_error", 5e-6)):
        values = torch.tensor([getattr(each, name) for each in found], dtype=torch.float64)
        # The standard error of a standard deviation from 4000 values is 1.1 %; of the mean, 1.6 %.
        assert float(values.std()) == pytest.approx(deviation, rel=0.06)
        assert abs(float(values.mean())) < 0.08 * deviation
        assert float(values.abs().max()) > 2.5 * deviation


def test_seed_gives_the_same_camera_again() -> None:
    spreads = Spreads(shift=1e-5, gamma=0.1)
    assert draws(spreads)[:3] == draws(spreads)[:3]


def test_dark_stays_dark_under_a_gamma() -> None:
    shown = Imperfections(gamma=0.5).shown(torch.tensor([[0.0, 0.25, 1.0]]))
    assert shown.tolist() == [[0.0, 0.5, 1.0]]


def test_dead_lines_of_several_masks() -> None:
    stuck = Imperfections(gamma=2.0, dead_rows=(1,), dead_columns=(2,), dead_transmittance=0.75)
    weights = torch.full((2, 3, 3), 0.5)
    shown = stuck.shown(weights)
    assert (
        shown[0].tolist()
        == shown[1].tolist()
        == [[0.25, 0.25, 0.75], [0.75] * 3, [0.25, 0.25, 0.75]]
    )
    for wrong in (Imperfections(dead_rows=(3,)), Imperfections(dead_columns=(3,))):
        with pytest.raises(OpticsError, match=r"dead_(rows|columns) = 3"):
            wrong.shown(weights)
    assert float(weights.min()) == 0.5  # the argument is left as it was


@pytest.mark.parametrize(
    ("imperfections", "message"),
    [
        (Imperfections(distance_error=-4e-3), "more than minus the camera's distance"),
        (Imperfections(dead_rows=(9,)), "dead_rows = 9 is not valid: use 0 to 8"),
        (Imperfections(dead_columns=(-1,)), "dead_columns = -1 is not valid: use 0 to 4"),
    ],
)
def test_impossible_spreads_are_named(imperfections: Imperfections, message: str) -> None:
    camera = Camera(window=Window(rows=9, columns=5), distance=4e-3)
    NOMINAL.check(camera)
    with pytest.raises(OpticsError, match=message):
        imperfections.check(camera)
