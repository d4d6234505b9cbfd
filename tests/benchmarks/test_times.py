"""Times of reading, as the daemon reads."""

from __future__ import annotations

from benchmarks.training.times import times_of_reading

from veilcam_optics.camera.geometry import Embedding, Scene


def test_reading_is_timed() -> None:
    found = times_of_reading(Scene(rows=8, columns=8), Embedding(4, 5), 10)
    assert all(value >= 0 for value in found.values())
    assert found.keys() == {"head_numpy_ms", "fresh_colour_prepare_s"}
