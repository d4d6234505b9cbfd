"""What one sees of released embeddings without a key."""

from __future__ import annotations

import itertools

import pytest
import torch

from veilcam_optics.camera.geometry import Camera, Window
from veilcam_optics.decoding.release import ReleaseForm
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


@pytest.mark.parametrize("form", [ReleaseForm.RAW, ReleaseForm.WHITE])
def test_without_a_key_one_sees_the_form(
    source: Source, camera: FreshCamera, form: ReleaseForm
) -> None:
    mask = next(KeylessCamera(camera, form).masks("x"))
    scenes = source.test().scenes(slice(0, 40))
    measurements = shot_noise(mask.embed(scenes), 40.0, torch.Generator().manual_seed(0))
    seen = mask.decode(measurements)
    assert seen.shape == measurements.shape
    if form is ReleaseForm.RAW:
        assert torch.allclose(seen, measurements / measurements.mean(1, keepdim=True), rtol=1e-4)
    else:
        correlation = torch.corrcoef(torch.stack([seen[0], measurements[0]]))[0, 1]
        assert abs(float(correlation)) < 0.6
        size = measurements[0].numel()
        # Each number is rounded, and each of the sums that make a length.
        rounding = 2 * size * torch.finfo(torch.float32).eps
        assert torch.allclose(seen.norm(dim=1), torch.full((len(seen),), size**0.5), rtol=rounding)


def test_every_mask_is_turned_by_a_key_of_its_own(source: Source, camera: FreshCamera) -> None:
    scenes = source.test().scenes(slice(0, 4))

    def seen(purpose: str) -> list[torch.Tensor]:
        masks = KeylessCamera(camera, ReleaseForm.WHITE).masks(purpose)
        return [mask.decode(mask.embed(scenes)) for mask in itertools.islice(masks, 3)]

    first, again = seen("x"), seen("x")
    assert all(torch.equal(one, other) for one, other in zip(first, again, strict=True))
    for one, other in itertools.combinations((*first, *seen("y")), 2):
        # Of 48 dimensions: the product of unrelated directions has deviation 0.14.
        assert float((one * other).mean(1).abs().max()) < 0.8
