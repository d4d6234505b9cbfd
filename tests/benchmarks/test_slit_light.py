"""Light by slits is that of the simulated camera, which has another way to it."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from benchmarks.daemon.slit_light import SlitLight

from veilcam_server.demo_data import FRESH, load_digits
from veilcam_server.devices.simulated.device import planned_light, raw_shape
from veilcam_training.bundle import read_bundle


@pytest.mark.slow
def test_slits_and_waves_give_the_same_light() -> None:
    bundle = read_bundle(FRESH)
    camera, scene, embedding = bundle.camera, bundle.scene, bundle.embedding
    weights = torch.from_numpy(np.random.default_rng(1).random(camera.mask_shape, np.float32))
    digit = torch.from_numpy(load_digits().images[:1].astype(np.float32) / 255)
    slits, waves = (
        light.collect(digit, light.response(weights))[0].double().numpy()
        for light in (
            SlitLight(camera, scene, embedding),
            planned_light(camera, scene, embedding),
        )
    )
    assert slits.shape == waves.shape == raw_shape(embedding)
    # Slits of one colour do not interfere there, and the simulated light is right to 2.5 %.
    assert slits.sum() == pytest.approx(waves.sum(), rel=0.03)
    assert np.corrcoef(slits.ravel(), waves.ravel())[0, 1] > 0.999
