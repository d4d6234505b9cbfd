"""What a step takes: measurements of a fixed camera are computed once, their noise never is."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from veilcam_optics.camera.geometry import Camera
from veilcam_training.config.settings import FitSettings
from veilcam_training.data import Source
from veilcam_training.experiments.model import make_model, prepare
from veilcam_training.models.lensless import LenslessClassifier
from veilcam_training.trainer.step import Inputs
from veilcam_training.transforms.augmentation import Augmentation


def model_of(source: Source, **changes: Any) -> LenslessClassifier:
    return make_model(FitSettings(embedding="3x4", **changes), source, Camera())


@pytest.mark.parametrize(
    ("changes", "jitter", "steps_encode"),
    [
        ({"encoder": "fixed_simulated"}, Augmentation(), False),
        ({"encoder": "lens"}, Augmentation(), False),
        ({"encoder": "lens"}, Augmentation(mirror=True), True),
        ({"encoder": "lens", "change": "rotate"}, Augmentation(), True),
        ({"encoder": "learned"}, Augmentation(), True),
    ],
)
def test_measurements_of_a_fixed_camera_are_computed_once(
    source: Source, changes: dict[str, Any], jitter: Augmentation, *, steps_encode: bool
) -> None:
    model = model_of(source, **changes)
    encoded: list[None] = []
    model.encoder.register_forward_hook(lambda *_: encoded.append(None))
    inputs = Inputs(model, source.test(), FitSettings(jitter=jitter))
    before = len(encoded)
    assert before == int(not steps_encode)
    for step in range(3):
        inputs(torch.arange(30 * step, 30 * step + 30))
    assert len(encoded) - before == (3 if steps_encode else 0)


@pytest.mark.parametrize("jitter", [Augmentation(), Augmentation(mirror=True, crop=2)])
def test_scenes_are_measured_and_estimated_once(source: Source, jitter: Augmentation) -> None:
    """With mirror images in a view of their own, which every other epoch shows."""
    chosen: dict[str, Any] = {"encoder": "fixed_simulated", "classifier": "Scene2"}
    model, images = model_of(source, **chosen), source.test()
    settings = FitSettings(embedding="3x4", **chosen)
    prepare(model, settings, images)
    seen: list[None] = []
    model.encoder.register_forward_hook(lambda *_: seen.append(None))
    inputs = Inputs(model, images, FitSettings(jitter=jitter, seed=1))
    measured = len(seen)
    assert measured == (2 if jitter.mirror else 1)
    views: list[torch.Tensor] = []
    model.classifier.register_forward_pre_hook(lambda _, given: views.append(given[0]))
    for epoch in range(2):
        inputs.begin_epoch(1, epoch)
        assert inputs(torch.arange(30))[0].shape == (30, 10)
    assert len(seen) == measured
    assert torch.equal(*views) == (not jitter.any)
