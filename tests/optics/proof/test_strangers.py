"""Scores tell a mask that is there from masks that are not, in pictures as in spectra."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats
from tests.optics.proof.rig import CAMERA, UNCLIPPED, Room, figure, mask, measured, natural, opened

from veilcam_optics.camera.imperfections import NOMINAL
from veilcam_optics.proof import PROOF
from veilcam_optics.proof.marks import Mark, Marks
from veilcam_optics.proof.strangers import (
    PICTURED,
    STRANGERS,
    Scores,
    Strangers,
    as_normal,
    combined,
)
from veilcam_optics.proof.traces import Trace, Traces

MARKS = Marks(CAMERA, NOMINAL, PROOF)
TRACES = Traces(PROOF)
WINDOW = MARKS.mark(np.ones(CAMERA.mask_shape))
OPEN = np.full(CAMERA.mask_shape, 63, np.uint8)


def _mark(seed: int) -> Mark:
    return MARKS.mark(MARKS.shown(mask(seed)))


@pytest.fixture(scope="module")
def strangers() -> Strangers:
    return Strangers([_mark(1000 + seed) for seed in range(STRANGERS)])


def _trace(room: Room, seed: int = 1, snr_db: float = 80) -> Trace:
    capture = measured(room.behind(opened(mask(seed))), 0, snr_db)
    return TRACES.take(capture[None], UNCLIPPED[None])


def _scores(strangers: Strangers, trace: Trace, *marks: Mark) -> Scores:
    return strangers.scores(trace, [mark.weighed() for mark in marks], WINDOW)


@pytest.mark.parametrize("room", [natural(1), figure(3), figure(4)])
def test_the_mask_that_is_there_scores_and_others_are_behind(
    strangers: Strangers, room: Room
) -> None:
    scores = _scores(strangers, _trace(room), _mark(1), _mark(2), _mark(3))
    assert scores.score[0, 0] > 8
    assert np.abs(scores.score[1:]).max() < 5
    assert scores.ahead[0, 0] == 0
    assert np.min(scores.ahead[1:]) > 3
    assert 0 < scores.share[0] < 1
    assert scores.window[0] < 3


def test_a_picture_adds_what_a_spectrum_does_not_tell(strangers: Strangers) -> None:
    right, wrong = _mark(1), _mark(2)
    half = Mark(wrong.texture, right.phases)
    neither, picture = _scores(strangers, _trace(figure(3)), wrong, half).score[:, 0]
    assert picture > neither + 3


def test_masks_that_are_not_there_score_as_strangers_do(strangers: Strangers) -> None:
    others = [_mark(2000 + seed) for seed in range(40)]
    trace = _trace(natural(1))
    scores = np.concatenate([_scores(strangers, trace, each).score for each in others])
    assert abs(float(scores.mean())) < 0.6
    assert 0.5 < float(scores.std(ddof=1)) < 1.6


def test_a_mask_is_neither_ahead_of_nor_behind_itself(strangers: Strangers) -> None:
    scores = _scores(strangers, _trace(natural(1)), _mark(1), _mark(1))
    assert scores.score[0] == pytest.approx(scores.score[1])
    assert abs(float(scores.ahead[1, 0])) < 1e-3


def test_a_mask_that_is_there_is_ahead_of_its_inversion_by_no_more_than_a_camera_allows(
    strangers: Strangers,
) -> None:
    inverted = MARKS.mark(1 - MARKS.shown((63 - mask(1)).astype(np.uint8)))
    scores = _scores(strangers, _trace(figure(3)), _mark(1), inverted)
    assert scores.score[0, 0] > scores.score[1, 0] > 5
    # A tenth of a score may be wrong: ten times the share that is missing, over the root of 2.
    pictures = scores.ahead[1, 0]
    assert 3 < pictures < 30


@pytest.mark.parametrize("room", [figure(4), figure(5)])
def test_an_open_window_scores_where_it_is_open(strangers: Strangers, room: Room) -> None:
    capture = measured(room.behind(opened(OPEN)), 0)
    trace = TRACES.take(capture[None], UNCLIPPED[None])
    there = _scores(strangers, trace, _mark(1))
    assert there.window[0] > 5
    # Scenes as sparse as these score behind any mask: the distance is not in how rare that is.
    assert there.ahead_of_window[0] < -2 * (there.window[0] - there.score[0, 0])
    mask_there = _scores(strangers, _trace(room), _mark(1))
    assert mask_there.window[0] < 3
    assert mask_there.ahead_of_window[0] > 3


def test_dark_on_light_leaves_an_open_window_its_texture(strangers: Strangers) -> None:
    # Whose picture is skewed to the other side: the texture alone is what counts then.
    window = opened(OPEN)
    capture = measured(figure(3).behind(window), 0)
    trace = TRACES.take(capture[None], UNCLIPPED[None])
    assert _scores(strangers, trace, _mark(1)).window[0] > 3


def test_captures_are_scored_as_each_is(strangers: Strangers) -> None:
    captures = np.stack(
        [measured(room.behind(opened(mask(1))), 0) for room in (natural(1), figure(3))]
    )
    together = TRACES.take(captures, np.stack([UNCLIPPED] * 2))
    both = _scores(strangers, together, _mark(1), _mark(2))
    assert both.score.shape == both.ahead.shape == (2, 2)
    assert both.share.shape == both.window.shape == (2,)
    for place, room in enumerate((natural(1), figure(3))):
        alone = _scores(strangers, _trace(room), _mark(1), _mark(2))
        np.testing.assert_allclose(both.score[:, place], alone.score[:, 0], rtol=1e-2, atol=1e-2)


def test_nothing_at_all_is_no_error(strangers: Strangers) -> None:
    trace = TRACES.take(np.zeros((1, *PROOF.shape), np.float32), UNCLIPPED[None])
    scores = _scores(strangers, trace, _mark(1), _mark(2))
    for values in (
        scores.score,
        scores.ahead,
        scores.share,
        scores.window,
        scores.ahead_of_window,
    ):
        assert np.isfinite(values).all()


@pytest.mark.parametrize("strangers", [PICTURED, STRANGERS])
def test_scores_are_as_rare_as_those_of_normal_numbers(strangers: int) -> None:
    normal = np.linspace(-6, 6, 49)
    # What one more of so many scores, in their standard deviations.
    rare = stats.t.ppf(stats.norm.cdf(-np.abs(normal)), strangers - 1) * -np.sign(normal)
    scores = (rare * (1 + 1 / strangers) ** 0.5).astype(np.float32)
    # Of Wallace's approximation, 0.033 at 6 for the fewest.
    np.testing.assert_allclose(as_normal(scores, strangers), normal, atol=0.04)


def test_both_scores_are_never_worse_than_the_spectrum_and_hardly_than_the_picture(
    strangers: Strangers,
) -> None:
    rooms = [natural(seed, 0.8 + 0.05 * seed) for seed in range(12)] + [figure(3), figure(4)]
    right: list[tuple[float, float]] = []
    together: list[float] = []
    mark = _mark(1).weighed()
    for room in rooms:
        # From what tells next to nothing to what tells most masks.
        for snr_db in (45.0, 50.0, 55.0, 60.0, 65.0):
            trace = _trace(room, snr_db=snr_db)
            spectrum = strangers._spectra(trace, [mark])[0]
            picture = strangers._pictures(trace, [mark], WINDOW)[0][1, :1]
            both = as_normal(spectrum, STRANGERS), as_normal(picture, PICTURED)
            right.append((float(both[0][0, 0]), float(both[1][0, 0])))
            together.append(float(combined(*both)[0, 0]))
    for level in (2.5, 3.5, 4.5):
        found = (np.array(together) >= level).mean()
        by_spectrum, by_picture = (np.array(right) >= level).mean(0)
        assert found >= by_spectrum
        # Where the picture alone is at its level, and the spectrum at none: 3 captures of 70.
        assert found >= by_picture - 0.05
    assert 0.2 < (np.array(together) >= 3.5).mean() < 0.95
