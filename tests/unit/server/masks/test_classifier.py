"""A classifier gives probabilities, or says that it has none."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from veilcam_server.errors import InferenceError
from veilcam_server.masks.classifier import Classifier
from veilcam_training.bundle import BundleError
from veilcam_training.bundle.layers import Linear

pytestmark = pytest.mark.numerical

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench, Running

LAYERS = (Linear(inputs=2, outputs=2),)


def classifier(weight: float) -> Classifier:
    weights = {"0.weight": np.full((2, 2), weight, np.float32), "0.bias": np.zeros(2, np.float32)}
    return Classifier.load(LAYERS, weights, labels=("a", "b"), inputs=2)


def test_probabilities_sum_to_one() -> None:
    verdict = classifier(1.0).classify(np.array([[0.5, 2.0]], np.float32))
    assert verdict.scores is not None
    assert sum(verdict.scores.values()) == pytest.approx(1)
    assert verdict.confidence == verdict.scores[verdict.label]


def test_network_without_numbers_is_not_loaded() -> None:
    weights = {
        f"{layer}.{name}": np.full(size, 3e38, np.float32)
        for layer in range(2)
        for name, size in (("weight", (2, 2)), ("bias", (2,)))
    }
    with pytest.raises(BundleError, match="a classifier gives NaN or infinity: train it again"):
        Classifier.load(LAYERS * 2, weights, labels=("a", "b"), inputs=2)


def test_measurement_without_probabilities_is_an_error() -> None:
    with pytest.raises(InferenceError):
        classifier(3e38).classify(np.array([[2.0, 2.0]], np.float32))


@pytest.mark.anyio
async def test_api_says_so(running: Running, bench: Bench) -> None:
    for pair in bench.bundle.pairs:
        pair.weights["0.weight"].fill(3e38)
    from veilcam_server.masks.pairs import load_pairs

    bench.source = load_pairs(bench.bundle)
    async with running() as client:
        answer = await client.post("/v1/classifications")
        assert answer.status_code == 503
        assert answer.json()["code"] == "inference_failed"
