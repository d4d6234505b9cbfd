"""Classifiers in NumPy compute what torch's modules do, whatever layers a bundle may name."""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
import torch
from pydantic import TypeAdapter

from veilcam_training.bundle import BundleError, LayerRecord, Network
from veilcam_training.bundle import layers as L  # noqa: N812 - a test of every name in it
from veilcam_training.bundle.classifier import MAX_LAYERS, output_shape
from veilcam_training.models.classifiers import SceneTask, Task, make_layers
from veilcam_training.models.network import build_classifier, build_untrained, weights_of

UNIT = 2.0**-24
"""Rounding of float32."""

CASES: list[tuple[LayerRecord, tuple[int, ...]]] = [
    (L.Linear(inputs=6, outputs=4), (6,)),
    (L.Linear(inputs=6, outputs=4, bias=False), (6,)),
    (L.BatchNorm(features=6, epsilon=0.1), (6,)),
    (L.BatchNorm(features=2, dimensions=2), (2, 4, 5)),
    (L.LayerNorm(shape=(6,), epsilon=0.1), (6,)),
    (L.LayerNorm(shape=(2, 3, 4)), (2, 3, 4)),
    (L.LayerNorm(shape=(2, 3, 3), affine=False), (2, 3, 3)),
    (L.Affine(scale=2.3, offset=-1.7), (6,)),
    (L.ReLU(), (6,)),
    (L.GELU(), (2, 30, 30)),
    (L.Dropout(probability=0.3), (6,)),
    (L.Flatten(), (2, 3, 4)),
    (L.Reshape(shape=(2, 3, 1)), (6,)),
    *(
        (L.Resize(rows=rows, columns=columns), (2, 3, 4))
        for rows, columns in ((8, 5), (3, 4), (1, 1), (2, 11))
    ),
    (L.Conv2d(inputs=2, outputs=4, kernel=3, stride=2, padding=1, groups=2), (2, 7, 6)),
    (L.Conv2d(inputs=2, outputs=3, kernel=2, padding=0), (2, 3, 2)),
    (L.Conv2d(inputs=2, outputs=3, kernel=5, padding=3, bias=False), (2, 3, 2)),
    (L.MaxPool(kernel=2), (2, 7, 6)),
    (L.MaxPool(kernel=3), (2, 3, 8)),
    (L.GlobalMaxPool(), (2, 7, 6)),
    (L.Residual(layers=(L.Linear(inputs=6, outputs=6), L.GELU())), (6,)),
    (
        L.Residual(layers=(L.Conv2d(inputs=2, outputs=2), L.BatchNorm(features=2, dimensions=2))),
        (2, 4, 4),
    ),
]


def stirred(layers: tuple[LayerRecord, ...], seed: int = 0) -> torch.nn.Sequential:
    """A module in use, whose statistics are not those that it began with."""
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        module = build_untrained(layers)
        for name, tensor in module.state_dict().items():
            if name.endswith(("running_mean", "running_var")):
                tensor.uniform_(0.5, 2.0)
    return module.eval()


def both(layers: tuple[LayerRecord, ...], shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    module = stirred(layers)
    x = 2 * torch.randn(3, *shape, generator=torch.Generator().manual_seed(1))
    with torch.inference_mode():
        wanted = module(x).numpy()
    found = Network.load(layers, weights_of(module))(x.numpy())
    assert found.dtype == np.float32
    assert found.shape == wanted.shape
    return found, wanted


@pytest.mark.parametrize(("layer", "shape"), CASES)
def test_every_layer_is_torchs(layer: LayerRecord, shape: tuple[int, ...]) -> None:
    """What it computes, its shape, its weights; and it leaves and comes back as JSON."""
    found, wanted = both((layer,), shape)
    # Sums of at most 50 products of numbers that are at most 10 or so.
    assert np.abs(found - wanted).max() <= 50 * 10 * UNIT
    assert found.shape[1:] == layer.output_shape(shape)
    held = build_untrained([layer]).state_dict()
    needed = layer.parameters.items()
    assert {f"0.{name}": (shape, str(dtype)) for name, (shape, dtype) in needed} == {
        name: (tuple(t.shape), str(t.dtype).partition(".")[2]) for name, t in held.items()
    }
    adapter: TypeAdapter[LayerRecord] = TypeAdapter(LayerRecord)
    assert adapter.validate_json(adapter.dump_json(layer)) == layer


def test_every_kind_of_layer_is_tried() -> None:
    kinds = {record.model_fields["kind"].default for record in get_args(L.PlainLayer)}
    assert kinds | {"residual"} == {layer.kind for layer, _ in CASES}


OF_EMBEDDINGS = Task(1, 24, 32, 10, rectified=True, normalisation="shared", exposure="automatic")
OF_SCENES = [SceneTask(channels, 28, 30, 10) for channels in (1, 3)]
BEHIND = (L.Linear(inputs=24 * 32, outputs=40), L.Linear(inputs=40, outputs=28 * 30))


@pytest.mark.parametrize(
    ("name", "task", "dropout"),
    [
        ("LR", OF_EMBEDDINGS, 0.0),
        *((name, OF_EMBEDDINGS, 0.3) for name in ("FC800", "CNN8")),
        pytest.param("VGG11", OF_EMBEDDINGS, 0.0, marks=pytest.mark.slow),
        *(("Scene8", each, 0.0) for each in OF_SCENES),
        ("Scene8", replace(OF_EMBEDDINGS, estimate=(OF_SCENES[0], BEHIND)), 0.0),
    ],
)
def test_classifiers_are_torchs(name: str, task: Task | SceneTask, dropout: float) -> None:
    inputs = 24 * 32 if isinstance(task, Task) else task.channels * 28 * 30
    found, wanted = both(make_layers(name, task, dropout=dropout), (inputs,))
    assert np.abs(found - wanted).max() <= 1e-5 * np.abs(wanted).max()


def test_numbers_that_overflow_are_given_as_they_are() -> None:
    weights = {"0.weight": np.full((1, 2), 3e38, np.float32), "0.bias": np.zeros(1, np.float32)}
    network = Network.load((L.Linear(inputs=2, outputs=1),), weights)
    assert np.isinf(network(np.full((1, 2), 3e38, np.float32))).all()


def test_weights_that_do_not_fit_are_refused_and_not_shown() -> None:
    layer = L.Linear(inputs=2, outputs=1)
    with pytest.raises(BundleError, match=r"weights lack '0\.bias'"):
        Network.load((layer,), {"0.weight": np.zeros((1, 2), np.float32)})
    network = Network.load((L.ReLU(),), {})
    assert "array" not in repr(network)


@pytest.mark.parametrize(
    ("layer", "shape"),
    [
        (L.Linear(inputs=6, outputs=4), (5,)),
        (L.BatchNorm(features=6), (6, 2, 2)),
        (L.LayerNorm(shape=(3,)), (6,)),
        (L.Reshape(shape=(2, 3, 1)), (7,)),
        (L.Resize(rows=2, columns=2), (4,)),
        (L.Conv2d(inputs=3, outputs=4), (2, 5, 5)),
        (L.Conv2d(inputs=3, outputs=4, groups=2), (3, 5, 5)),
        (L.Conv2d(inputs=3, outputs=4, kernel=9, padding=0), (3, 5, 5)),
        (L.MaxPool(kernel=4), (2, 3, 5)),
        (L.GlobalMaxPool(), (2,)),
        (L.Residual(layers=(L.Linear(inputs=6, outputs=5),)), (6,)),
    ],
)
def test_layer_refuses_bad_sizes(layer: LayerRecord, shape: tuple[int, ...]) -> None:
    with pytest.raises(L.LayerShapeError, match="gets shape"):
        layer.output_shape(shape)


def test_limits() -> None:
    with pytest.raises(BundleError, match=r"layer 1 .resize. gets shape"):
        output_shape([L.Reshape(shape=(16, 1, 1)), L.Resize(rows=4096, columns=4096)], 16)
    with pytest.raises(BundleError, match="129 layers"):
        output_shape([L.ReLU()] * (MAX_LAYERS + 1), 16)
    huge = L.Linear(inputs=2**20, outputs=2**16)
    with pytest.raises(BundleError, match="parameters: use at most"):
        build_classifier([huge], {})


def test_dropout_is_nothing_in_use() -> None:
    x = torch.rand(2, 50)
    torch.testing.assert_close(build_classifier([L.Dropout(probability=0.9)], {})(x), x)
