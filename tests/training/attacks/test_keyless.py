"""What one sees of released embeddings without a key."""

from __future__ import annotations

import pytest
import torch

from veilcam_optics.camera.geometry import Camera, Window
from veilcam_optics.decoding.release import ReleaseForm
from veilcam_optics.sensor.noise import shot_noise
from veilcam_training.attacks.keyless import KeylessCamera
from veilcam_training.config.settings import FreshSettings
from veilcam_training.data import Source, split
from veilcam_training.encoders.fresh import FreshCamera
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.model import fresh_statistics, make_fresh_camera

CAMERA = Camera(window=Window(rows=18, columns=9))


@pytest.fixture(scope="module")
def camera(source: Source) -> FreshCamera:
    """A small camera with fresh masks."""
    chosen = FreshSettings(embedding="6x8", rank=40, misalignment=None)
    training = split(source.training()).training
    statistics = fresh_statistics(chosen, CAMERA, source.scene, training)
    return make_fresh_camera(chosen, CAMERA, source.scene, statistics)


@pytest.mark.parametrize("form", [ReleaseForm.RAW, ReleaseForm.FLAT, ReleaseForm.WHITE])
def test_without_a_key_one_sees_the_released_form(
    source: Source, camera: FreshCamera, form: ReleaseForm
) -> None:
    mask = next(KeylessCamera(camera, form).masks("x"))
    scenes = source.test().scenes(slice(0, 40))
    measurements = shot_noise(mask.embed(scenes), 40.0, torch.Generator().manual_seed(0))
    seen = mask.decode(measurements)
    assert seen.shape == measurements.shape
    correlation = torch.corrcoef(torch.stack([seen[0], measurements[0]]))[0, 1]
    if form is ReleaseForm.RAW:
        assert torch.allclose(seen, measurements / measurements.mean(1, keepdim=True), rtol=1e-4)
    elif form is ReleaseForm.FLAT:
        brighter = mask.decode(2 * measurements)
        assert torch.allclose(seen, brighter, atol=1e-4)
    else:
        assert abs(float(correlation)) < 0.6
        assert 0.3 < float(seen.square().mean()) < 3
    none = KeylessCamera(camera, ReleaseForm.NONE)
    with pytest.raises(TrainingError, match="releases nothing"):
        next(none.masks("x")).decode(measurements)
