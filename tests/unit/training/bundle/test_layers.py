"""Every layer record says the shape that its module gives, and refuses what the module cannot."""

from __future__ import annotations

import pytest
import torch
from pydantic import TypeAdapter

from veilcam_training.bundle import BundleError, LayerRecord
from veilcam_training.bundle import layers as L  # noqa: N812 - a test of every name in it
from veilcam_training.bundle.classifier import MAX_LAYERS, output_shape
from veilcam_training.models.network import build_classifier, build_untrained, weights_of

CASES: list[tuple[LayerRecord, tuple[int, ...]]] = [
    (L.Linear(inputs=6, outputs=4, bias=False), (6,)),
    (L.BatchNorm(features=6), (6,)),
    (L.BatchNorm(features=2, dimensions=2), (2, 4, 4)),
    (L.LayerNorm(shape=(6,)), (6,)),
    (L.LayerNorm(shape=(2, 3, 3), affine=False), (2, 3, 3)),
    (L.Affine(scale=2.0, offset=-1.0), (6,)),
    (L.ReLU(), (6,)),
    (L.GELU(), (2, 3, 3)),
    (L.Dropout(probability=0.3), (6,)),
    (L.Flatten(), (2, 3, 4)),
    (L.Reshape(shape=(2, 3, 1)), (6,)),
    (L.Resize(rows=8, columns=5), (2, 3, 4)),
    (L.Conv2d(inputs=2, outputs=4, kernel=3, stride=2, padding=1, groups=2), (2, 7, 6)),
    (L.Conv2d(inputs=2, outputs=3, kernel=2, padding=0), (2, 3, 2)),
    (L.MaxPool(kernel=2), (2, 7, 6)),
    (L.AveragePool(), (2, 7, 6)),
    (L.Residual(layers=(L.Linear(inputs=6, outputs=6), L.GELU())), (6,)),
]


@pytest.mark.parametrize(("layer", "shape"), CASES, ids=[case[0].kind for case in CASES])
def test_record_module_and_shape_agree(layer: LayerRecord, shape: tuple[int, ...]) -> None:
    module = build_untrained([layer]).eval()
    with torch.no_grad():
        assert tuple(module(torch.rand(3, *shape)).shape[1:]) == layer.output_shape(shape)
    adapter: TypeAdapter[LayerRecord] = TypeAdapter(LayerRecord)
    assert adapter.validate_json(adapter.dump_json(layer)) == layer
    with torch.no_grad():
        x = torch.rand(3, *shape)
        torch.testing.assert_close(build_classifier([layer], weights_of(module))(x), module(x))


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
        (L.AveragePool(), (2,)),
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
