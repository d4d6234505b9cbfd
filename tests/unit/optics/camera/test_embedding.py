"""Embeddings: their text form, their boxes on the sensor, and what is refused."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from veilcam_optics.camera.geometry import Camera, Embedding
from veilcam_optics.errors import OpticsError
from veilcam_optics.sensor.readout import FULL_WELL, photon_snr_db


@given(st.integers(1, 9999), st.integers(1, 9999), st.floats(0, 1, exclude_min=True) | st.just(1.0))
def test_embedding_comes_back_from_its_text(rows: int, columns: int, fill: float) -> None:
    embedding = Embedding(rows, columns, fill)
    assert Embedding.parse(str(embedding)) == embedding


def test_full_box_is_not_said() -> None:
    assert str(Embedding(24, 32)) == "24x32"
    assert str(Embedding(24, 32, 0.1)) == "24x32@0.1"


@pytest.mark.parametrize("fill", [0.0, -0.1, 1.0001, math.inf, math.nan])
def test_fill_that_no_box_has_is_refused(fill: float) -> None:
    with pytest.raises(OpticsError, match=r"embedding\.fill = .* above 0, at most 1"):
        Embedding(24, 32, fill)


@pytest.mark.parametrize(
    "text",
    [
        *("", "24", "24x", "x32", "24x32x1", "24x32@", "24x32@-1", "24x32@nan", "24x32@1.1.1"),
        *("0x3", "24x32@0.1 ", " 24x32", "24x32@0", "24x32@2", "24x32@1e9", "24x32@\u0661"),
    ],
)
def test_text_that_is_no_embedding_is_refused(text: str) -> None:
    with pytest.raises(OpticsError, match=r"embedding.* is not valid: use"):
        Embedding.parse(text)


def test_photons_of_a_box_are_those_of_its_pixels() -> None:
    """A tenth of the side is a hundredth of the photons, and 20 dB."""
    sensor = Camera().sensor
    whole, small = (photon_snr_db(Camera(), Embedding(24, 32, fill)) for fill in (1, 0.1))
    assert whole == pytest.approx(
        10 * math.log10(sensor.rows * sensor.columns / 768 * FULL_WELL), abs=1e-9
    )
    assert whole - small == pytest.approx(20)
    colour = photon_snr_db(Camera(), Embedding(24, 32), colour=True)
    assert whole - colour == pytest.approx(10 * math.log10(4))
