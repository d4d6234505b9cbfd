"""Bundles adapted to a camera: which mask was shown, what is fitted, and what is written down."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from veilcam_client import Shot, collect
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Window
from veilcam_optics.camera.imperfections import Imperfections
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_server.demo_data import BUNDLE, FRESH, load_digits
from veilcam_server.testing import FakeCamera
from veilcam_training.bundle import Bundle, Pair, read_bundle, write_bundle
from veilcam_training.bundle.layers import Affine, Linear
from veilcam_training.data.measurements import Header, Measurements, read_measurements
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.adapt import adapt_bundle, fresh_inputs, pairs_shown
from veilcam_training.models.network import build_classifier

CAMERA = Camera(window=Window(rows=17, columns=9))
SCENE = Scene(rows=12, columns=12, height=0.12, distance=0.4)
EMBEDDING = Embedding(9, 12)
LABELS = ("left", "right")


def transfer(levels: np.ndarray, built: Imperfections) -> Tensor:
    operator = TransferOperator(CAMERA, SCENE, EMBEDDING, imperfections=built)
    weights = torch.from_numpy(to_weights(levels, CAMERA.panel))
    found: Tensor = operator(built.shown(weights))
    return found


def scenes(count: int, seed: int) -> tuple[Tensor, Tensor]:
    """A bright spot in the left or in the right half, before a dim ground."""
    generator = torch.Generator().manual_seed(seed)
    labels = torch.arange(count) % 2
    rows = torch.randint(2, 10, (count,), generator=generator)
    columns = torch.randint(2, 5, (count,), generator=generator) + 5 * labels
    y, x = torch.meshgrid(torch.arange(12.0), torch.arange(12.0), indexing="ij")
    away = (y - rows[:, None, None]) ** 2 + (x - columns[:, None, None]) ** 2
    return 0.1 + 0.9 * torch.exp(-away / 6), labels


def measured(
    bundle: Bundle, masks: Sequence[int], built: Imperfections, count: int, seed: int = 1
) -> Measurements:
    """As 'veilcam collect' keeps them: ten behind each mask, an epoch each."""
    shown, labels = scenes(count, seed)
    transfers = {mask: transfer(bundle.pairs[mask].levels, built) for mask in set(masks)}
    values = torch.stack(
        [scene.flatten() @ transfers[masks[place // 10]] for place, scene in enumerate(shown)]
    )
    made = {"format": "veilcam-measurements", "version": 1, "device": "d7" * 32, "mode": "pairs"}
    camera = {"bundle": bundle.digest, "labels": LABELS, "shape": EMBEDDING.shape}
    header = Header.model_validate({**made, **camera})
    epochs = tuple(f"{place // 10}" for place in range(count))
    return Measurements(header, values, labels, epochs, {}, "ab" * 32)


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Bundle:
    """Three random masks, and for each the linear classifier of least squares."""
    generator = torch.Generator().manual_seed(7)

    def pair() -> Pair:
        levels = torch.randint(0, 64, CAMERA.mask_shape, generator=generator).byte().numpy()
        shown, labels = scenes(400, seed=3)
        values = shown.flatten(1) @ transfer(levels, Imperfections())
        scale = float(1 / values.square().mean().sqrt())
        one = torch.cat([scale * values, torch.ones(400, 1)], 1).double()
        wanted = 4 * torch.nn.functional.one_hot(labels).double() - 2
        ridge = 1e-3 * len(one) * torch.eye(one.shape[1], dtype=torch.float64)
        found = torch.linalg.solve(one.T @ one + ridge, one.T @ wanted).float()
        weights = {"1.weight": found[:-1].T.contiguous().numpy(), "1.bias": found[-1].numpy()}
        layers = (Affine(scale=scale), Linear(inputs=EMBEDDING.size, outputs=2))
        return Pair(levels, layers, weights)

    path = tmp_path_factory.mktemp("bundle") / "three.veilcam"
    write_bundle(
        path,
        Bundle(
            task="sides",
            labels=LABELS,
            camera=CAMERA,
            scene=SCENE,
            embedding=EMBEDDING,
            mode="pairs",
            pairs=tuple(pair() for _ in range(3)),
            provenance={"data": "drawn"},
        ),
    )
    return read_bundle(path)


MISBUILT = Imperfections(shift_x=4e-4, gamma=1.5, contrast_floor=0.1)
"""So far aside that a spot in one half looks like one in the other."""


def test_which_stored_mask_was_shown_is_found_from_the_light(bundle: Bundle) -> None:
    masks = [2, 0, 1, 1, 0, 2]
    for built in (Imperfections(), MISBUILT):
        found = pairs_shown(bundle, measured(bundle, masks, built, 60))
        assert found.tolist() == [mask for mask in masks for _ in range(10)]


def test_bundle_reads_the_camera_better_afterwards(bundle: Bundle, tmp_path: Path) -> None:
    masks = [0, 2] * 4
    adapted = adapt_bundle(bundle, measured(bundle, masks, MISBUILT, 80))
    others = measured(bundle, masks, MISBUILT, 80, seed=9)

    def accuracy(of: Bundle) -> float:
        right = 0.0
        for place, (values, label) in enumerate(zip(others.values, others.labels, strict=True)):
            pair = of.pairs[masks[place // 10]]
            logits = build_classifier(pair.layers, pair.weights)(values[None])
            right += float(logits.argmax() == label)
        return right / len(others)

    assert accuracy(bundle) < 0.8
    assert accuracy(adapted.bundle) > accuracy(bundle) + 0.1
    assert adapted.after > adapted.before
    assert set(adapted.chosen) == {0, 2}
    for number, (before, after) in enumerate(zip(bundle.pairs, adapted.bundle.pairs, strict=True)):
        assert np.array_equal(before.levels, after.levels)
        same = all(
            np.array_equal(before.weights[name], after.weights[name]) for name in before.weights
        )
        assert same == (number == 1)  # no measurement was taken behind it
    path = tmp_path / "adapted.veilcam"
    write_bundle(path, adapted.bundle)
    read = read_bundle(path)
    assert read.digest != bundle.digest
    assert read.provenance["data"] == "drawn"
    record = read.provenance["adapted"]
    assert isinstance(record, dict)
    wanted = {"device": "d7" * 32, "measurements": "ab" * 32, "count": 80, "bundle": bundle.digest}
    assert wanted.items() <= record.items()
    assert read.accuracy is not None
    assert (read.accuracy.value, read.accuracy.samples) == (adapted.after, 80)
    assert "left out" in read.accuracy.test_set


def test_measurements_of_another_bundle_and_a_frame_for_pairs_are_refused(bundle: Bundle) -> None:
    found = measured(bundle, [0], Imperfections(), 10)
    other = dataclasses.replace(bundle, digest="12" * 32)
    with pytest.raises(TrainingError, match="give the file that the camera used"):
        adapt_bundle(other, found)
    fresh = read_bundle(FRESH)
    assert fresh.fresh is not None
    frame = fresh.fresh.frame(fresh.camera, fresh.scene, fresh.embedding)
    with pytest.raises(TrainingError, match="leave out --frame"):
        adapt_bundle(bundle, found, frame=frame)


@pytest.mark.thorough
@pytest.mark.numerical
@pytest.mark.parametrize("mode", ["pairs", "fresh"])
def test_captures_sealed_by_a_daemon_are_read_here_as_there(tmp_path: Path, mode: str) -> None:
    """Through the whole daemon: the same label for the same measurement, masks and all."""
    served = {"pairs": BUNDLE, "fresh": FRESH}[mode]
    receiver, digits, path = ReceiverKey.generate(), load_digits(), tmp_path / "m.jsonl"
    heard: list[str] = []
    with FakeCamera({"bundle": served}) as fake, fake.camera() as camera:
        camera.receivers.add("training", str(receiver.public))
        camera.rotation.advance()

        def read(_: Shot) -> None:
            heard.append(camera.classify().label)

        for index in range(6):
            camera.simulation.hold_scene(digits.images[index])
            shot = Shot(str(digits.labels[index]))
            collect(camera, path, [shot], key=receiver, advance=read)
    found, bundle = read_measurements(path), read_bundle(served)
    if bundle.fresh is None:
        numbers, inputs = pairs_shown(bundle, found).tolist(), found.values
        readers = [build_classifier(each.layers, each.weights) for each in bundle.pairs]
    else:
        numbers, inputs = [0] * 6, fresh_inputs(bundle, bundle.fresh, found, None)
        readers = [build_classifier(bundle.fresh.layers, bundle.fresh.weights)]
    logits = [readers[number](inputs[[place]]) for place, number in enumerate(numbers)]
    assert [bundle.labels[int(each.argmax())] for each in logits] == heard
    changed = dataclasses.replace(bundle.camera, distance=0.005)
    if bundle.fresh is not None:
        frame = bundle.fresh.frame(changed, bundle.scene, bundle.embedding)
        with pytest.raises(TrainingError, match="of another camera"):
            fresh_inputs(bundle, bundle.fresh, found, frame)
