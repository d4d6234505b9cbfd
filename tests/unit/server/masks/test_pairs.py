"""Pairs: their order, their marks, and the package's own, read through the simulated light."""

from __future__ import annotations

import dataclasses
import hashlib

import numpy as np
import numpy.typing as npt
import pytest

from veilcam_client.keys.epoch_key import EpochKey
from veilcam_server.demo_data import BUNDLE, load_digits
from veilcam_server.devices.simulated.device import Conditions, simulated_device
from veilcam_server.devices.simulated.light import planned_light
from veilcam_server.masks.pairs import PairSource, load_pairs
from veilcam_server.masks.source import transmittance
from veilcam_training.bundle import Bundle, read_bundle

pytestmark = pytest.mark.numerical

DIGITS = 20
"""Shown under every mask."""


class Held:
    """A digit held up."""

    image: npt.NDArray[np.float32] = np.zeros((28, 28), np.float32)

    def read(self) -> npt.NDArray[np.float32]:
        return self.image


@pytest.fixture(scope="module")
def demo_bundle() -> Bundle:
    return read_bundle(BUNDLE)


def accuracy(bundle: Bundle, source: PairSource) -> float:
    scene, digits = Held(), load_digits()
    device = simulated_device(
        planned_light(bundle.camera, bundle.scene, bundle.embedding),
        scene,
        camera=bundle.camera,
        embedding=bundle.embedding,
        conditions=Conditions(settle=0.0, exposure=0.0),
        seed=0,
    )
    right = 0
    for number, mask in enumerate(source._masks):
        device.display.show(mask.levels)
        for index in range(number * DIGITS, (number + 1) * DIGITS):
            scene.image = (digits.images[index] / np.float32(255)).astype(np.float32)
            verdict = mask.reader.classify(device.sensor.capture(0.0, 1.0).embedding)
            right += verdict.label == bundle.labels[int(digits.labels[index])]
    return right / (DIGITS * len(source._masks))


def key() -> EpochKey:
    return EpochKey.generate(device="d7" * 32, bundle="b0" * 32)


def test_masks_to_avoid_come_only_where_no_other_is_left(bundle: Bundle) -> None:
    source = load_pairs(bundle)
    assert source.bundle == bundle.digest
    assert len(source.marks) == 3

    def made(*avoid: str) -> set[str]:
        return {source.make(key(), frozenset(avoid)).mark for _ in range(40)}

    first, second, third = sorted(source.marks)
    assert made() == made(*source.marks) == source.marks
    assert made(first) == {second, third}
    assert made(first, third) == {second}


def test_mark_is_no_plain_digest_of_its_mask_and_is_the_same_in_every_bundle(
    bundle: Bundle,
) -> None:
    marks = [mask.mark for mask in load_pairs(bundle)._masks]
    assert marks == [mask.mark for mask in load_pairs(bundle)._masks]  # also after a restart
    for pair, mark in zip(bundle.pairs, marks, strict=True):
        for name in ("sha256", "sha1", "md5", "blake2b"):
            assert mark[:16] not in hashlib.new(name, pair.levels.tobytes()).hexdigest()
    changed = dataclasses.replace(bundle.pairs[-1], levels=bundle.pairs[-1].levels ^ np.uint8(1))
    other = dataclasses.replace(bundle, pairs=(*bundle.pairs[:-1], changed))
    assert [mask.mark for mask in load_pairs(other)._masks][:-1] == marks[:-1]
    assert load_pairs(other)._masks[-1].mark not in marks
    turned = dataclasses.replace(bundle, pairs=bundle.pairs[::-1])
    assert [mask.mark for mask in load_pairs(turned)._masks] == marks[::-1]


def test_pair_is_not_erased(bundle: Bundle) -> None:
    mask = load_pairs(bundle).make(key(), frozenset())
    measurement = np.ones(bundle.embedding.shape, np.float32)
    levels, verdict = mask.levels.copy(), mask.reader.classify(measurement)
    mask.erase()
    mask.reader.erase()
    assert np.array_equal(mask.levels, levels)
    assert mask.reader.classify(measurement) == verdict


def test_pair_tells_its_light_and_knows_nothing_of_novelty(bundle: Bundle) -> None:
    for mask in load_pairs(bundle)._masks:
        measurement = np.full(bundle.embedding.shape, 0.25, np.float32)
        told, weights = mask.reader.evidence(measurement), mask.levels / 63
        assert told.labels == bundle.labels
        assert told.novelty is None
        assert told.light == pytest.approx(0.25 / (weights**2).mean())
        scores = np.exp(told.logits) / np.exp(told.logits).sum()
        assert np.max(scores) == pytest.approx(mask.reader.classify(measurement).confidence)


def test_dark_mask_passes_a_level_s_worth() -> None:
    assert transmittance(np.zeros((2, 2), np.uint8), 64) == 1 / 63**2
    assert transmittance(np.full((2, 2), 63, np.uint8), 64) == 1.0


def test_demo_s_bundle_fits_the_demo(demo_bundle: Bundle) -> None:
    assert demo_bundle.embedding.shape == (24, 32)
    assert len(demo_bundle.pairs) >= 5
    masks = [pair.levels.tobytes() for pair in demo_bundle.pairs]
    assert len(set(masks)) == len(masks)


@pytest.mark.thorough
def test_digits_are_read_through_masks_and_not_without_them(demo_bundle: Bundle) -> None:
    assert accuracy(demo_bundle, load_pairs(demo_bundle)) >= 0.93
    assert accuracy(demo_bundle, load_pairs(demo_bundle, wrong_classifier=True)) < 0.40
