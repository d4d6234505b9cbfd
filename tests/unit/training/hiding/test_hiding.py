"""Attackers without a key: what an eye sees, a machine recognises and reads."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_training.bundle import BundleError, Hiding, sentences
from veilcam_training.bundle.hiding import masks_digest
from veilcam_training.data import Images
from veilcam_training.hiding.eye import Eye, drawn_eye
from veilcam_training.hiding.machine import averaging, recognised
from veilcam_training.hiding.masks import other_mask
from veilcam_training.hiding.pinholes import Measurer
from veilcam_training.hiding.reader import Reader, scenes_of
from veilcam_training.hiding.scenes import drawn_scenes, noisy, random_masks

CAMERA, SCENE = Camera(), Scene()


def fifty_holes() -> np.ndarray:
    random = np.random.default_rng(4)
    mask = np.zeros(CAMERA.mask_shape, np.float32)
    for row, column in zip(random.integers(49, size=50), random.integers(22, size=50), strict=True):
        mask[row : row + 3, column] = 1
    return mask


@pytest.fixture(scope="module")
def eye() -> Eye:
    return drawn_eye(CAMERA, SCENE, Embedding(24, 32), 1)


def test_eye_sees_pinholes_and_not_random_masks(eye: Eye) -> None:
    assert eye.pinhole >= 0.95
    assert eye.random < 0.08
    assert eye.seen(fifty_holes()) > eye.random + 0.05
    mask = np.random.default_rng(8).random(CAMERA.mask_shape, np.float32)
    assert eye.seen(mask) <= eye.random + 0.05


def test_eye_sees_a_hole_in_colour_whichever_colour_is_on_top() -> None:
    scene = Scene(rows=16, columns=16, height=0.25, distance=0.4)
    eye = Eye(CAMERA, scene, Embedding(18, 24), 3, drawn_scenes(scene, 3, 40))
    assert eye.pinhole >= 0.95
    assert eye.random < 0.5
    for top in (24, 25, 26):
        mask = np.float32(0.4) * random_masks(CAMERA, 1)[0]
        mask[top : top + 3, 11] = 1
        assert eye.seen(mask) >= 0.95


def test_noise_has_forty_decibels() -> None:
    values = np.random.default_rng(0).random((4, 4000), np.float32)
    off = noisy(values) - values
    ratio = np.square(values).sum(1) / np.square(off).sum(1)
    assert 10 * np.log10(ratio) == pytest.approx(40, abs=0.3)
    assert np.array_equal(noisy(values), noisy(values))


def test_machine_recognises_scenes_of_large_embeddings_and_not_of_black_ones() -> None:
    embedding, scenes = Embedding(12, 16), drawn_scenes(SCENE, 1, 50)
    measure = Measurer(CAMERA, SCENE, embedding, 1)
    values = [measure(scenes, random_masks(CAMERA, 1)[0]), np.zeros((50, 192), np.float32)]
    shares = recognised(CAMERA, SCENE, embedding, scenes, values)
    assert shares[0] > 0.9
    assert shares[1] < 0.1


@pytest.mark.parametrize(("embedding", "channels"), [("24x32", 1), ("27x36", 3)])
def test_reader_reads_behind_masks_that_it_never_saw(embedding: str, channels: int) -> None:
    """Bars that lie or stand."""
    random = np.random.default_rng(5)
    labels = random.integers(2, size=400)
    lying = (np.arange(28) + random.integers(14, size=(400, 1))) % 14 < 7
    bars = np.broadcast_to(lying[:, :, None], (400, 28, 28)).copy()
    bars[labels == 1] = bars[labels == 1].swapaxes(1, 2)
    pixels = torch.from_numpy(255 * bars.astype(np.uint8))
    if channels > 1:
        pixels = torch.stack([pixels, pixels // 2, pixels // 4], 1)
    images = Images(pixels, torch.from_numpy(labels))
    size = Embedding(*map(int, embedding.split("x")))
    measure = Measurer(CAMERA, SCENE, size, channels)
    reader = Reader(CAMERA, size, measure, images, 2)
    scenes = scenes_of(images, slice(None))
    shares = [reader.read(measure(scenes, mask), images.labels) for mask in random_masks(CAMERA, 4)]
    assert np.mean(shares) > 0.9


def test_averages_are_what_a_coarser_embedding_measures() -> None:
    scenes, mask = drawn_scenes(SCENE, 1, 20), random_masks(CAMERA, 1)[0]
    fine = Measurer(CAMERA, SCENE, Embedding(27, 36), 1)
    down, across = averaging(27, 12), averaging(36, 16)
    averages = (down @ fine(scenes, mask).reshape(-1, 27, 36) @ across.T).reshape(20, -1)
    coarse = fine.at(Embedding(12, 16))(scenes, mask)
    assert np.linalg.norm(averages - coarse) < 0.02 * np.linalg.norm(coarse)


def test_other_masks_are_weights() -> None:
    random = np.random.default_rng(6)
    masks = [other_mask(CAMERA.mask_shape, random) for _ in range(60)]
    assert all(mask.shape == CAMERA.mask_shape and mask.dtype == np.float32 for mask in masks)
    assert min(mask.min() for mask in masks) >= 0
    assert max(mask.max() for mask in masks) <= 1
    assert len({mask.tobytes() for mask in masks}) == 60


RECORD = Hiding("0" * 64, 6, 200, 2, 0.07, 0.03, 0.98, 0.97, 0.99, 0.69, 0.7, 0.1)


def test_record_is_visible_where_an_eye_sees_and_can_see() -> None:
    assert RECORD.bounded
    assert not RECORD.visible
    seen = dataclasses.replace(RECORD, seen=0.09)
    assert seen.visible
    assert not dataclasses.replace(seen, pinhole_seen=0.9).visible


def test_record_is_said_in_words() -> None:
    first, second, third = sentences(RECORD)
    assert first == (
        "An eye sees pictures of the scene: no (7 % of scenes picked out of 100; 3 % behind random "
        "masks, 98 % behind a pinhole)."
    )
    assert "recognises 97 % of scenes" in second
    assert "reads 69 % of the labels (70 % behind random masks, chance 10 %)" in third
    unbounded = dataclasses.replace(
        RECORD, pinhole_seen=0.4, read=None, random_read=None, read_chance=None
    )
    assert sentences(unbounded)[0].startswith("This size shows too few numbers for an eye")
    assert len(sentences(unbounded)) == 2


@pytest.mark.parametrize("change", [{"seen": 1.1}, {"worst": 6}, {"scenes": 0}, {"read": None}])
def test_record_that_cannot_be_is_refused(change: dict[str, float]) -> None:
    with pytest.raises(BundleError, match=r"^hiding = "):
        dataclasses.replace(RECORD, **change)  # type: ignore[arg-type]


def test_digest_is_of_the_masks_in_their_order() -> None:
    one, other = np.zeros((3, 2), np.uint8), np.ones((3, 2), np.uint8)
    assert masks_digest([one, other]) == masks_digest([one.copy(), other])
    assert masks_digest([one, other]) != masks_digest([other, one])
    assert masks_digest([one]) != masks_digest([one.T])
