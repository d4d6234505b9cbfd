"""Embeddings as arrays, as NumPy files and as pictures."""

from __future__ import annotations

import base64
import io
import json
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from PIL import Image
from pydantic import ValidationError
from tests.unit.client.conftest import CAPTURE, CLASSIFICATION, STATUS
from tests.unit.client.sealing import Device, Epoch

from veilcam_client import VeilcamError
from veilcam_client.errors import ProtocolError, SealedError
from veilcam_client.http.answers import Received, read
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.numbers import npy_array, picture
from veilcam_client.wire.captures import Capture, Classification, Embedding
from veilcam_client.wire.status import Status

VALUES = np.random.default_rng(0).normal(size=(3, 4, 5)).astype(np.float32)


@pytest.fixture
def capture() -> Capture:
    return Capture.model_validate_json(json.dumps(CAPTURE))


def test_embedding_is_an_array(capture: Capture) -> None:
    array = np.asarray(capture)
    assert array.dtype == np.float32
    assert array.tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.5]]
    assert np.asarray(capture, dtype=np.float64).dtype == np.float64
    assert np.array_equal(np.asarray(capture.embedding), array)
    # One of the caller's own, which changes nothing else.
    array[0, 0] = 7
    assert np.asarray(capture)[0, 0] == 0


def test_array_without_a_copy_is_the_one_that_came(capture: Capture) -> None:
    for held in (np.array(capture, copy=False), np.array(capture, np.float32, copy=False)):
        assert held.tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.5]]
        assert not held.flags.writeable
    with pytest.raises(ValueError, match="cannot become float64 without a copy"):
        np.array(capture, np.float64, copy=False)


def test_embedding_has_a_length_rows_and_an_index() -> None:
    embedding = Embedding.from_array(VALUES)
    assert len(embedding) == 3
    assert np.array_equal(embedding[1], VALUES[1])
    assert embedding[2, 3, 4] == VALUES[2, 3, 4]
    assert np.array_equal(embedding[..., 0], VALUES[..., 0])
    assert [row.shape for row in embedding] == [(4, 5)] * 3
    with pytest.raises(IndexError):
        embedding[3]


def test_embeddings_are_equal_where_all_of_them_is() -> None:
    embedding = Embedding.from_array(VALUES)
    same = Embedding.model_validate_json(embedding.model_dump_json())
    assert embedding == same
    assert hash(embedding) == hash(same)
    assert embedding == Embedding.model_validate(embedding.model_dump())
    changed = VALUES.copy()
    changed[2, 3, 4] = np.nextafter(changed[2, 3, 4], np.float32(9))
    for other in (
        Embedding.from_array(VALUES.reshape(4, 3, 5)),
        Embedding.from_array(changed),
        "embedding",
    ):
        assert embedding != other


def test_answer_without_an_array_says_so() -> None:
    classification = Classification.model_validate_json(json.dumps(CLASSIFICATION))
    with pytest.raises(VeilcamError, match="ask with include_embedding=True") as caught:
        np.asarray(classification)
    assert caught.value.code == "no_embedding"
    embedding = Embedding.from_array(VALUES)
    with_it = classification.model_copy(update={"embedding": embedding})
    assert np.array_equal(np.asarray(with_it), VALUES)
    with pytest.raises(TypeError, match="a Status is no array"):
        np.asarray(Status.model_validate_json(json.dumps(STATUS)))
    sealed = Epoch(Device(), ReceiverKey.generate()).capture(0)
    for answer in (sealed, sealed.embedding, with_it.model_copy(update=dict(sealed))):
        with pytest.raises(SealedError, match="private key of a receiver"):
            np.asarray(answer)
    # A capture that cannot be opened is one all the same.
    assert sealed
    assert classification


@pytest.mark.parametrize(
    "text",
    [
        '{"form": "raw", "shape": [2, 3], "values": [1.0]}',
        '{"form": "raw", "shape": [0], "values": []}',
        '{"form": "raw", "shape": [], "values": []}',
        '{"form": "raw", "shape": [1], "values": [NaN]}',
        '{"form": "raw", "shape": [1], "values": ["1"]}',
        '{"form": "raw", "shape": [-1, -1], "values": [1.0]}',
        '{"form": "raw", "shape": [1], "values": [1e39]}',
        '{"form": "raw", "shape": [1], "values": [5.000000001]}',
        '{"form": "none", "shape": [1], "values": [1.0]}',
        '{"shape": [1], "values": [1.0]}',
    ],
)
def test_embedding_that_cannot_be_is_refused(text: str) -> None:
    with pytest.raises(ValidationError):
        Embedding.model_validate_json(text)


def npy(values: npt.NDArray[Any]) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, values)
    return buffer.getvalue()


WHOLE = npy(VALUES)


def test_embedding_is_no_repr_and_an_array_by_one_way_alone(capture: Capture) -> None:
    assert "5.5" not in repr(capture)
    assert not hasattr(capture, "__array_struct__")
    assert not hasattr(capture.embedding, "__array_interface__")
    assert not hasattr(capture, "unknown")


def test_answer_that_is_no_capture_comes_as_no_array() -> None:
    named = {**HEADERS, "content-type": "application/x-npy"}
    assert read(Capture, Received(200, named, WHOLE)).number == 2
    with pytest.raises(ProtocolError, match="no Classification"):
        read(Classification, Received(200, named, WHOLE))


@pytest.mark.parametrize("shape", [(1,), (7,), (24, 32), (2, 3, 4), (1, 1, 1, 1)])
def test_numpy_file_is_read_as_numpy_does(shape: tuple[int, ...]) -> None:
    values = np.random.default_rng(1).normal(size=shape).astype(np.float32)
    assert np.array_equal(npy_array(npy(values)), np.load(io.BytesIO(npy(values))))
    assert npy_array(npy(values)).shape == shape


@pytest.mark.parametrize(
    "content",
    [
        *(b"", b"{}", WHOLE[:-1], WHOLE[:-4], WHOLE + b"\0\0\0\0", WHOLE[:100]),
        *(npy(VALUES.astype(kind)) for kind in ("<f8", ">f4")),
        npy(np.asfortranarray(VALUES)),
        WHOLE.replace(b"(3, 4, 5)", b"(9, 9, 9)"),
        WHOLE.replace(b"(3, 4, 5)", b"(3, 4 5) "),
        WHOLE.replace(b"'<f4'", b"'|O8'"),
        npy(np.array([None])),
    ],
)
def test_other_file_than_an_array_is_refused(content: bytes) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - of whatever is wrong first
        npy_array(content)


HEADERS = {
    "veilcam-capture": "c1",
    "veilcam-epoch": "e1",
    "veilcam-number": "2",
    "veilcam-taken-at": "2026-01-02T03:04:05+00:00",
    "veilcam-form": "raw",
}


def test_capture_comes_as_a_file_as_well(capture: Capture) -> None:
    content = npy(np.asarray(capture))
    assert Capture.from_npy(content, HEADERS) == capture
    replayed = {**HEADERS, "veilcam-replay": "3", "veilcam-replay-capture": "c0"}
    found = Capture.from_npy(content, replayed).replay
    assert found is not None
    assert (found.place, found.capture) == (3, "c0")


@pytest.mark.parametrize(
    "changed",
    [
        *({"veilcam-form": "sealed"}, {"veilcam-form": "none"}, {"veilcam-number": "-1"}),
        *({"veilcam-number": "two"}, {"veilcam-taken-at": "today"}),
        {"veilcam-replay": "3"},
    ],
)
def test_file_with_other_headers_is_refused(changed: dict[str, str]) -> None:
    with pytest.raises(ValueError):  # noqa: PT011 - of whatever is wrong first
        Capture.from_npy(npy(VALUES), {**HEADERS, **changed})
    with pytest.raises(ValueError):  # noqa: PT011
        Capture.from_npy(npy(np.full((2, 2), np.nan, np.float32)), HEADERS)


def opened(png: bytes) -> npt.NDArray[np.uint8]:
    return np.asarray(Image.open(io.BytesIO(png)))


def test_picture_goes_from_black_to_white() -> None:
    values = np.linspace(-2, 5, 24 * 32, dtype=np.float32).reshape(24, 32)
    embedding = Embedding.from_array(values)
    pixels = opened(embedding._repr_png_())
    assert pixels.shape == (24 * 8, 32 * 8)
    expected = np.rint((values + 2.0) / 7 * 255)
    assert np.abs(pixels[::8, ::8] - expected).max() <= 1
    assert np.array_equal(pixels[3::8, 5::8], pixels[::8, ::8])
    html = embedding._repr_html_()
    assert 'alt="embedding, 24 × 32"' in html
    encoded = html.partition("base64,")[2].partition('"')[0]
    assert base64.b64decode(encoded) == embedding._repr_png_()


@pytest.mark.parametrize(
    ("values", "shape"),
    [
        (np.zeros(3, np.float32), (85, 255)),
        (np.ones((3, 3, 4), np.float32), (63, 252)),
        (np.array([[-3e38, 3e38]], np.float32), (128, 256)),
        (np.zeros((600, 2), np.float32), (600, 2)),
    ],
)
def test_every_array_has_a_picture(values: npt.NDArray[np.float32], shape: tuple[int, int]) -> None:
    assert opened(picture(values)).shape == shape
