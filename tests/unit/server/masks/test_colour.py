"""Fresh masks of a camera in colour: the reader behind them, and what such a camera has not."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tests.unit.server.conftest import CAMERA, EMBEDDING
from tests.unit.server.masks.test_fresh import NONE, key

from veilcam_optics.camera.geometry import Scene
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.decoding import MeasurementNoise, fit_statistics
from veilcam_optics.keys.masks import MaskDistribution
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_server.bundles.loader import bundle_info
from veilcam_server.calibration.record import geometry_of
from veilcam_server.errors import CalibrationError
from veilcam_server.masks.fresh import FreshSource
from veilcam_training.bundle import Bundle, Fresh
from veilcam_training.bundle.layers import Linear

SCENE = Scene(2, 3)
COLOURS = torch.eye(3)[:, :, None, None].expand(3, 3, *SCENE.shape)
"""A red, a green and a blue scene."""


@pytest.fixture(scope="module")
def coloured() -> Bundle:
    """A classifier that says which channel of the estimate is the brightest."""
    draws = torch.rand(300, 3, 1, 1, generator=torch.Generator().manual_seed(1))
    scenes = (draws * torch.ones(SCENE.shape)).numpy()
    means = np.repeat(np.eye(3, dtype=np.float32), 6, axis=1)
    fresh = Fresh(
        distribution=MaskDistribution.uniform(CAMERA),
        statistics=fit_statistics([scenes], 3),
        noise=MeasurementNoise(40.0),
        layers=(Linear(inputs=18, outputs=3),),
        weights={"0.weight": means, "0.bias": np.zeros(3, np.float32)},
    )
    known = ("rgb", ("red", "green", "blue"), CAMERA, SCENE, EMBEDDING)
    return Bundle(*known, mode="fresh", fresh=fresh, channels=3, digest="b0" * 32)


def test_reader_in_colour_tells_colours_apart_behind_every_mask(coloured: Bundle) -> None:
    source = FreshSource(coloured)
    operator = TransferOperator(CAMERA, SCENE, EMBEDDING, colour=True)
    for number in range(3):
        mask = source.make(key(number), NONE)
        weights = torch.from_numpy(to_weights(mask.levels, CAMERA.panel))
        for name, seen in zip(coloured.labels, operator.embed(COLOURS, weights), strict=True):
            assert mask.reader.classify(seen.numpy()).label == name
            bright, dim = (mask.reader.evidence((seen * part).numpy()) for part in (1.0, 0.5))
            assert np.argmax(bright.logits) == coloured.labels.index(name)
            assert dim.light == pytest.approx(bright.light / 2)
            assert bright.novelty is not None


def test_camera_in_colour_has_no_calibration(coloured: Bundle) -> None:
    with pytest.raises(CalibrationError, match="serve a gray bundle"):
        geometry_of(coloured)
    assert bundle_info(coloured).embedding_shape == (3, *EMBEDDING.shape)
