"""Every classifier fits every embedding, and survives a bundle's rules."""

from __future__ import annotations

import dataclasses
from typing import cast, get_args

import pytest
import torch
from pydantic import TypeAdapter

from veilcam_optics.camera.geometry import Camera
from veilcam_training.bundle import LayerRecord
from veilcam_training.bundle.classifier import output_shape
from veilcam_training.bundle.layers import (
    Affine,
    BatchNorm,
    Conv2d,
    Dropout,
    Linear,
    ReLU,
)
from veilcam_training.config.settings import FitSettings
from veilcam_training.data import Source
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.fit import run_fit
from veilcam_training.models.classifiers import (
    OF_MEASUREMENTS,
    Exposure,
    Layers,
    Normalisation,
    SceneTask,
    Task,
    make_layers,
)
from veilcam_training.models.network import build_classifier, build_untrained, weights_of
from veilcam_training.models.scene import begin, confidence_factor

NAMES = ("LR", "FC20", "CNN4", "VGG11")


def task(channels: int = 1, rows: int = 24, columns: int = 32) -> Task:
    return Task(channels, rows, columns, 10, rectified=True, normalisation="per_pixel")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "shape", [(1, 24, 32), (1, 12, 16), (1, 6, 8), (1, 3, 4), (3, 27, 36), (3, 13, 17), (3, 3, 4)]
)
def test_classifier_fits_embeddings_of_the_paper(name: str, shape: tuple[int, int, int]) -> None:
    layers = make_layers(name, task(*shape))
    inputs = shape[0] * shape[1] * shape[2]
    assert output_shape(layers, inputs) == (10,)
    torch.manual_seed(0)
    module = build_untrained(layers)
    x = torch.rand(2, inputs)
    with torch.no_grad():
        assert build_classifier(layers, weights_of(module))(x).shape == (2, 10)
    adapter: TypeAdapter[tuple[LayerRecord, ...]] = TypeAdapter(tuple[LayerRecord, ...])
    assert adapter.validate_json(adapter.dump_json(layers)) == layers


def test_new_classifier_is_a_function_and_a_line(
    monkeypatch: pytest.MonkeyPatch, source: Source
) -> None:
    def narrow(task: Task, width: int, dropout: float) -> Layers:
        assert dropout == 0
        hidden = Linear(inputs=task.inputs, outputs=width)
        return hidden, ReLU(), Linear(inputs=width, outputs=task.classes)

    monkeypatch.setitem(cast("dict[str, object]", OF_MEASUREMENTS), "NARROW<width>", narrow)
    chosen = {"classifier": "NARROW7", "encoder": "fixed_simulated"}
    settings = FitSettings(embedding="6x8", epochs=1, batch=90).model_copy(update=chosen)
    result = run_fit(settings, source, Camera())
    [first, *_] = [layer for layer in result.fit.model.layers if isinstance(layer, Linear)]
    assert (first.inputs, first.outputs) == (48, 7)


@pytest.mark.parametrize("name", NAMES)
def test_sensor_layers_of_a_classifier(name: str) -> None:
    def start(normalisation: Normalisation) -> tuple[LayerRecord, ...]:
        asked = dataclasses.replace(task(3, 12, 16), normalisation=normalisation)
        layers = make_layers(name, asked)
        return tuple(layer for layer in layers[:4] if isinstance(layer, BatchNorm | ReLU))

    assert start("per_pixel")[:2] == (BatchNorm(features=576), ReLU())
    assert start("shared")[:2] == (BatchNorm(features=3, dimensions=2), ReLU())
    bare = make_layers(name, dataclasses.replace(task(3, 12, 16), rectified=False))
    assert bare[0] == BatchNorm(features=576)
    assert not isinstance(bare[1], ReLU)
    gained = make_layers(name, dataclasses.replace(task(), gain=20.0))
    assert gained == (Affine(scale=20.0), *make_layers(name, task()))


@pytest.mark.parametrize("name", NAMES)
def test_automatic_exposure_reads_bright_and_dim_objects_alike(name: str) -> None:
    measurements = torch.rand(6, 768)
    dim = measurements * torch.logspace(-4, 0, 6)[:, None]
    found = {}
    for exposure in get_args(Exposure):
        torch.manual_seed(0)
        layers = make_layers(name, dataclasses.replace(task(), gain=2.0, exposure=exposure))
        module = build_untrained(layers).eval()
        with torch.no_grad():
            found[exposure] = (module(dim) - module(measurements))[:-1].norm(dim=1)
    assert float(found["automatic"].max()) < 0.05 * float(found["fixed"].min())
    assert module(torch.zeros(1, 768)).isfinite().all()


def test_paper_s_classifiers_have_their_sizes() -> None:
    layers = make_layers("VGG11", task(3, 32, 32))
    widths = [layer.outputs for layer in layers if isinstance(layer, Conv2d)]
    assert widths == [64, 128, 256, 256, 512, 512, 512, 512]
    parameters = sum(p.numel() for p in build_untrained(layers).parameters())
    # Its convolutions, their normalisation, the last layer, and the sensor's 2 x 3072.
    assert parameters == 9_217_728 + 2 * 2752 + 5130 + 2 * 3072
    wide = [(r.inputs, r.outputs) for r in make_layers("FC800", task()) if isinstance(r, Linear)]
    assert wide == [(768, 800), (800, 10)]


@pytest.mark.parametrize("name", ["FC20", "CNN4", "VGG11"])
def test_dropout(name: str) -> None:
    def count(layers: tuple[LayerRecord, ...]) -> int:
        return sum(
            isinstance(layer, Dropout) + count(getattr(layer, "layers", ())) for layer in layers
        )

    assert count(make_layers(name, task(), dropout=0.2)) >= 1
    assert count(make_layers(name, task())) == 0


def test_classifier_names_that_are_refused() -> None:
    for name in ("FC", "FC0", "FC1e3", "LR5", "ResNet", "VGG16"):
        with pytest.raises(TrainingError, match="use one of LR, FC<width>"):
            make_layers(name, task())
    with pytest.raises(TrainingError, match="use dropout 0"):
        make_layers("LR", task(), dropout=0.5)


@pytest.mark.parametrize(("channels", "patch"), [(1, 4), (3, 12)])
def test_of_estimated_scenes(channels: int, patch: int) -> None:
    """Three groups of two convolutions, each a pooling; the first layer is the whitening."""
    scene = SceneTask(channels, 28, 30, 10)
    layers = make_layers("Scene8", scene)
    assert output_shape(layers, channels * 28 * 30) == (10,)
    widths = [(r.inputs, r.outputs) for r in layers if isinstance(r, Conv2d)]
    first = [(channels, 2 * patch), (2 * patch, 8), (8, 8)]
    assert widths == [*first, (8, 32), (32, 32), (32, 32), (32, 32)]
    estimate = (Linear(inputs=24 * 32, outputs=channels * 28 * 30),)
    behind = dataclasses.replace(task(), estimate=(scene, estimate))
    assert make_layers("Scene8", behind) == (*estimate, *layers)
    with pytest.raises(TrainingError, match="reads the estimated scene"):
        make_layers("Scene8", task())
    with pytest.raises(TrainingError, match="too small: use 3 x 3"):
        make_layers("Scene8", SceneTask(channels, 2, 5, 10))
    with pytest.raises(TrainingError, match="use dropout 0"):
        make_layers("Scene8", scene, dropout=0.2)
    for name in ("FC800", "Scene", "Scene<width>", "CNN8"):
        with pytest.raises(TrainingError, match="use one of Scene<width>"):
            make_layers(name, scene)


def test_scene_classifier_begins_with_a_whitening_that_stays() -> None:
    module = build_untrained(make_layers("Scene8", SceneTask(3, 9, 8, 4)))
    shared = torch.rand(400, 1, 9, 8, generator=torch.Generator().manual_seed(0))
    own = torch.rand(400, 3, 9, 8, generator=torch.Generator().manual_seed(1))
    scenes = shared + 0.1 * own
    begin(module, scenes.flatten(1))
    normal = (scenes - scenes.mean((0, 2, 3), True)) / scenes.std((0, 2, 3), keepdim=True)
    first = module[2]
    assert not first.weight.requires_grad
    white = first(normal)[:, :12].transpose(0, 1).flatten(1)
    covariance = white @ white.T / white.shape[1]
    torch.testing.assert_close(covariance, torch.eye(12), atol=0.05, rtol=0)


def test_confidence_is_set_right_without_changing_a_label() -> None:
    random = torch.Generator().manual_seed(0)
    logits = 3 * torch.randn(4000, 5, generator=random)
    labels = torch.multinomial(logits.softmax(1), 1, generator=random).flatten()
    # Logits of 0.4 of their size are too unsure; a step of the grid is six parts in a hundred.
    assert confidence_factor(0.4 * logits, labels) == pytest.approx(2.5, rel=0.1)
