"""The light of the proof's world is the light: by energy, by shadows, and by the package's own."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from benchmarks.proof.light import BINS, Field, Optics, Singles, Slits, centred

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.imperfections import Imperfections
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.tables import Reach

CAMERA, SCENE = Camera(), Scene(rows=6, columns=6)
GREEN = ((550e-9, 1.0),)
RAY = ((1e-15, 1.0),)
"""Light that does not bend."""
FIELD = Field(centred(6) * 0.05, square=0.3, distance=4e-3, depth=math.inf)


def _slits(centres: list[float], width: float, side: float = 6e-3, field: Field = FIELD) -> Slits:
    return Slits(np.array(centres), width, side, 32, field)


def _optics(real: Imperfections, scene: Scene = SCENE) -> Optics:
    square = scene.height / scene.distance
    field = Field(
        centred(scene.rows) * square / scene.rows,
        square=square,
        distance=CAMERA.distance + real.distance_error,
        depth=scene.distance,
    )
    panel, sensor = CAMERA.panel, CAMERA.sensor
    y, x = np.array(CAMERA.row_centres), np.array(CAMERA.column_centres)
    return Optics(
        rows=Slits(y + real.shift_y, panel.aperture_y, sensor.height, BINS[0], field),
        columns=Slits(x + real.shift_x, panel.aperture_x, sensor.width, BINS[1], field),
        filters=np.array([CAMERA.row_amplitudes(channel) for channel in range(3)]) ** 2,
        spectra=tuple(((wavelength, 1.0),) for wavelength in CAMERA.wavelengths),
        weights=sensor.channel_weights,
        rotation=real.rotation,
    )


def _error(real: Imperfections, scene: Scene = SCENE, turn: float = 1.0) -> float:
    """Relative L2 distance of a whole transfer matrix from the package's."""
    mask = np.random.default_rng(1).random(CAMERA.mask_shape).astype(np.float32)
    points = np.eye(36, dtype=np.float32).reshape(36, 1, 6, 6).repeat(3, axis=1)
    optics = _optics(real, scene)
    optics = replace(optics, rotation=turn * optics.rotation)
    mine = optics.measurements(points, mask[None])[0].reshape(36, -1)
    operator = TransferOperator(
        CAMERA, scene, Embedding(*BINS), reach=Reach(3, 1), imperfections=real
    )
    theirs = operator(torch.from_numpy(mask)).numpy()
    return float(np.linalg.norm(mine - theirs) / np.linalg.norm(theirs))


@pytest.mark.slow
@pytest.mark.numerical
def test_a_transfer_matrix_is_the_packages() -> None:
    # What differs: neighbours that interfere (8e-4 by Reach(3, 1) against Reach(0, 0)), waves that
    # come in at up to 0.125 and spread by (1 + 0.125^2)^1.5 = 2.3 % more along their tilt, and a
    # reach of 3 mm. A scene pixel or a filter out of place would be an error of 1.
    real = Imperfections(shift_y=60e-6, shift_x=-40e-6, distance_error=80e-6)
    assert _error(real) < 2e-3
    assert _error(real, Scene(rows=6, columns=6, height=1.5, distance=5.0)) < 2e-3


@pytest.mark.slow
@pytest.mark.numerical
def test_a_turned_mask_is_the_packages() -> None:
    # The package turns to first order: 4 mrad move the outermost lines by s = 10 um, which leaves
    # (s / 60 um)^2 / 2, 1 %, of the light of a line's edge.
    turned = Imperfections(rotation=4e-3)
    assert _error(turned) < 1e-2
    # It is the turn that agrees: without it, and the other way round, the error grows each time.
    assert 3e-2 > _error(turned, turn=0) > 1e-2
    assert _error(turned, turn=-1) > 3e-2


def test_light_falls_where_the_shadow_is() -> None:
    # A slit of 375 um whose lower edge is at 0, behind a point at infinity straight ahead: bins of
    # 187.5 um, of which the 17th and the 18th are lit as they are.
    field = replace(FIELD, slopes=np.array([0.0, 1e-6]))
    (factors,) = _slits([187.5e-6], 375e-6, field=field).factors(RAY)
    share = field.spacing / field.square
    expected = np.zeros(32)
    expected[16:18] = 1
    # Corners of a shadow are as sharp as a node: 1.5 um of 187.5 um.
    np.testing.assert_allclose(factors[0, :, 0] / share, expected, atol=0.01)


def _centre(depth: float, at: float, slope: float) -> float:
    field = replace(FIELD, slopes=np.array([slope, slope + 1e-6]), depth=depth)
    slits = Slits(np.array([at]), 60e-6, 6e-3, 2000, field)
    (factors,) = slits.factors(RAY)
    return float(np.average(centred(2000) * 6e-3 / 2000, weights=factors[0, :, 0]))


def test_shadows_move_against_the_scene_and_grow_as_it_comes_near() -> None:
    # Bins of 3 um, nodes of 1.5 um.
    assert _centre(math.inf, 1e-3, 0.0) == pytest.approx(1e-3, abs=2e-6)
    assert _centre(math.inf, 0.0, 0.1) == pytest.approx(-0.1 * 4e-3, abs=2e-6)
    assert _centre(0.3, 1e-3, 0.0) == pytest.approx(1e-3 * (1 + 4e-3 / 0.3), abs=2e-6)


def test_as_much_light_arrives_as_is_let_through() -> None:
    (factors,) = _slits([0.0, 50e-6], 60e-6, side=8e-3).factors(GREEN)
    through = factors.sum(1) * (8e-3 / 32) / (FIELD.spacing / FIELD.square)
    # What falls beyond the reach of 3 mm is lambda d / (pi^2 w 3 mm) = 0.12 % of a slit's light.
    np.testing.assert_allclose(through, 60e-6, rtol=2e-3)


def test_without_a_mask_a_white_square_is_one() -> None:
    pitch = 100e-6
    slits = _slits(list(centred(120) * pitch), pitch)
    (factors,) = slits.factors(GREEN)
    # Slits that touch, each for itself, are a panel that is open: over a bin fringes average out.
    np.testing.assert_allclose(factors.sum((0, 2)), 1, rtol=5e-3)


def test_a_slit_that_moves_is_a_slit_elsewhere() -> None:
    moved, still = _slits([0.0], 60e-6).factors(GREEN, (30e-6, 0.0))
    (elsewhere,) = _slits([30e-6], 60e-6).factors(GREEN)
    np.testing.assert_allclose(moved, elsewhere, atol=1e-6)
    assert np.abs(moved - still).max() > 1e-3


def _white(channel: int | None = None) -> Singles:
    scene = np.zeros((1, 3, 6, 6), np.float32)
    scene[:, slice(None) if channel is None else channel] = 1
    return scene


def test_black_is_black_and_light_adds_up() -> None:
    optics = _optics(Imperfections())
    mask = np.random.default_rng(2).random((2, *CAMERA.mask_shape)).astype(np.float32)
    assert not optics.measurements(0 * _white(), mask).any()
    assert not optics.measurements(_white(), 0 * mask).any()
    parts = [optics.measurements(_white(channel), mask) for channel in range(3)]
    np.testing.assert_allclose(optics.measurements(_white(), mask), sum(parts), rtol=1e-5)


def test_a_row_passes_the_colour_of_its_filter_alone() -> None:
    optics = _optics(Imperfections())
    one = np.zeros((1, *CAMERA.mask_shape), np.float32)
    one[0, 4] = 1
    colour = (CAMERA.window.first_row + 4) % 3
    lit = [optics.measurements(_white(channel), one).any() for channel in range(3)]
    assert lit == [channel == colour for channel in range(3)]


def test_behind_an_open_panel_all_places_see_the_same() -> None:
    optics = _optics(Imperfections(), Scene(rows=6, columns=6, height=0.02, distance=0.4))
    rows, columns = (
        replace(slits, centres=centred(400 if slits is optics.rows else 100) * pitch)
        for slits, pitch in (
            (optics.rows, CAMERA.panel.pitch_y),
            (optics.columns, CAMERA.panel.pitch_x),
        )
    )
    filters = np.array([np.arange(400) % 3 == channel for channel in range(3)], float)
    whole = replace(optics, rows=rows, columns=columns, filters=filters)
    scenes = np.random.default_rng(1).random((2, 3, 6, 6)).astype(np.float32)
    behind = whole.measurements(scenes, np.ones((1, 400, 100), np.float32))[0]
    # Bins of 98 um hold one opening and a half: light is the same but for their number.
    np.testing.assert_allclose(behind.mean((1, 2)), optics.uncovered(scenes), rtol=1e-2)
