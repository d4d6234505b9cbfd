"""What one sees of released embeddings without a key."""

from __future__ import annotations

import pytest
import torch

from veilcam_optics.camera.geometry import Camera, Window
from veilcam_optics.sensor.noise import shot_noise
from veilcam_training.attacks.keyless import KeylessCamera
from veilcam_training.config.settings import FitSettings, FreshMasks
from veilcam_training.data import Source, split
from veilcam_training.encoders.fresh import FreshCamera
from veilcam_training.experiments.model import fresh_statistics, make_fresh_camera

CAMERA = Camera(window=Window(rows=18, columns=9))


@pytest.fixture(scope="module")
def camera(source: Source) -> FreshCamera:
    """A small camera with fresh masks."""
    chosen = FitSettings(embedding="6x8", rank=40, fresh=FreshMasks(misalignment=None))
    training = split(source.training()).training
    statistics = fresh_statistics(chosen, CAMERA, source.scene, training)
    return make_fresh_camera(chosen, CAMERA, source.scene, statistics)


def test_without_a_key_one_sees_the_measurement(source: Source, camera: FreshCamera) -> None:
    mask = next(KeylessCamera(camera).masks("x"))
    scenes = source.test().scenes(slice(0, 40))
    measurements = shot_noise(mask.embed(scenes), 40.0, torch.Generator().manual_seed(0))
    seen = mask.decode(measurements)
    assert torch.allclose(seen, measurements / measurements.mean(1, keepdim=True), rtol=1e-4)
