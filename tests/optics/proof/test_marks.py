"""Marks are those of masks, wherever these are, and of openings as wave optics has them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.special import fresnel
from tests.optics.proof.rig import CAMERA, mask

from veilcam_optics.camera.geometry import Embedding
from veilcam_optics.camera.imperfections import NOMINAL, Imperfections
from veilcam_optics.proof.marks import Mark, Marks, _slit, even_light

BINS = Embedding(24, 32)
MARKS = Marks(CAMERA, NOMINAL, BINS)


def _alike(first: Mark, second: Mark) -> float:
    return float(np.corrcoef(first.texture.ravel(), second.texture.ravel())[0, 1])


def test_a_slit_has_the_transform_of_its_fresnel_pattern() -> None:
    # Born and Wolf, section 8.7: intensity behind a slit, by Fresnel integrals.
    width, wavelength, distance = 60e-6, 550e-9, 4e-3
    at = np.arange(-3e-3, 3e-3, 0.5e-6)
    scale = (2 / (wavelength * distance)) ** 0.5
    upper, lower = (np.stack(fresnel(scale * (at + side * width / 2))) for side in (1, -1))
    pattern = ((upper - lower) ** 2).sum(0) / 2
    frequencies = np.array([0.0, 2e3, 5e3, 8e3, 15e3, 25e3, 30e3])
    expected = (pattern * np.cos(2 * np.pi * frequencies[:, None] * at)).sum(1) * 0.5e-6
    found = _slit(width, wavelength, distance).transform(frequencies)
    # 0.1 % of the light falls beyond 3 mm.
    np.testing.assert_allclose(found, expected, atol=2e-3 * width)
    assert found[-1] == 0


def test_a_mark_has_no_level_and_the_shape_of_its_frequencies() -> None:
    mark = MARKS.mark(MARKS.shown(mask(1)))
    assert mark.texture.shape == (48, 33)
    assert mark.texture.dtype == np.float32
    assert abs(float(mark.texture.mean())) < 0.02
    assert np.min(mark.texture) > -1
    # Power of a random mask is as far above its level as an exponential's: 1, less what bins fold.
    assert 0.5 < float(mark.texture.std()) < 1.2


def test_weights_tell_a_mask_better_than_its_mark_does() -> None:
    every = [MARKS.mark(MARKS.shown(mask(seed))) for seed in range(40)]
    marks = np.stack([mark.texture.ravel() for mark in every])
    weights = np.stack([mark.weighed().texture.ravel() for mark in every])
    assert np.max(weights) < 2
    # Power that bears half of the first mark, and chance (exponential): by how many standard
    # deviations of the other masks is the first one ahead?
    chance = np.random.default_rng(0).exponential(1 + 0.5 * marks[0], (50, marks.shape[1]))
    ahead = []
    for weighing in (marks, weights):
        scores = chance @ weighing.T / np.sqrt(chance @ np.square(weighing).T)
        others = scores[:, 1:]
        ahead.append(((scores[:, 0] - others.mean(1)) / others.std(1, ddof=1)).mean())
    assert ahead[1] > 1.1 * ahead[0] > 5


def test_masks_have_marks_of_their_own() -> None:
    marks = [MARKS.mark(MARKS.shown(mask(seed))) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(marks[0].texture, marks[1].texture)
    assert abs(_alike(marks[0], marks[2])) < 0.15


def test_an_inverted_mask_is_much_like_its_mask() -> None:
    levels = mask(1)
    inverted = 1 - MARKS.shown((63 - levels).astype(np.uint8))
    assert _alike(MARKS.mark(MARKS.shown(levels)), MARKS.mark(inverted)) > 0.6


def test_a_mask_that_is_moved_keeps_its_mark() -> None:
    levels = np.zeros(CAMERA.mask_shape, np.uint8)
    levels[6:40, 3:18] = mask(1)[6:40, 3:18]
    # Whole cycles of the filters, so that every row keeps its colour.
    moved = np.roll(levels, (6, 2), (0, 1))
    marks = [MARKS.mark(MARKS.shown(each)) for each in (levels, moved)]
    np.testing.assert_allclose(marks[0].texture, marks[1].texture, atol=1e-4)


def test_phases_are_those_of_the_shadow_at_the_lowest_frequencies() -> None:
    levels = np.zeros(CAMERA.mask_shape, np.uint8)
    levels[25, 11] = 63
    mark = MARKS.mark(MARKS.shown(levels))
    assert mark.phases.shape == (24, 13)
    np.testing.assert_allclose(np.abs(mark.phases), 1, rtol=1e-5)
    # Of a single sub-pixel, half a column beside the axis: its shadow is larger by 4 mm in 0.6 m.
    turns = np.fft.rfftfreq(64)[:13] / (CAMERA.sensor.width / 32) * CAMERA.panel.pitch_x / 2
    expected = np.exp(2j * np.pi * turns * (1 + CAMERA.distance / 0.6))
    np.testing.assert_allclose(mark.phases[0], expected, atol=1e-4)
    np.testing.assert_allclose(mark.phases[-3], expected, atol=1e-4)


def test_a_mask_that_is_moved_turns_its_phases_alone() -> None:
    levels = np.zeros(CAMERA.mask_shape, np.uint8)
    levels[6:40, 3:18] = mask(1)[6:40, 3:18]
    marks = [MARKS.mark(MARKS.shown(np.roll(levels, columns, 1))) for columns in (0, 2)]
    turned = marks[1].phases / marks[0].phases
    np.testing.assert_allclose(turned, np.broadcast_to(turned[0], turned.shape), atol=1e-2)


def test_an_erased_mark_is_empty() -> None:
    mark = MARKS.mark(MARKS.shown(mask(1)))
    mark.erase()
    assert not mark.texture.any()
    assert not mark.phases.any()
    assert "array" not in repr(mark)


def test_the_size_of_shadows_follows_the_distance() -> None:
    further = Marks(CAMERA, Imperfections(distance_error=1e-3), BINS).mark(MARKS.shown(mask(1)))
    near = Marks(CAMERA, Imperfections(distance_error=1e-5), BINS).mark(MARKS.shown(mask(1)))
    here = MARKS.mark(MARKS.shown(mask(1)))
    assert _alike(here, near) > 0.9999 > _alike(here, further) > 0.9


def test_a_panel_is_shown_as_it_is() -> None:
    real = Imperfections(
        gamma=1.3,
        contrast_floor=0.1,
        dead_rows=(2,),
        dead_columns=(5,),
        dead_transmittance=0.7,
    )
    shown = Marks(CAMERA, real, BINS).shown(mask(1))
    assert shown[2] == pytest.approx(0.49)
    assert shown[:, 5] == pytest.approx(0.49)
    assert shown[0, 0] == pytest.approx((0.1 + 0.9 * (mask(1)[0, 0] / 63) ** 1.3) ** 2)


def test_filters_weigh_rows() -> None:
    levels = np.zeros(CAMERA.mask_shape, np.uint8)
    levels[::3] = mask(1)[::3]
    gray = replace(CAMERA, panel=replace(CAMERA.panel, filter_cycle=()))
    whole, own = (Marks(each, NOMINAL, BINS) for each in (gray, CAMERA))
    # Rows of one colour alone have the mark that they have without filters: a share is no texture.
    shown = own.shown(levels)
    assert _alike(whole.mark(shown), own.mark(shown)) > 0.9
    both = own.shown(mask(1))
    assert _alike(whole.mark(both), own.mark(both)) < 0.99


def test_even_light_falls_off_as_it_does_behind_a_window() -> None:
    light = even_light(CAMERA, BINS)
    assert light.shape == BINS.shape
    assert light.mean() == pytest.approx(1, rel=1e-5)
    np.testing.assert_allclose(light, light[::-1, ::-1], rtol=0.02)
    assert light[12, 16] > 1.2 * light[12, 0] > 1.2 * light[0, 0]
    # Once more, place by place, for one bin in the corner.
    y = (0.5 / 24 - 0.5) * CAMERA.sensor.height - np.array(CAMERA.row_centres)
    x = (0.5 / 32 - 0.5) * CAMERA.sensor.width - np.array(CAMERA.column_centres)
    slopes = np.hypot(*np.meshgrid(y, x)) / CAMERA.distance
    middle = np.hypot(*np.meshgrid(CAMERA.row_centres, CAMERA.column_centres)) / CAMERA.distance
    ratio = (np.cos(np.arctan(slopes)) ** 4).sum() / (np.cos(np.arctan(middle)) ** 4).sum()
    assert light[0, 0] / light[12, 16] == pytest.approx(ratio, rel=0.03)


def test_a_small_window_leaves_light_less_even() -> None:
    small = replace(CAMERA, window=replace(CAMERA.window, rows=9, columns=5))
    assert even_light(small, BINS)[12].std() > even_light(CAMERA, BINS)[12].std()
