"""Exported classifiers: what other software computes of them, and what the card says."""

from __future__ import annotations

import dataclasses
import json
import stat
import sys
from pathlib import Path

import numpy as np
import pytest
import safetensors.numpy
import torch
from pydantic import JsonValue
from safetensors import safe_open
from tests.unit.training.bundle.test_fresh import make_bundle

from veilcam_server.demo_data import BUNDLE
from veilcam_training.bundle import Accuracy, Bundle, Network, read_bundle
from veilcam_training.bundle.layers import (
    GELU,
    Affine,
    BatchNorm,
    Conv2d,
    Dropout,
    Flatten,
    GlobalMaxPool,
    LayerNorm,
    LayerRecord,
    Linear,
    MaxPool,
    ReLU,
    Reshape,
    Residual,
    Resize,
)
from veilcam_training.errors import TrainingError
from veilcam_training.export.files import (
    INPUT,
    OUTPUT,
    accuracy_interval,
    export_bundle,
    model_card,
    onnx_model,
)
from veilcam_training.models.network import build_classifier, build_untrained, weights_of

EVERY_KIND: tuple[LayerRecord, ...] = (
    Affine(scale=1.5, offset=-0.25),
    LayerNorm(shape=(30,)),
    BatchNorm(features=30),
    Reshape(shape=(1, 5, 6)),
    Resize(rows=9, columns=11),
    Conv2d(inputs=1, outputs=4, kernel=3, stride=2, padding=1),
    BatchNorm(features=4, dimensions=2),
    LayerNorm(shape=(4, 5, 6), affine=False),
    ReLU(),
    Conv2d(inputs=4, outputs=4, groups=2, bias=False),
    MaxPool(kernel=2),
    GlobalMaxPool(),
    Flatten(),
    Residual(layers=(Linear(inputs=4, outputs=4), GELU(), Dropout(probability=0.5))),
    Linear(inputs=4, outputs=3, bias=False),
)


def everything() -> dict[str, np.ndarray]:
    """Weights for :data:`EVERY_KIND`, none of them as torch begins with."""
    generator = torch.Generator().manual_seed(5)
    return {
        name: torch.rand(array.shape, generator=generator).numpy() + np.float32(0.1)
        if array.dtype == np.float32
        else array
        for name, array in weights_of(build_untrained(EVERY_KIND)).items()
    }


def run(model: bytes, values: np.ndarray) -> np.ndarray:
    runtime = pytest.importorskip("onnxruntime")
    session = runtime.InferenceSession(model, providers=["CPUExecutionProvider"])
    (found,) = session.run([OUTPUT], {INPUT: values})
    return np.asarray(found)


def close(found: np.ndarray, expected: np.ndarray) -> None:
    # float32 sums of some hundred products, in another order: 1e-5 of the largest.
    assert np.abs(found - expected).max() < 1e-5 * np.abs(expected).max()


def test_onnx_runtime_computes_what_the_daemon_does_with_every_kind_of_layer() -> None:
    pytest.importorskip("onnxscript")
    weights = everything()
    model = onnx_model(build_classifier(EVERY_KIND, weights), 30, ("a", "b", "c"))
    values = np.random.default_rng(1).normal(size=(7, 30)).astype(np.float32)
    close(run(model, values), Network.load(EVERY_KIND, weights)(values))
    assert {layer.kind for layer in EVERY_KIND} == {
        *("affine", "layer_norm", "batch_norm", "reshape", "resize", "conv2d", "relu"),
        *("max_pool", "global_max_pool", "flatten", "residual", "linear"),
    }


def test_model_is_valid_whole_and_the_same_again() -> None:
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxscript")
    classifier = build_classifier(EVERY_KIND, everything())
    made = onnx_model(classifier, 30, ("a", "b", "c"))
    again = onnx_model(build_classifier(EVERY_KIND, everything()), 30, ("a", "b", "c"))
    assert again == made
    model = onnx.load_from_string(made)
    onnx.checker.check_model(model, full_check=True)
    assert {each.key: each.value for each in model.metadata_props} == {"labels": "a\nb\nc"}
    assert b".py" not in made  # no path of the machine that exported it


@pytest.fixture(scope="module")
def pairs() -> Bundle:
    bundle = read_bundle(BUNDLE)
    return dataclasses.replace(bundle, pairs=bundle.pairs[:2])


def test_bundle_of_pairs_is_written_classifier_by_classifier(pairs: Bundle, tmp_path: Path) -> None:
    pytest.importorskip("onnxscript")
    out = tmp_path / "out"
    written = export_bundle(pairs, out, "veilcam-train export x")
    assert {path.name for path in out.iterdir()} == {path.name for path in written}
    assert {path.name for path in written} == {
        *("classifier-0.onnx", "classifier-0.safetensors", "model-card.md"),
        *("classifier-1.onnx", "classifier-1.safetensors"),
    }
    values = np.random.default_rng(1).random((3, pairs.inputs)).astype(np.float32)
    for number, pair in enumerate(pairs.pairs):
        expected = Network.load(pair.layers, pair.weights)(values)
        close(run((out / f"classifier-{number}.onnx").read_bytes(), values), expected)
        file = out / f"classifier-{number}.safetensors"
        weights = safetensors.numpy.load_file(file)
        assert weights.keys() == pair.weights.keys()
        with safe_open(file, framework="numpy") as archive:
            described = archive.metadata()
        layers = [layer.model_dump(mode="json") for layer in pair.layers]
        assert json.loads(described["layers"]) == layers
        assert tuple(json.loads(described["labels"])) == pairs.labels
        for name, array in weights.items():
            assert np.array_equal(array, pair.weights[name])
        for path in written:
            assert stat.S_IMODE(path.stat().st_mode) == 0o600
            # The mask is nobody's but the bundle's, neither as levels nor as weights.
            assert pair.levels.tobytes() not in path.read_bytes()


def test_bundle_of_fresh_masks_has_one_classifier(tmp_path: Path) -> None:
    pytest.importorskip("onnxscript")
    bundle = make_bundle()
    names = [path.name for path in export_bundle(bundle, tmp_path, "x")]
    assert names == ["classifier.onnx", "classifier.safetensors", "model-card.md"]
    assert bundle.fresh is not None
    values = np.random.default_rng(1).random((3, bundle.inputs)).astype(np.float32)
    expected = Network.load(bundle.fresh.layers, bundle.fresh.weights)(values)
    close(run((tmp_path / "classifier.onnx").read_bytes(), values), expected)
    card = (tmp_path / "model-card.md").read_text()
    assert "the decoded scene, 6 x 7" in card


def test_card_says_data_accuracy_privacy_and_commands(pairs: Bundle) -> None:
    card = model_card(pairs, ("classifier-0.onnx",), "veilcam-train export x --out y")
    command, digests = pairs.provenance["command"], pairs.provenance["data_sha256"]
    assert isinstance(digests, dict)
    assert pairs.accuracy is not None
    for said in (
        f"{100 * pairs.accuracy.value:.2f} %",
        "mnist test, 10000 samples, the mean of 2 classifiers",
        f"trained: `{command}`",
        f"exported: `veilcam-train export x --out y`, from bundle `{pairs.digest}`",
        "- `classifier-0.onnx`",
        "No privacy card: nothing is claimed",
        *(f"SHA-256 `{digest}`" for digest in digests.values()),
    ):
        assert said in card
    record: dict[str, JsonValue] = {"count": 12, "bundle": "ab" * 32}
    adapted: dict[str, JsonValue] = {**pairs.provenance, "adapted": record}
    assert f"to 12 measurements, from bundle `{'ab' * 32}`" in model_card(
        dataclasses.replace(pairs, provenance=adapted), (), "x"
    )
    assert "Not measured." in model_card(dataclasses.replace(pairs, accuracy=None), (), "x")
    assert "Not written down." in model_card(dataclasses.replace(pairs, provenance={}), (), "x")


@pytest.mark.parametrize(
    ("right", "count", "low", "high"),
    # Newcombe, Statistics in Medicine 17 (1998), table I, method 3.
    [
        *((81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605)),
        *((0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)),
    ],
)
def test_interval_is_wilsons(right: int, count: int, low: float, high: float) -> None:
    found = accuracy_interval(Accuracy(right / count, "x", count))
    assert found == pytest.approx((low, high), abs=5e-5)


def test_folder_that_cannot_be_and_a_missing_package_are_one_line(
    pairs: Bundle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    if "onnx" in sys.modules:
        with pytest.raises(TrainingError, match="cannot be written to"):
            export_bundle(pairs, tmp_path / "file" / "x", "x")
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(TrainingError, match=r"need the extra 'export'"):
        export_bundle(pairs, tmp_path / "out", "x")
    assert not (tmp_path / "out").exists()
