"""Pictures of any kind as scenes."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image

from veilcam_optics.pictures import PictureError
from veilcam_server.devices.simulated.images import MAX_PIXELS, as_scene
from veilcam_server.devices.simulated.scenes import FileScene

WHITE = np.full((4, 4), 255, np.uint8)


def encoded(image: Image.Image, kind: str = "PNG", **options: Any) -> bytes:
    stream = io.BytesIO()
    image.save(stream, kind, **options)
    return stream.getvalue()


def saved(array: npt.NDArray[Any]) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array, allow_pickle=True)
    return stream.getvalue()


@pytest.mark.parametrize("mode", ["1", "L", "LA", "P", "RGB", "RGBA"])
def test_white_is_white_in_every_mode(mode: str) -> None:
    content = encoded(Image.fromarray(WHITE).convert(mode))
    assert as_scene(content, (4, 4)) == pytest.approx(1.0)


def test_every_depth_has_the_same_grey() -> None:
    ramp = np.linspace(0, 1, 16).reshape(4, 4)
    deep = np.round(65_535 * ramp).astype(np.uint16)
    for content in (encoded(Image.fromarray(deep)), saved(deep), saved(ramp.astype(np.float16))):
        assert as_scene(content, (4, 4)) == pytest.approx(ramp, abs=1e-3)
    flat = encoded(Image.fromarray(np.round(255 * ramp).astype(np.uint8)), "JPEG", quality=100)
    assert as_scene(flat, (4, 4)) == pytest.approx(ramp, abs=0.02)


def test_colour_becomes_grey_and_what_is_transparent_black() -> None:
    colours = np.array([[[255, 0, 0], [0, 255, 0], [0, 0, 255]]], np.uint8)
    assert as_scene(colours, (1, 3))[0] == pytest.approx([0.299, 0.587, 0.114])
    assert np.array_equal(as_scene(colours, (3, 1, 3))[:, 0], np.eye(3))
    assert np.array_equal(as_scene(WHITE[:, :2], (3, 4, 4)), np.ones((3, 4, 4)))
    clear = Image.new("RGBA", (2, 2), (255, 255, 255, 51))
    assert as_scene(encoded(clear), (2, 2)) == pytest.approx(0.2)


def test_photograph_is_turned_upright() -> None:
    image = Image.fromarray(np.array([[255, 0], [255, 0]], np.uint8))
    exif = Image.Exif()
    exif[0x0112] = 6  # its top is on the right
    upright = as_scene(encoded(image, exif=exif.tobytes()), (2, 2))
    assert upright.tolist() == [[1, 1], [0, 0]]


@pytest.mark.parametrize(
    ("given", "inside"),
    [
        ((4, 8), (slice(0, 4), slice(2, 6))),
        ((16, 8), (slice(4, 12), slice(0, 8))),
        ((2, 2), (slice(0, 2), slice(0, 2))),
        ((2, 100), (slice(0, 2), slice(49, 51))),
    ],
)
@pytest.mark.parametrize("shape", [(8, 8), (3, 8, 8)])
def test_picture_is_cut_about_its_centre_to_the_form_of_the_scene(
    given: tuple[int, int], inside: tuple[slice, slice], shape: tuple[int, ...]
) -> None:
    picture = np.zeros(given, np.float32)
    picture[inside] = 1
    scene = as_scene(picture, shape)
    assert np.array_equal(scene, np.ones(shape))


def test_light_is_averaged_where_pixels_come_together() -> None:
    fine = np.random.default_rng(1).random((12, 8))
    assert as_scene(fine, (3, 2)) == pytest.approx(fine.reshape(3, 4, 2, 4).mean((1, 3)), abs=1e-6)
    coarse = as_scene(np.array([[0.0, 1.0]]), (2, 4))
    assert coarse.tolist() == [[0, 0, 1, 1], [0, 0, 1, 1]]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is no image, or damaged"),
        (b"GIF89a", "is no image"),
        (encoded(Image.new("L", (9, 9)), "PPM"), "another format: use PNG, JPEG"),
        (encoded(Image.new("L", (64, 64)))[:60], "is damaged"),
        (saved(WHITE)[:-3], "is no image"),
        (saved(np.full((2, 3), None)), "is no image"),
        (saved(WHITE[0]), r"has the shape \(4,\)"),
        (saved(np.zeros((2, 2, 4), np.uint8)), r"has the shape \(2, 2, 4\)"),
        (saved(np.zeros((0, 3), np.uint8)), r"has the shape \(0, 3\)"),
        (saved(np.full((2, 3), -0.1)), "no reflectances"),
        (saved(np.full((2, 3), np.nan)), "no reflectances"),
        (saved(np.zeros((2, 3), np.int16)), "no reflectances"),
        (encoded(Image.new("1", (8192, 8192))), f"has {2**26} pixels: use at most {MAX_PIXELS}"),
    ],
)
def test_bytes_that_are_no_picture_are_refused(content: bytes, message: str) -> None:
    with pytest.raises(PictureError, match=message):
        as_scene(content, (2, 3))


def test_file_may_be_any_of_these(tmp_path: Path) -> None:
    path = tmp_path / "card.png"
    path.write_bytes(encoded(Image.fromarray(WHITE)))
    assert FileScene(path, (2, 6)).read().tolist() == [[1] * 6] * 2
