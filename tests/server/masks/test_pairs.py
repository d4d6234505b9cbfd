"""The bundle that comes with the package, read through the simulated light."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from veilcam_server.demo_data import BUNDLE, load_digits
from veilcam_server.devices.simulated.device import Conditions, planned_light, simulated_device
from veilcam_server.masks.pairs import PairSource, load_pairs
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


def test_the_demo_s_bundle_fits_the_demo(demo_bundle: Bundle) -> None:
    assert demo_bundle.embedding.shape == (24, 32)
    assert len(demo_bundle.pairs) >= 5
    masks = [pair.levels.tobytes() for pair in demo_bundle.pairs]
    assert len(set(masks)) == len(masks)


@pytest.mark.slow
def test_digits_are_read_through_masks_and_not_without_them(demo_bundle: Bundle) -> None:
    assert accuracy(demo_bundle, load_pairs(demo_bundle)) >= 0.93
    assert accuracy(demo_bundle, load_pairs(demo_bundle, wrong_classifier=True)) < 0.40
