"""Mode fresh in the engine: masks of the key, readers of the masks, forms of embeddings."""

from __future__ import annotations

import asyncio
import dataclasses
import re
from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch

from veilcam_client import SceneDecoder, VeilcamError
from veilcam_client.wire.captures import Capture, Classification
from veilcam_client.wire.rotation import EveryCaptures
from veilcam_client.wire.status import Status
from veilcam_optics.camera.geometry import Camera, Embedding
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.decoding import Decoder, fit_statistics, write_frame
from veilcam_optics.decoding.release import ReleaseForm, Whitening, recover
from veilcam_optics.errors import OpticsError
from veilcam_optics.keys.epoch_names import EpochNames
from veilcam_optics.keys.masks import MaskDistribution, Secret, epoch_levels
from veilcam_optics.transfer.grid import GridLight
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_server.demo_data import load_digits
from veilcam_server.devices import SensorError
from veilcam_server.errors import StartError
from veilcam_server.masks.fresh import FreshReader, FreshSource
from veilcam_training.bundle import Bundle, build_classifier, classifier_inputs

pytestmark = pytest.mark.numerical

if TYPE_CHECKING:
    from pathlib import Path

    from tests.server.conftest import Bench, Running

PER_CAPTURE = EveryCaptures(captures=1)


def levels_of(bundle: Bundle, secret: Secret, counter: int) -> np.ndarray:
    assert bundle.fresh is not None
    return epoch_levels(
        secret,
        bundle.fresh.device,
        counter,
        camera=bundle.camera,
        distribution=bundle.fresh.distribution,
    )


def decoder_of(bundle: Bundle, levels: np.ndarray) -> Decoder:
    assert bundle.fresh is not None
    decoding = bundle.fresh.frame(bundle.camera, bundle.scene, bundle.embedding).decoding()
    return decoding.prepare(to_weights(levels, bundle.camera.panel))


def counter_of(bundle: Bundle, secret: Secret, name: str) -> int:
    assert bundle.fresh is not None
    return EpochNames(secret, bundle.fresh.device).counter(name)


def a_measurement(bundle: Bundle, levels: np.ndarray, seed: int = 0) -> np.ndarray:
    operator = TransferOperator(bundle.camera, bundle.scene, bundle.embedding)
    scene = torch.rand(1, *bundle.scene.shape, generator=torch.Generator().manual_seed(seed))
    weights = to_weights(levels, bundle.camera.panel)
    measurement: np.ndarray = operator.embed(scene, weights)[0].numpy()
    return measurement


def test_every_capture_has_the_mask_of_its_own_epoch(
    fresh_bench: Bench, fresh_bundle: Bundle, secret: Secret
) -> None:
    camera = fresh_bench.camera(policy=PER_CAPTURE)
    counters = []
    for _ in range(8):
        captured = camera.capture()
        counters.append(counter_of(fresh_bundle, secret, captured.epoch))
        expected = levels_of(fresh_bundle, secret, counters[-1])
        np.testing.assert_array_equal(fresh_bench.display.shown[-1], expected)
    assert counters == sorted(set(counters))
    camera.preparation.close()


def test_the_label_is_what_decoder_and_network_make_of_the_measurement(
    fresh_bench: Bench, fresh_bundle: Bundle, secret: Secret
) -> None:
    fresh = fresh_bundle.fresh
    assert fresh is not None
    network = build_classifier(fresh.layers, fresh.weights)
    camera = fresh_bench.camera(policy=PER_CAPTURE)
    scores = []
    for _ in range(3):
        captured = camera.capture()
        levels = levels_of(fresh_bundle, secret, counter_of(fresh_bundle, secret, captured.epoch))
        decoder = decoder_of(fresh_bundle, levels)
        measurement = a_measurement(fresh_bundle, levels)
        inputs = classifier_inputs(decoder, torch.from_numpy(measurement)[None], fresh.features)
        expected = network(inputs).double().softmax(dim=1)[0]
        verdict = captured.reader.classify(measurement)
        np.testing.assert_allclose(list(verdict.scores.values()), expected, atol=1e-5)
        scores.append(verdict.scores)
    camera.preparation.close()


@pytest.mark.parametrize("form", ["white", "raw", "flat"])
def test_who_has_the_secret_decodes_what_was_released(
    fresh_bundle: Bundle, secret: Secret, form: str
) -> None:
    assert form in ("white", "raw", "flat")
    source = FreshSource(fresh_bundle, secret, form=form)  # type: ignore[arg-type]
    name = source.name(17)
    mask = source.make(17, "")
    measurement = a_measurement(fresh_bundle, mask.levels)
    released = mask.reader.release(measurement, form)  # type: ignore[arg-type]
    assert released.shape == measurement.shape
    assert released.dtype == np.float32
    # Elsewhere: the name, the secret and the released numbers are all there is.
    levels = levels_of(fresh_bundle, secret, counter_of(fresh_bundle, secret, name))
    decoder = decoder_of(fresh_bundle, levels)
    recovered = recover(
        torch.from_numpy(released)[None], ReleaseForm(form), decoder, Whitening(decoder, levels)
    )
    tolerance = 1e-4 * float(measurement.max())
    if form == "flat":
        exposure = measurement.sum() / float(decoder.mean_measurement.sum())
        np.testing.assert_allclose(recovered[0] * exposure, measurement, atol=tolerance)
        assert not np.allclose(recovered[0], measurement, atol=10 * tolerance)
    else:
        np.testing.assert_allclose(recovered[0], measurement, atol=tolerance)


def test_forms_differ(fresh_bundle: Bundle, secret: Secret) -> None:
    mask = FreshSource(fresh_bundle, secret, form="white").make(1, "")
    measurement = a_measurement(fresh_bundle, mask.levels)
    raw, flat, white = (mask.reader.release(measurement, form) for form in ("raw", "flat", "white"))
    assert np.array_equal(raw, measurement)
    assert np.abs(flat).sum() < 0.5 * np.abs(raw).sum()
    assert np.abs(white).max() > 10 * np.abs(raw).max()
    with pytest.raises(ValueError, match="make the source for white"):
        FreshSource(fresh_bundle, secret).make(1, "").reader.release(measurement, "white")


def test_a_measurement_without_light_has_no_exposure(fresh_bundle: Bundle, secret: Secret) -> None:
    mask = FreshSource(fresh_bundle, secret, form="flat").make(1, "")
    with pytest.raises(SensorError, match="no light"):
        mask.reader.release(np.zeros(fresh_bundle.embedding.shape, np.float32), "flat")


def test_another_device_or_secret_has_other_masks_and_names(
    fresh_bundle: Bundle, secret: Secret
) -> None:
    own = FreshSource(fresh_bundle, secret)
    same = FreshSource(fresh_bundle, Secret(secret.reveal()), device="test camera")
    others = [
        FreshSource(fresh_bundle, secret, device="another"),
        FreshSource(fresh_bundle, Secret.generate()),
    ]
    assert np.array_equal(own.make(5, "").levels, same.make(5, "").levels)
    assert own.name(5) == same.name(5)
    for other in others:
        assert not np.array_equal(own.make(5, "").levels, other.make(5, "").levels)
        assert own.name(5) != other.name(5)
    with pytest.raises(StartError, match="device"):
        FreshSource(fresh_bundle, secret, device="x" * 256)


def test_the_wrong_decoder_is_another_mask_s(fresh_bundle: Bundle, secret: Secret) -> None:
    right = FreshSource(fresh_bundle, secret).make(3, "")
    wrong = FreshSource(fresh_bundle, secret, wrong_decoder=True).make(3, "")
    assert np.array_equal(right.levels, wrong.levels)
    measurement = a_measurement(fresh_bundle, right.levels)
    assert right.reader.classify(measurement).scores != wrong.reader.classify(measurement).scores


@pytest.mark.slow
def test_what_the_simulated_light_gives_can_be_decoded(
    fresh_bundle: Bundle, secret: Secret
) -> None:
    """The light takes the grid path, decoding the transfer operator: neither knows the other."""
    camera, embedding = Camera(), Embedding(24, 32)
    digits = load_digits().images[:400] / np.float32(255)
    assert fresh_bundle.fresh is not None
    fresh = dataclasses.replace(
        fresh_bundle.fresh,
        distribution=MaskDistribution.uniform(camera),
        statistics=fit_statistics([torch.from_numpy(digits[5:])], 150),
    )
    bundle = dataclasses.replace(fresh_bundle, camera=camera, embedding=embedding, fresh=fresh)
    light = GridLight(camera, bundle.scene, oversampling=1, dtype=torch.float32)

    def likeness(source: FreshSource) -> float:
        total = 0.0
        for counter, digit in enumerate(digits[:5]):
            mask = source.make(counter, "")
            psf = light.psf(to_weights(mask.levels, camera.panel))
            seen = light.embed(torch.from_numpy(digit), psf, embedding)
            reader = mask.reader
            assert isinstance(reader, FreshReader)
            estimate = reader.decoder(seen[None])[0].numpy()
            total += float(np.corrcoef(estimate.ravel(), digit.ravel())[0, 1])
        return total / 5

    assert likeness(FreshSource(bundle, secret)) > 0.9
    assert likeness(FreshSource(bundle, secret, wrong_decoder=True)) < 0.5


def test_epoch_names_are_a_cipher_of_the_counter(secret: Secret) -> None:
    names = EpochNames(secret, "a")
    counters = [0, 1, 2, 2**32, 2**63, 2**64 - 1]
    made = [names.name(counter) for counter in counters]
    assert all(re.fullmatch(r"[0-9a-f]{32}", name) for name in made)
    assert [names.counter(name) for name in made] == counters
    # Neighbours have nothing in common, and the wrong key gives a number like any other.
    differing = bin(int(made[0], 16) ^ int(made[1], 16)).count("1")
    assert 30 < differing < 98
    assert EpochNames(secret, "b").counter(made[0]) not in counters
    assert EpochNames(Secret.generate(), "a").counter(made[0]) not in counters
    for bad in ("", "0" * 31, "G" * 32, made[0].upper() + "\n"):
        with pytest.raises(OpticsError, match="32 hexadecimal digits"):
            names.counter(bad)


def test_epoch_names_have_a_test_vector(secret: Secret) -> None:
    # As of version 1; a change would leave what was released before without its decoder.
    assert EpochNames(secret, "test camera").name(1) == "033a36e6a2b17859f817c63c7ee5bfe3"


@pytest.mark.anyio
async def test_answers_tell_their_form(running: Running, fresh_bench: Bench) -> None:
    async with running(on=fresh_bench, policy=PER_CAPTURE) as client:
        status = Status.model_validate_json((await client.get("/v1/status")).content)
        assert (status.release, status.bundle.mode, status.bundle.pairs) == ("white", "fresh", 0)
        capture = Capture.model_validate_json((await client.post("/v1/captures")).content)
        assert capture.embedding.form == "white"
        assert not np.array_equal(np.asarray(capture), fresh_bench.sensor.measurement)
        npy = await client.post("/v1/captures", headers={"Accept": "application/x-npy"})
        assert npy.headers["veilcam-form"] == "white"
        answer = await client.post("/v1/classifications", json={"include_embedding": True})
        result = Classification.model_validate_json(answer.content)
        assert result.embedding is not None
        assert result.embedding.form == "white"
        assert len({capture.epoch, npy.headers["veilcam-epoch"], result.epoch}) == 3


@pytest.mark.anyio
async def test_the_sdk_decodes_what_was_released_with_the_secret_alone(
    running: Running,
    fresh_bench: Bench,
    fresh_bundle: Bundle,
    secret: Secret,
    tmp_path: Path,
) -> None:
    fresh = fresh_bundle.fresh
    assert fresh is not None
    frame = tmp_path / "frame.safetensors"
    write_frame(frame, fresh.frame(fresh_bundle.camera, fresh_bundle.scene, fresh_bundle.embedding))
    for name, each in (("mine", secret), ("other", Secret.generate())):
        (tmp_path / name).write_text(each.reveal().hex())
        (tmp_path / name).chmod(0o600)
    async with running(on=fresh_bench, policy=PER_CAPTURE) as client:
        capture = Capture.model_validate_json((await client.post("/v1/captures")).content)
        plain = Classification.model_validate_json(
            (await client.post("/v1/classifications")).content
        )
    levels = levels_of(fresh_bundle, secret, counter_of(fresh_bundle, secret, capture.epoch))
    measurement = torch.from_numpy(fresh_bench.sensor.measurement)[None]
    expected = decoder_of(fresh_bundle, levels)(measurement)[0].numpy()
    scene = SceneDecoder(frame, tmp_path / "mine", device=fresh.device).decode(capture)
    np.testing.assert_allclose(scene, expected, atol=1e-4 * np.abs(expected).max())
    noise = SceneDecoder(frame, tmp_path / "other", device=fresh.device).decode(capture)
    assert np.abs(noise - expected).max() > 0.1 * np.abs(expected).max()
    with pytest.raises(VeilcamError, match="include_embedding"):
        SceneDecoder(frame, tmp_path / "mine", device=fresh.device).decode(plain)
    with pytest.raises(VeilcamError, match="check the path"):
        SceneDecoder(tmp_path / "nothing", tmp_path / "mine", device=fresh.device)


@pytest.mark.anyio
async def test_nothing_leaves_where_nothing_is_released(
    running: Running, fresh_bench: Bench
) -> None:
    fresh_bench.release = "none"
    async with running(on=fresh_bench) as client:
        for path, body in (("captures", None), ("classifications", {"include_embedding": True})):
            answer = await client.post(f"/v1/{path}", json=body)
            assert answer.status_code == 403
            assert answer.json()["code"] == "embedding_withheld"
        assert fresh_bench.sensor.captures == 0
        assert (await client.post("/v1/classifications")).json()["embedding"] is None
        assert (await client.get("/v1/status")).json()["release"] == "none"


@pytest.mark.anyio
async def test_a_measurement_without_light_is_a_problem_of_the_sensor(
    running: Running, fresh_bench: Bench
) -> None:
    fresh_bench.release = "flat"
    async with running(on=fresh_bench) as client:
        fresh_bench.sensor.measurement = np.zeros_like(fresh_bench.sensor.measurement)
        assert (await client.post("/v1/captures")).json()["code"] == "sensor_failed"


@pytest.mark.anyio
async def test_neither_masks_nor_the_secret_leave(
    running: Running,
    fresh_bench: Bench,
    fresh_bundle: Bundle,
    secret: Secret,
    capsys: pytest.CaptureFixture[str],
) -> None:
    left = ""
    async with running(on=fresh_bench, policy=PER_CAPTURE, raising=False) as client:
        for fault in (None, RuntimeError(secret.reveal().hex())):
            fresh_bench.display.faults = [fault]
            for path in ("captures", "classifications", "rotation/advance"):
                left += (await client.post(f"/v1/{path}")).text
            for path in ("status", "rotation"):
                left += (await client.get(f"/v1/{path}")).text
        await asyncio.sleep(0)
    left += "".join(capsys.readouterr()) + repr(fresh_bench.source)
    assert secret.reveal().hex()[:16] not in left
    numbers = " ".join(re.findall(r"\d+", left))
    for levels in fresh_bench.display.shown:
        for row in levels:
            if row.any():
                assert " ".join(str(level) for level in row) not in numbers


def test_secrets_stay_out_of_representations(fresh_bench: Bench) -> None:
    camera = fresh_bench.camera()
    captured = camera.capture()
    prepared = camera.preparation.take()
    for thing in (captured, captured.reader, prepared, prepared.mask, fresh_bench.source):
        shown = repr(thing)
        assert "tensor" not in shown
        assert "array" not in shown
        assert "test camera" not in shown
    camera.preparation.close()
