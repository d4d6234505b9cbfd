"""Mode fresh: masks of a key, what reads behind them, and what leaves of them."""

from __future__ import annotations

import asyncio
import dataclasses
import hashlib
import re
from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch

from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.wire.captures import Capture, Classification, Embedding
from veilcam_client.wire.rotation import EveryCaptures
from veilcam_client.wire.status import Status
from veilcam_optics.camera.geometry import Camera, Scene
from veilcam_optics.camera.geometry import Embedding as EmbeddingSize
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.decoding import Decoder, Precision, fit_statistics
from veilcam_optics.keys.masks import MaskDistribution, draw_levels
from veilcam_optics.transfer.grid import GridLight
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_server.demo_data import load_digits
from veilcam_server.errors import StartError
from veilcam_server.masks.fresh import FreshReader, FreshSource
from veilcam_training.bundle import Bundle, classifier_inputs
from veilcam_training.models.network import build_classifier

pytestmark = pytest.mark.numerical

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench, Running

PER_CAPTURE = EveryCaptures(captures=1)
NONE: frozenset[str] = frozenset()


def key(number: int) -> EpochKey:
    """The key of a number, for a test that needs it again."""
    value = hashlib.sha256(str(number).encode()).digest()
    return EpochKey(value, device="d7" * 32, bundle="b0" * 32)


def levels_of(bundle: Bundle, key: EpochKey) -> np.ndarray:
    assert bundle.fresh is not None
    return draw_levels(key.levels(), camera=bundle.camera, distribution=bundle.fresh.distribution)


def decoder_of(bundle: Bundle, levels: np.ndarray) -> Decoder:
    assert bundle.fresh is not None
    decoding = (
        bundle.fresh.frame(bundle.camera, bundle.scene, bundle.embedding)
        .in_torch()
        .decoding(precision=Precision.DOUBLE)
    )
    return decoding.prepare(torch.from_numpy(to_weights(levels, bundle.camera.panel)))


def a_measurement(bundle: Bundle, levels: np.ndarray, seed: int = 0) -> np.ndarray:
    operator = TransferOperator(bundle.camera, bundle.scene, bundle.embedding)
    scene = torch.rand(1, *bundle.scene.shape, generator=torch.Generator().manual_seed(seed))
    weights = torch.from_numpy(to_weights(levels, bundle.camera.panel))
    measurement: np.ndarray = operator.embed(scene, weights)[0].numpy()
    return measurement


def test_mask_is_its_key_s_and_its_reader_the_mask_s(fresh_bundle: Bundle) -> None:
    fresh, source = fresh_bundle.fresh, FreshSource(fresh_bundle)
    assert fresh is not None
    network = build_classifier(fresh.layers, fresh.weights)
    for number in range(3):
        mask = source.make(key(number), NONE)
        np.testing.assert_array_equal(mask.levels, levels_of(fresh_bundle, key(number)))
        assert mask.mark == ""
        decoder = decoder_of(fresh_bundle, mask.levels)
        measurement = a_measurement(fresh_bundle, mask.levels)
        inputs = classifier_inputs(decoder, torch.from_numpy(measurement)[None])
        expected = network(inputs.float()).double().softmax(dim=1)[0]
        verdict = mask.reader.classify(measurement)
        assert verdict.scores is not None
        np.testing.assert_allclose(list(verdict.scores.values()), expected, atol=1e-5)
    assert source.renewable
    assert source.marks == NONE
    assert source.bundle == fresh_bundle.digest


def test_evidence_is_the_same_behind_every_mask(fresh_bundle: Bundle) -> None:
    source, scene = FreshSource(fresh_bundle), fresh_bundle.scene
    operator = TransferOperator(fresh_bundle.camera, scene, fresh_bundle.embedding)
    digit = torch.from_numpy(load_digits().images[:1] / np.float32(255))
    wall, dark = torch.full((1, *scene.shape), 0.4), torch.zeros(1, *scene.shape)
    light, novelty = [], []
    for number in range(3):
        mask = source.make(key(number), NONE)
        weights = torch.from_numpy(to_weights(mask.levels, fresh_bundle.camera.panel))
        told = [
            mask.reader.evidence(operator.embed(each, weights)[0].numpy())
            for each in (digit, digit / 2, wall, dark)
        ]
        assert all(each.labels == fresh_bundle.labels for each in told)
        light.append([each.light for each in told])
        novelty.append([each.novelty for each in told if each.novelty is not None])
    # Neighbours that interfere make a mask pass a little more or less than its weights say.
    np.testing.assert_allclose(light, np.broadcast_to(light[0], (3, 4)), rtol=0.2)
    assert [each[1] / each[0] for each in light] == pytest.approx([0.5] * 3)
    assert [each[3] for each in light] == [0, 0, 0]
    assert all(far[0] < far[2] < 1e6 < far[3] for far in novelty), novelty


def test_logits_are_the_mean_over_a_scene_and_its_neighbours(fresh_bundle: Bundle) -> None:
    fresh = fresh_bundle.fresh
    assert fresh is not None
    mask = FreshSource(fresh_bundle).make(key(1), NONE)
    network = build_classifier(fresh.layers, fresh.weights)
    measurement = a_measurement(fresh_bundle, mask.levels)
    decoder = decoder_of(fresh_bundle, mask.levels)
    inputs = classifier_inputs(decoder, torch.from_numpy(measurement)[None])
    images = inputs.reshape(1, *fresh_bundle.scene.shape).float().numpy()
    expected = []
    for down, across in ((0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)):
        framed = np.pad(images, ((0, 0), (1, 1), (1, 1)), mode="edge")
        moved = np.roll(framed, (down, across), axis=(1, 2))[:, 1:-1, 1:-1]
        expected.append(network(torch.from_numpy(moved.reshape(1, -1).copy())).double().numpy()[0])
    found = mask.reader.evidence(measurement).logits
    np.testing.assert_allclose(found, np.mean(expected, axis=0), atol=1e-4)


def test_mask_that_is_erased_takes_its_reader_along_and_leaves_its_neighbours(
    fresh_bundle: Bundle,
) -> None:
    source = FreshSource(fresh_bundle)
    mask, other = (source.make(key(number), NONE) for number in range(2))
    measurement = a_measurement(fresh_bundle, other.levels)
    expected = other.reader.classify(measurement)
    assert isinstance(mask.reader, FreshReader)
    mask.erase()
    mask.erase()  # twice does no harm
    assert not mask.levels.any()
    assert not bool(mask.reader.decoder.estimator.any())
    assert other.reader.classify(measurement) == expected


@pytest.mark.parametrize("fails", [False, True])
def test_derived_keys_are_overwritten_as_soon_as_they_were_used(
    fresh_bundle: Bundle, monkeypatch: pytest.MonkeyPatch, fails: bool
) -> None:
    source, derived = FreshSource(fresh_bundle), []
    derive = EpochKey._derived

    def noted(key: EpochKey, label: bytes) -> bytearray:
        derived.append(derive(key, label))
        assert any(derived[-1])
        return derived[-1]

    def fail(_: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(EpochKey, "_derived", noted)
    if fails:
        monkeypatch.setattr(source._decoding, "prepare", fail)
        with pytest.raises(ZeroDivisionError):
            source.make(key(1), NONE)
    else:
        source.make(key(1), NONE)
    assert len(derived) == 1
    assert not any(map(any, derived))


def test_wrong_decoder_is_another_mask_s_and_another_one_each_time(
    fresh_bundle: Bundle,
) -> None:
    right = FreshSource(fresh_bundle).make(key(3), NONE)
    source = FreshSource(fresh_bundle, wrong_decoder=True)
    wrong = [source.make(key(3), NONE) for _ in range(2)]
    measurement = a_measurement(fresh_bundle, right.levels)
    answers = [mask.reader.classify(measurement).scores for mask in (right, *wrong)]
    assert all(np.array_equal(right.levels, mask.levels) for mask in wrong)
    assert all(one != other for one, other in zip(answers, [*answers[1:], answers[0]], strict=True))


def test_bundle_that_cannot_be_decoded_is_found_at_the_start(fresh_bundle: Bundle) -> None:
    with pytest.raises(StartError, match=r"statistics\.pixels"):
        FreshSource(dataclasses.replace(fresh_bundle, scene=Scene(10, 10)))
    with pytest.raises(ValueError, match="has no key policy"):
        FreshSource(dataclasses.replace(fresh_bundle, mode="pairs", fresh=None))


@pytest.mark.slow
def test_simulated_light_can_be_decoded(
    fresh_bundle: Bundle,
) -> None:
    """The light takes the grid path, decoding the transfer operator: neither knows the other."""
    camera, embedding = Camera(), EmbeddingSize(24, 32)
    digits = load_digits().images[:400] / np.float32(255)
    assert fresh_bundle.fresh is not None
    fresh = dataclasses.replace(
        fresh_bundle.fresh,
        distribution=MaskDistribution.uniform(camera),
        statistics=fit_statistics([digits[5:]], 150),
    )
    bundle = dataclasses.replace(fresh_bundle, camera=camera, embedding=embedding, fresh=fresh)
    light = GridLight(camera, bundle.scene, oversampling=1, dtype=torch.float32)

    def likeness(source: FreshSource) -> float:
        total = 0.0
        for counter, digit in enumerate(digits[:5]):
            mask = source.make(key(counter), frozenset())
            psf = light.psf(torch.from_numpy(to_weights(mask.levels, camera.panel)))
            seen = light.embed(torch.from_numpy(digit), psf, embedding)
            reader = mask.reader
            assert isinstance(reader, FreshReader)
            estimate = reader.decoder(seen[None].numpy())[0]
            total += float(np.corrcoef(estimate.ravel(), digit.ravel())[0, 1])
        return total / 5

    assert likeness(FreshSource(bundle)) > 0.9
    assert likeness(FreshSource(bundle, wrong_decoder=True)) < 0.5


@pytest.mark.anyio
async def test_answers_tell_their_form(running: Running, fresh_bench: Bench) -> None:
    async with running(on=fresh_bench, policy=PER_CAPTURE) as client:
        status = Status.model_validate_json((await client.get("/v1/status")).content)
        assert (status.release, status.bundle.mode, status.bundle.pairs) == ("raw", "fresh", 0)
        capture = Capture.model_validate_json((await client.post("/v1/captures")).content)
        assert isinstance(capture.embedding, Embedding)
        assert capture.embedding.form == "raw"
        answer = await client.post("/v1/classifications", json={"include_embedding": True})
        result = Classification.model_validate_json(answer.content)
        assert result.embedding is not None
        assert result.embedding.form == "raw"
        assert capture.epoch != result.epoch


@pytest.mark.anyio
async def test_no_mask_leaves(
    running: Running, fresh_bench: Bench, capsys: pytest.CaptureFixture[str]
) -> None:
    left = ""
    async with running(on=fresh_bench, policy=PER_CAPTURE, raising=False) as client:
        for fault in (None, RuntimeError("no answer")):
            fresh_bench.display.faults = [fault]
            for path in ("captures", "classifications", "rotation/advance"):
                left += (await client.post(f"/v1/{path}")).text
            for path in ("status", "rotation"):
                left += (await client.get(f"/v1/{path}")).text
        await asyncio.sleep(0)
    left += "".join(capsys.readouterr()) + repr(fresh_bench.source)
    numbers = " ".join(re.findall(r"\d+", left))
    for levels in fresh_bench.display.shown:
        for row in levels:
            if row.any():
                assert " ".join(str(level) for level in row) not in numbers


def test_secrets_stay_out_of_representations(fresh_bench: Bench) -> None:
    camera = fresh_bench.camera()
    captured = camera.capture(release=True)
    epoch = camera.preparation.take()
    for thing in (captured, captured.reader, epoch, epoch.mask, fresh_bench.source):
        shown = repr(thing)
        assert "tensor" not in shown
        assert "array" not in shown
    epoch.retire()
    camera.stop()
