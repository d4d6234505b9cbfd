"""Pictures of a fitted camera."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from veilcam_optics.camera.geometry import Camera
from veilcam_training.config.settings import Settings
from veilcam_training.data import Source
from veilcam_training.encoders import Encoder, Setup, make_encoder
from veilcam_training.experiments import pictures
from veilcam_training.experiments.model import make_model
from veilcam_training.experiments.pictures import point_image


@pytest.mark.parametrize("encoder", ["lens", "learned"])
def test_the_image_of_a_point_takes_one_grid(
    monkeypatch: pytest.MonkeyPatch, source: Source, encoder: str
) -> None:
    """The finer scenes of a change cost a gigabyte, and a point needs none of them."""
    setups: list[Setup] = []

    def make(name: str, setup: Setup, generator: torch.Generator, **more: Any) -> Encoder:
        setups.append(setup)
        return make_encoder(name, setup, generator, **more)

    monkeypatch.setattr(pictures, "make_encoder", make)
    images = []
    for change in ("none", "rescale"):
        settings = Settings(encoder=encoder, embedding="3x4", change=change)
        model = make_model(settings, source, Camera())
        with torch.no_grad():
            images.append(point_image(model, settings))
        assert bool(model.encoder.setup.finer) == (change == "rescale")
    assert [setup.finer for setup in setups] == [(), ()]
    assert images[0] is not None
    assert images[1] is not None
    assert np.array_equal(images[0], images[1])
