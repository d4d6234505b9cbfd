"""Area binning of raw frames: exact, whatever the sizes."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
import torch

from veilcam_optics.propagation.sampling import area_average
from veilcam_server.devices.raw import Binning

RNG = np.random.default_rng(2)


@pytest.mark.parametrize(
    ("raw", "embedding"),
    [
        ((4, 6), (2, 3)),
        ((5, 7), (2, 3)),
        ((7, 5), (7, 5)),
        ((9, 11), (1, 1)),
        ((152, 203), (24, 32)),
        ((152, 203), (13, 17)),
    ],
)
def test_embedding_is_the_area_average(raw: tuple[int, int], embedding: tuple[int, int]) -> None:
    frame = RNG.integers(0, 65536, raw, np.uint16)
    expected = area_average(torch.from_numpy(frame.astype(float)), *embedding).numpy()
    np.testing.assert_allclose(Binning(raw, embedding).means(frame), expected, rtol=1e-12)


@pytest.mark.parametrize("order", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_channel_is_the_mean_of_its_own_pixels(order: str) -> None:
    frame = RNG.integers(0, 65536, (12, 16), np.uint16)
    colours = np.tile(np.array(list(order)).reshape(2, 2), (6, 8))
    means = Binning(frame.shape, (3, 3, 4)).means(frame, order)
    for row, column in ((0, 0), (1, 3), (2, 1)):
        box = slice(4 * row, 4 * row + 4), slice(4 * column, 4 * column + 4)
        expected = [frame[box][colours[box] == colour].mean() for colour in "RGB"]
        assert means[:, row, column] == pytest.approx(expected)


def test_pixel_on_an_edge_counts_to_both_boxes_by_its_area() -> None:
    frame = np.array([[1, 2, 10, 4, 5]], np.uint16)
    expected = [Fraction(1 + 2 + 5) / Fraction(5, 2), Fraction(5 + 4 + 5) / Fraction(5, 2)]
    assert Binning((1, 5), (1, 2)).means(frame)[0] == pytest.approx(
        [float(value) for value in expected]
    )


@pytest.mark.parametrize("raw", [(40, 60), (41, 61), (13, 19)])
@pytest.mark.parametrize("fill", [0.5, 0.4, 0.351])
def test_small_box_holds_its_colours_in_equal_shares(raw: tuple[int, int], fill: float) -> None:
    """However a box cuts the Bayer pattern, red and blue count a quarter each."""
    for channel, share in enumerate((0.25, 0.5, 0.25)):
        frame = np.zeros(raw, np.uint16)
        for row, column in (((0, 0),), ((0, 1), (1, 0)), ((1, 1),))[channel]:
            frame[row::2, column::2] = 1000
        np.testing.assert_allclose(Binning(raw, (2, 3), fill).means(frame), 1000 * share)
        apart = np.zeros((3, 2, 3))
        apart[channel] = 1000
        np.testing.assert_allclose(Binning(raw, (3, 2, 3), fill).means(frame), apart)


def test_brightest_frame_of_the_real_sensor_does_not_overflow() -> None:
    frame = np.full((1520, 2028), 65535, np.uint16)
    for boxes, fill in (((1, 1), 1.0), ((3, 4), 1.0), ((24, 32), 1.0), ((24, 32), 0.1)):
        means = Binning(frame.shape, boxes, fill).means(frame)
        np.testing.assert_allclose(means, 65535, rtol=1e-12)


def test_frames_with_padded_lines_are_read_as_they_lie() -> None:
    padded = RNG.integers(0, 4096, (6, 16), np.uint16)
    binning = Binning((6, 10), (2, 3))
    means, others = binning.means(padded[:, :10]), binning.means(padded[:, :10].copy())
    assert np.array_equal(means, others)


def test_frame_that_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueError, match="use 1 to 4"):
        Binning((4, 9), (5, 3))
    with pytest.raises(ValueError, match="use 1 to 9"):
        Binning((4, 9), (4, 0))
    with pytest.raises(ValueError, match=r"use \(4, 9\)"):
        Binning((4, 9), (2, 3)).means(np.zeros((9, 4), np.uint16))
    with pytest.raises(ValueError, match="use 1 to 9"):
        Binning((4, 9), (2, 10))
    with pytest.raises(ValueError, match="use 1 to 2"):
        Binning((4, 9), (3, 3, 4))
    with pytest.raises(ValueError, match=r"use 1 to 2, .* pixel of each colour each of 20"):
        Binning((20, 200), (3, 3), 0.2)
