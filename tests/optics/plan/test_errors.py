"""Errors of a model: how closely each is looked at, and which reaches."""

from __future__ import annotations

import pytest

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.camera.imperfections import PARAXIAL
from veilcam_optics.effects import Model
from veilcam_optics.effects.mask import DeadSpace
from veilcam_optics.plan.errors import ErrorModel


def model(cycle: tuple[int, ...] = ()) -> Model:
    """A mask whose apertures are three quarters of a pitch wide."""
    panel = Panel(
        rows=8,
        columns=4,
        pitch_y=40e-6,
        pitch_x=40e-6,
        aperture_y=30e-6,
        aperture_x=30e-6,
        filter_cycle=cycle,
    )
    camera = Camera(
        panel=panel,
        window=Window(8, 4, 0, 0),
        sensor=Sensor(24, 24, 10e-6),
        distance=1e-3,
    )
    return Model(camera, Scene(4, 4, 0.02, 0.1), Embedding(4, 4), PARAXIAL)


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


def test_what_is_far_over_the_tolerance_is_looked_at_in_few_places(
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
