"""Bundles of mode fresh: key policy, scene statistics, one classifier; bad ones are refused."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tests.unit.training.bundle.conftest import edit_manifest, edit_tensors, pack, refuse, unpack

from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Window
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.decoding import MeasurementNoise, SceneStatistics
from veilcam_optics.keys.masks import MaskDistribution, draw_levels
from veilcam_optics.transfer.tables import Reach
from veilcam_server.demo_data import FRESH
from veilcam_training.bundle import (
    Bundle,
    BundleError,
    Fresh,
    classifier_inputs,
    read_bundle,
    write_bundle,
)
from veilcam_training.bundle import fresh as fresh_module
from veilcam_training.bundle.layers import (
    BatchNorm,
    Conv2d,
    Flatten,
    LayerRecord,
    Linear,
    ReLU,
    Reshape,
)
from veilcam_training.models.network import build_classifier, build_untrained, weights_of

CAMERA = Camera(window=Window(rows=9, columns=5))
SCENE = Scene(rows=6, columns=7, height=0.12)
EMBEDDING = Embedding(4, 5)
PIXELS = 42
RANK = 8


def make_fresh(channels: int = 1, **changes: Any) -> Fresh:
    values = channels * PIXELS
    generator = torch.Generator().manual_seed(3)
    layers: tuple[LayerRecord, ...] = (
        Reshape(shape=(channels, 6, 7)),
        Conv2d(inputs=channels, outputs=3),
        BatchNorm(features=3, dimensions=2),
        ReLU(),
        Flatten(),
        Linear(inputs=3 * PIXELS, outputs=4),
    )
    weights = {
        name: torch.rand(array.shape, generator=generator).numpy() if array.ndim else array
        for name, array in weights_of(build_untrained(layers)).items()
    }
    given: dict[str, Any] = {
        "distribution": MaskDistribution.power(CAMERA, 2.0),
        "statistics": SceneStatistics(
            torch.rand(values, generator=generator),
            torch.randn(values, RANK, generator=generator),
            torch.rand(values, generator=generator),
        ).in_numpy(),
        "noise": MeasurementNoise(35.0, 0.01),
        "layers": layers,
        "weights": weights,
        "reach": Reach(2, 1),
    }
    return Fresh(**{**given, **changes})


def make_bundle(channels: Any = 1) -> Bundle:
    return Bundle(
        task="shapes",
        labels=("a", "b", "c", "d"),
        camera=CAMERA,
        scene=SCENE,
        embedding=EMBEDDING,
        channels=channels,
        mode="fresh",
        fresh=make_fresh(channels),
    )


@pytest.fixture
def path(tmp_path: Path) -> Path:
    result = tmp_path / "fresh.veilcam"
    write_bundle(result, make_bundle())
    return result


@pytest.mark.parametrize("channels", [1, 3])
def test_fresh_bundle_comes_back_as_it_was_written(path: Path, channels: int) -> None:
    write_bundle(path, make_bundle(channels))
    written, read = make_fresh(channels), read_bundle(path)
    assert (read.mode, read.pairs, read.channels) == ("fresh", (), channels)
    assert read.inputs == channels * PIXELS
    fresh = read.fresh
    assert fresh is not None
    for name in ("noise", "layers", "reach", "inputs"):
        assert getattr(fresh, name) == getattr(written, name)
    for name in ("lowest", "highest", "curve"):
        np.testing.assert_array_equal(
            getattr(fresh.distribution, name), getattr(written.distribution, name)
        )
    for name in ("mean", "basis", "residual"):
        assert np.array_equal(getattr(fresh.statistics, name), getattr(written.statistics, name))
    assert fresh.weights.keys() == written.weights.keys()
    assert all(np.array_equal(fresh.weights[n], written.weights[n]) for n in written.weights)


def test_same_bundle_gives_the_same_bytes_and_shows_no_secrets(path: Path) -> None:
    first = path.read_bytes()
    write_bundle(path, make_bundle())
    assert path.read_bytes() == first
    parts = unpack(path)
    assert set(parts) == {
        *("bundle.json", "masks.safetensors", "weights.safetensors", "scene_stats.safetensors")
    }
    manifest = json.loads(parts["bundle.json"])
    assert manifest["fresh"]["scheme"] == "veilcam mask levels, version 1"
    assert "pairs" not in manifest
    shown = repr(read_bundle(path))
    assert "tensor" not in shown
    assert "array" not in shown
    del parts["scene_stats.safetensors"]
    pack(path, parts)
    refuse(path, "mode 'fresh' has the parts")


@pytest.mark.parametrize("channels", [1, 3])
def test_masks_and_labels_are_those_of_the_bundle_that_was_written(
    path: Path, channels: int
) -> None:
    write_bundle(path, make_bundle(channels))
    key, written, read = bytes(range(32)), make_bundle(channels), read_bundle(path)
    answers = []
    for bundle in (written, read):
        fresh = bundle.fresh
        assert fresh is not None
        levels = draw_levels(key, camera=bundle.camera, distribution=fresh.distribution)
        frame = fresh.frame(bundle.camera, bundle.scene, bundle.embedding).in_torch()
        decoder = frame.decoding().prepare(
            torch.from_numpy(to_weights(levels, bundle.camera.panel))
        )
        shape = (3,) * (channels > 1) + bundle.embedding.shape
        measurements = torch.rand(2, *shape, generator=torch.Generator())
        inputs = classifier_inputs(decoder, measurements)
        assert inputs.shape == (2, fresh.inputs)
        assert torch.equal(inputs, decoder(measurements).flatten(1))
        answers.append(build_classifier(fresh.layers, fresh.weights)(inputs))
    # Not to the bit: statistics that were read lie in memory as they lie in the file, and some
    # processors' products round by that. A decoder's products in float32 are good to 1e-4.
    torch.testing.assert_close(*answers, rtol=0, atol=1e-3 * float(answers[0].abs().max()))


def test_bundle_that_comes_with_the_package_is_read_as_it_is() -> None:
    bundle = read_bundle(FRESH)
    assert bundle.digest == "cbd05123a5bb28d80ed4bf2900e0681de9eee4e3d909511af2a85eb6e4d53d6e"
    assert bundle.fresh is not None
    assert bundle.fresh.distribution.bits > 128


@pytest.mark.parametrize(
    ("part", "change", "reason"),
    [
        ("scene_stats", lambda t: t["basis"][3].fill_(math.nan), "NaN or infinity"),
        ("scene_stats", lambda t: t["residual"][1].fill_(-1.0), "negative variance"),
        ("scene_stats", lambda t: t.update(mean=t["mean"][1:]), "statistics.basis.shape"),
        ("scene_stats", lambda t: t.update(basis=torch.rand(42, 43)), "rank 43: use at most 42"),
        ("scene_stats", lambda t: t.update(mean=t["mean"].double()), "not float32"),
        ("scene_stats", lambda t: t.pop("residual"), "does not hold mean, basis, residual"),
        ("scene_stats", lambda t: t.update(extra=torch.ones(1)), "does not hold mean, basis, res"),
        (
            "scene_stats",
            lambda t: t.update({name: tensor[:-1] for name, tensor in t.items()}),
            "of 41 values: use 42",
        ),
        ("masks", lambda t: t.update(lowest=t["highest"] + 1), "lowest exceeds highest"),
        ("masks", lambda t: t.update(curve=t["curve"][:-1]), "exceeds its 63 levels"),
        ("masks", lambda t: t["curve"].fill_(64), "exceeds its 64 levels"),
        ("masks", lambda t: t.update(curve=torch.arange(128).byte()), "key policy: .* the panel's"),
        ("masks", lambda t: t.update(curve=t["curve"].float()), "use a uint8 array"),
        ("masks", lambda t: t.update({n: t[n].T for n in ("lowest", "highest")}), "window"),
        ("masks", lambda t: t.update(highest=t["lowest"].clone()), "a mask holds 0 bits"),
        ("masks", lambda t: t["curve"].fill_(0), "a mask holds 0 bits"),
        ("masks", lambda t: t.pop("curve"), "does not hold lowest, highest, curve"),
        ("weights", lambda t: t["classifier.5.bias"][0].fill_(math.inf), "'5.bias' holds NaN"),
        ("weights", lambda t: t.pop("classifier.5.bias"), "weights lack '5.bias'"),
        ("weights", lambda t: t.update({"pair.0.5.bias": torch.ones(4)}), "unknown 'pair.0.5"),
        ("weights", lambda t: t.update({"classifier.9.bias": torch.ones(4)}), "unknown '9.bias'"),
    ],
)
def test_tensors_that_are_refused(
    path: Path, part: str, change: Callable[[dict[str, torch.Tensor]], object], reason: str
) -> None:
    edit_tensors(path, part, change)
    refuse(path, reason)


@pytest.mark.parametrize(
    ("edit", "reason"),
    [
        (lambda m: m["fresh"].update(scheme="veilcam mask levels, version 2"), "fresh.scheme"),
        (lambda m: m["fresh"].update(secret="00"), "fresh.secret"),
        (lambda m: m["fresh"]["noise"].update(snr_db=float("inf")), "JSON"),
        (lambda m: m["fresh"]["noise"].update(model_error=-1.0), "model_error"),
        (lambda m: m["fresh"].update(features=["estimate"]), "fresh.features"),
        (lambda m: m["fresh"]["layers"].pop(), "for 4 labels"),
        (lambda m: m.update(fresh=None), "mode 'fresh' has a key policy"),
        (lambda m: m.update(mode="pairs"), "mode 'pairs' has no key policy"),
        (lambda m: m.update(pairs=[{"layers": []}]), "mode 'fresh' has a key policy and no pairs"),
        (lambda m: m.update(channels=3), "of 42 values: use 126"),
        (lambda m: m["parts"].pop("scene_stats.safetensors"), "lacks the digest"),
    ],
)
def test_bad_manifests(path: Path, edit: Callable[[dict[str, Any]], None], reason: str) -> None:
    edit_manifest(path, edit)
    refuse(path, reason)


def test_response_too_large_is_never_made(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fresh_module, "MAX_RESPONSE", PIXELS * EMBEDDING.size - 1)
    refuse(path, "42 x 20 responses")


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"mode": "pairs"}, "has no key policy"),
        ({"fresh": None}, "has a key policy"),
        ({"mode": "other"}, "use 'pairs' or 'fresh'"),
    ],
)
def test_bad_bundle_is_not_written(path: Path, change: dict[str, Any], reason: str) -> None:
    before = path.read_bytes()
    with pytest.raises(BundleError, match=reason):
        write_bundle(path, dataclasses.replace(make_bundle(), **change))
    assert path.read_bytes() == before
