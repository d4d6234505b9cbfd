"""A camera whose mask changes all the time: where masks come from, and how long they stay."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
import pytest
import torch
from torch.nn.functional import avg_pool2d

from veilcam_optics.camera.geometry import Camera, Scene, Sensor, Window
from veilcam_optics.decoding import unknown_share
from veilcam_optics.keys.masks import draw_levels
from veilcam_optics.sensor.noise import shot_noise
from veilcam_training.config.settings import FitSettings, FreshMasks
from veilcam_training.data import Source, split
from veilcam_training.encoders.fresh import FreshCamera, LearnedRange, Misalignment, pooled
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.model import fresh_statistics, make_fresh_camera
from veilcam_training.transforms.scene import Anywhere

CAMERA = Camera(window=Window(rows=18, columns=9))


def make_camera(source: Source, **changes: Any) -> FreshCamera:
    """A small camera with fresh masks."""
    masks = FreshMasks(**{"misalignment": None, **changes})
    chosen = FitSettings(embedding="6x8", rank=40, fresh=masks)
    training = split(source.training()).training
    statistics = fresh_statistics(chosen, CAMERA, source.scene, training)
    return make_fresh_camera(chosen, CAMERA, source.scene, statistics)


def test_masks_of_two_purposes_and_of_one_stream_differ(source: Source) -> None:
    camera = make_camera(source)
    masks = [*islice(camera.masks("a"), 3), *islice(camera.masks("b"), 3)]
    for index, one in enumerate(masks):
        for other in masks[index + 1 :]:
            assert not torch.allclose(one.transfer, other.transfer, rtol=1e-2)
    again = next(camera.masks("a"))
    assert torch.equal(again.transfer, masks[0].transfer)


def test_each_batch_has_the_next_mask(source: Source) -> None:
    camera, scenes = make_camera(source), source.test().scenes(slice(0, 8))
    masks = list(islice(camera.masks("x"), 2))
    camera.coming = camera.one_by_one("x")
    with pytest.raises(TrainingError, match="no mask is shown yet"):
        camera.decode(torch.zeros(8, 48))
    for mask in masks:
        seen = camera(scenes)
        assert torch.equal(mask.embed(scenes), seen)
        assert torch.equal(camera.decode(seen), mask.decoder(seen).flatten(1))
    with pytest.raises(TrainingError, match="whole scenes on one grid"):
        camera(scenes, grid=1)


def test_wrong_key_is_another_masks(source: Source) -> None:
    camera = make_camera(source)
    masks = list(islice(camera.masks("x"), 4))
    for index, mask in enumerate(islice(camera.one_by_one("x", wrong_key=True), 2)):
        assert torch.equal(mask.transfer, masks[2 * index].transfer)
        assert torch.equal(mask.decoder.estimator, masks[2 * index + 1].decoder.estimator)


@pytest.mark.slow
def test_mask_is_prepared_for_a_nominal_panel_and_shown_by_a_displaced_one(source: Source) -> None:
    exact = next(make_camera(source).masks("x"))
    shown = next(make_camera(source, misalignment=Misalignment(panels=2)).masks("x"))
    assert torch.equal(exact.decoder.mean_measurement, shown.decoder.mean_measurement)
    error = (exact.transfer - shown.transfer).norm() / exact.transfer.norm()
    assert 1e-5 < float(error) < 0.05
    assert "tensor" not in repr(exact)


@pytest.mark.slow
def test_range_is_learned_without_labels_and_leaves_less_unknown(source: Source) -> None:
    camera = make_camera(source, spread=0.25, exponent=4.0)
    known, random = camera.decoding, torch.Generator()

    def unknown() -> float:
        assert isinstance(camera.source, LearnedRange)
        random.manual_seed(1)
        masks = [camera.source(random).detach() for _ in range(10)]
        shares = [unknown_share(known.operator(m), known.statistics, known.noise) for m in masks]
        return float(torch.stack(shares).mean())

    before = unknown()
    camera.learn_range()
    assert unknown() < 0.9 * before
    assert not any(parameter.requires_grad for parameter in camera.parameters())
    again = make_camera(source, spread=0.25, exponent=4.0)
    again.learn_range()
    assert np.array_equal(again.distribution.lowest, camera.distribution.lowest)


def test_learned_range_and_its_published_distribution_agree() -> None:
    masks = LearnedRange(CAMERA, 2.0, 0.2, torch.Generator().manual_seed(0))
    with torch.no_grad():
        masks.centre.uniform_(-0.2, 1.2, generator=torch.Generator().manual_seed(1))
    masks.project()
    assert 0 <= float(masks.centre.detach().min()) <= float(masks.centre.detach().max()) <= 1
    generator = torch.Generator().manual_seed(2)
    drawn = torch.stack([masks(generator).detach() for _ in range(400)])
    distribution = masks.distribution()
    levels = np.stack(
        [
            draw_levels(number.to_bytes(32), camera=CAMERA, distribution=distribution)
            for number in range(400)
        ]
    )
    published = torch.from_numpy(levels / 63)
    assert float((drawn.mean(0) - published.mean(0)).abs().max()) < 0.1
    assert float((drawn.std(0) - published.std(0)).abs().mean()) < 0.01
    masks(generator).sum().backward()
    assert masks.centre.grad is not None
    assert bool(masks.centre.grad.isfinite().all())


def test_pooling_keeps_the_scene_and_its_size() -> None:
    scene = pooled(Scene(28, 30, 0.12), 2)
    assert scene == Scene(14, 15, 0.12)
    with pytest.raises(TrainingError, match="does not divide"):
        pooled(Scene(), 3)


def test_anywhere_is_read_and_decoded_on_the_whole_field(source: Source) -> None:
    small = replace(CAMERA, sensor=Sensor(rows=1700, columns=1550))
    masks = FreshMasks(placement="anywhere", misalignment=None)
    chosen = FitSettings(embedding="6x8", pooling=4, rank=30, fresh=masks)
    statistics = fresh_statistics(chosen, small, source.scene, source.training())
    camera = make_fresh_camera(chosen, small, source.scene, statistics)
    assert camera.setup.scene.shape == (60, 56)
    assert camera.frame.scene.shape == (15, 14)
    mask = next(camera.masks("x"))
    assert mask.transfer.shape == (60 * 56, 48)
    generator = torch.Generator().manual_seed(0)
    scenes = Anywhere(source.scene, small, 4)(source.test().scenes(slice(0, 3)), generator)
    inputs = mask.decode(shot_noise(mask.embed(scenes), 40.0, generator))
    assert inputs.shape == (3, 15 * 14)
    # The light is found where it is: the estimate's brightest region is the scene's, or one within
    # 5 % of it, as noise of 40 dB and a posterior may turn two that are nearly alike.
    estimates = inputs.reshape(3, 1, 15, 14)
    seen, true = (avg_pool2d(x, 5).flatten(1) for x in (estimates, avg_pool2d(scenes[:, None], 4)))
    found = true.gather(1, seen.argmax(1, keepdim=True))
    assert bool((found > 0.95 * true.max(1, keepdim=True).values).all())
