"""One classifier for a stream of masks: it learns, repeats, resumes, and its options matter."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch.nn.functional import avg_pool2d
from typer.testing import CliRunner

from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Sensor, Window
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.decoding import read_frame
from veilcam_optics.decoding.release import ReleaseForm
from veilcam_optics.keys.masks import Secret, epoch_levels
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_training.attacks.clustering import adjusted_rand_index, k_means, subspace_clusters
from veilcam_training.attacks.keyless import KeylessCamera
from veilcam_training.bundle import build_classifier, classifier_inputs, read_bundle, write_bundle
from veilcam_training.cli.main import app
from veilcam_training.config.fresh import (
    TASKS,
    FreshSettings,
    Misalignment,
    find_settings,
)
from veilcam_training.data import Source, open_source, split
from veilcam_training.encoders.fresh import CHANNELS, FreshCamera, pooled, scene_statistics
from veilcam_training.encoders.learned_levels import LearnedRange
from veilcam_training.errors import TrainingError
from veilcam_training.experiments import fresh as job
from veilcam_training.experiments.fresh import as_fresh_bundle, run_fresh
from veilcam_training.models.fresh import make_fresh_layers, multiplications
from veilcam_training.trainer.fresh_evaluation import evaluate_fresh
from veilcam_training.trainer.fresh_loop import FreshFit, fit_fresh

CAMERA = Camera(window=Window(rows=18, columns=9))
FEW = Misalignment(panels=2)


def settings(**changes: Any) -> FreshSettings:
    small: dict[str, Any] = {
        "embedding": "6x8",
        "rank": 40,
        "misalignment": FEW,
        "classifier": "CNN4",
        "epochs": 3,
        "batch": 64,
        "masks": 4,
        "renewed": 2,
        "rate": 1e-2,
        "averaging": 0.9,
        "validation_masks": 10,
    }
    return FreshSettings(**{**small, **changes})


def make_camera(source: Source, chosen: FreshSettings) -> FreshCamera:
    training = split(source.training()).training
    statistics = scene_statistics(chosen, CAMERA, source.scene, training)
    return FreshCamera(chosen, CAMERA, source.scene, statistics)


def run(source: Source, chosen: FreshSettings, **options: Any) -> FreshFit:
    camera = make_camera(source, chosen)
    layers = make_fresh_layers(chosen.classifier, CHANNELS, camera.scene, 10, centred=True)
    return fit_fresh(camera, layers, split(source.training()), **options)


def weights_of(fit: FreshFit) -> torch.Tensor:
    return torch.cat([tensor.flatten().double() for tensor in fit.classifier.state_dict().values()])


@pytest.fixture(scope="module")
def reference(source: Source) -> FreshFit:
    return run(source, settings())


def test_it_learns_and_serves_a_new_mask_for_every_capture(source: Source) -> None:
    outcome = run_fresh(settings(epochs=6), source, CAMERA)
    assert outcome.test.masks == 100
    assert outcome.test.accuracy > 0.9
    assert outcome.fit.history[-1].loss < 0.7 * outcome.fit.history[0].loss
    # With a decoder of another mask little is left, even of a task as coarse as this one.
    assert outcome.wrong_key.accuracy < outcome.test.accuracy - 0.3


def test_the_bundle_classifies_behind_a_mask_from_its_key_policy(
    source: Source, tmp_path: Path
) -> None:
    chosen = settings(epochs=6, spread=0.4)
    outcome = run_fresh(chosen, source, CAMERA, work=tmp_path / "work", masks=10)
    write_bundle(
        tmp_path / "a.veilcam", as_fresh_bundle(outcome, source, CAMERA, device="test camera")
    )
    bundle = read_bundle(tmp_path / "a.veilcam")
    fresh = bundle.fresh
    assert fresh is not None
    assert bundle.accuracy is not None
    assert bundle.accuracy.value == outcome.test.accuracy
    secret = Secret.generate()
    levels = epoch_levels(secret, fresh.device, 3, camera=CAMERA, distribution=fresh.distribution)
    weights = to_weights(levels, CAMERA.panel)
    decoder = fresh.frame(CAMERA, bundle.scene, bundle.embedding).decoding().prepare(weights)
    test = source.test()
    clean = TransferOperator(CAMERA, bundle.scene, bundle.embedding).embed(test.scenes(), weights)
    readings = shot_noise(clean, 40.0, torch.Generator().manual_seed(0))
    classifier = build_classifier(fresh.layers, fresh.weights)
    predicted = classifier(classifier_inputs(decoder, readings, fresh.features)).argmax(1)
    assert float((predicted == test.labels).float().mean()) > 0.8
    # Nothing is left to do, and the same comes of it.
    again = run_fresh(chosen, source, CAMERA, work=tmp_path / "work", masks=10)
    assert again.test.accuracy == outcome.test.accuracy


def test_the_command_writes_a_bundle(digit_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "fresh.veilcam"
    command = ["fit-fresh", "--data", str(digit_folder), "--out", str(out), "--device", "hall"]
    result = CliRunner().invoke(
        app, [*command, "--task", "mnist_3x4", "--epochs", "1", "--masks", "5", "--seed", "2"]
    )
    assert result.exit_code == 0, result.output
    assert "on 5 unseen masks" in result.output
    bundle = read_bundle(out)
    assert bundle.fresh is not None
    assert bundle.fresh.device == "hall"
    assert bundle.provenance["settings"]["seed"] == 2  # type: ignore[index,call-overload]
    assert bundle.embedding == Embedding(3, 4)
    frame = tmp_path / "frame.safetensors"
    result = CliRunner().invoke(app, ["frame", str(out), str(frame)])
    assert result.exit_code == 0, result.output
    assert "'hall'" in result.output
    assert read_frame(frame).embedding == bundle.embedding
    for refused, reason in (
        ([*command[:4], str(tmp_path / "fresh.zip")], "use a name that ends in .veilcam"),
        ([*command, "--epochs", "0"], "epochs is not valid: Input should be greater"),
        ([*command, "--seed", "-1"], "seed is not valid: Input should be greater"),
        (["frame", str(out), str(tmp_path / "a.zip")], "a name that ends in .safetensors"),
        (["frame", str(out), str(out / "a.safetensors")], f"make the folder {out} first"),
    ):
        error = CliRunner().invoke(app, refused).exception
        assert isinstance(error, TrainingError)
        assert reason in str(error)


def test_statistics_of_another_fit_are_refused(
    monkeypatch: pytest.MonkeyPatch, source: Source, plain_folder: Path, tmp_path: Path
) -> None:
    work = tmp_path / "work"

    class StopError(Exception):
        pass

    def stop(*_: object, **__: object) -> None:
        raise StopError

    monkeypatch.setattr(job, "fit_fresh", stop)  # before there is a checkpoint of the fit
    with pytest.raises(StopError):
        run_fresh(settings(), source, CAMERA, work=work)
    (left,) = work.iterdir()
    assert left.name == "statistics.checkpoint"
    other = open_source("mnist", plain_folder)
    for chosen, data in ((settings(), other), (settings(seed=1), source)):
        with pytest.raises(TrainingError, match=f"{left} is of another fit"):
            run_fresh(chosen, data, CAMERA, work=work)
    # Those of the same fit are not made again.
    monkeypatch.setattr(job, "scene_statistics", None)
    with pytest.raises(StopError):
        run_fresh(settings(), source, CAMERA, work=work)


def test_the_same_settings_give_the_same_weights(source: Source, reference: FreshFit) -> None:
    again = run(source, settings())
    assert torch.equal(weights_of(again), weights_of(reference))
    assert again.history[0].loss == reference.history[0].loss


CHANGES: list[dict[str, Any]] = [
    {"exponent": 4.0},
    {"rank": 20},
    {"snr_db": 20.0},
    {"misalignment": None},
    {"misalignment": Misalignment(shift=5e-5, panels=2)},
    {"misalignment": Misalignment(distance=2e-4, panels=2)},
    {"misalignment": Misalignment(panels=3)},
    {"model_error": 0.05},
    {"augmentation": None},
    {"epochs": 2},
    {"batch": 128},
    {"masks": 2},
    {"renewed": 4},
    {"rate": 2e-3},
    {"weight_decay": 0.5},
    {"label_smoothing": 0.3},
    {"averaging": 0.0},
    {"bfloat16": False},
    {"spread": 0.4},
    {"seed": 1},
]


@pytest.mark.parametrize("change", CHANGES, ids=lambda change: "-".join(map(str, change)))
def test_every_setting_changes_the_fit(
    source: Source, reference: FreshFit, change: dict[str, Any]
) -> None:
    other = run(source, settings(**{"epochs": 1, **change}))
    first = reference.history[0]
    if change == {"epochs": 2}:
        assert len(other.history) == 2
    assert (other.history[0].loss, other.history[0].validation_loss) != (
        first.loss,
        first.validation_loss,
    )


def test_masks_of_validation_change_what_is_seen(source: Source, reference: FreshFit) -> None:
    camera = make_camera(source, settings())
    few, many = (
        evaluate_fresh(reference.classifier, camera, source.test(), masks=masks, purpose="x")
        for masks in (2, 50)
    )
    assert few.loss != many.loss
    with pytest.raises(TrainingError, match="masks = 101"):
        evaluate_fresh(reference.classifier, camera, source.test(), masks=101, purpose="x")


def test_a_fit_is_taken_up_where_it_stood(
    source: Source, reference: FreshFit, tmp_path: Path
) -> None:
    class StopError(Exception):
        pass

    class Stopper:
        def step(self, epoch: int, done: int, steps: int) -> None:
            if (epoch, done) == (2, 3):
                raise StopError

        def epoch(self, epoch: object) -> None:
            pass

    path = tmp_path / "fit.checkpoint"
    with pytest.raises(StopError):
        run(source, settings(), checkpoint=path, fingerprint="a", observers=[Stopper()])
    resumed = run(source, settings(), checkpoint=path, fingerprint="a")
    assert torch.equal(weights_of(resumed), weights_of(reference))
    with pytest.raises(TrainingError, match="another fit"):
        run(source, settings(), checkpoint=path, fingerprint="b")


def test_a_learned_range_is_taken_up_too(source: Source, tmp_path: Path) -> None:
    chosen, path = settings(spread=0.3, epochs=2), tmp_path / "fit.checkpoint"
    whole = run(source, chosen, checkpoint=path)
    again = run(source, chosen, checkpoint=path)  # nothing is left to do
    assert np.array_equal(whole.distribution.lowest, again.distribution.lowest)
    assert np.array_equal(whole.distribution.highest, again.distribution.highest)
    assert torch.equal(weights_of(whole), weights_of(again))
    assert 0 < whole.distribution.bits < make_camera(source, settings()).distribution.bits


def test_masks_of_two_purposes_and_of_one_stream_differ(source: Source) -> None:
    camera = make_camera(source, settings(misalignment=None))
    masks = [*islice(camera.masks("a"), 3), *islice(camera.masks("b"), 3)]
    for index, one in enumerate(masks):
        for other in masks[index + 1 :]:
            assert not torch.allclose(one.transfer, other.transfer, rtol=1e-2)
    again = next(camera.masks("a"))
    assert torch.equal(again.transfer, masks[0].transfer)


def test_a_ring_replaces_its_oldest_masks(source: Source) -> None:
    camera = make_camera(source, settings(masks=4, renewed=1))
    first, second = islice(camera.rings("x"), 2)
    assert second[:3] == first[1:]
    assert second[3] is not first[3]
    with pytest.raises(TrainingError, match="divide"):
        make_camera(source, settings(masks=4, renewed=3))


@pytest.mark.parametrize("form", [ReleaseForm.RAW, ReleaseForm.FLAT, ReleaseForm.WHITE])
def test_without_a_key_one_sees_the_released_form(source: Source, form: ReleaseForm) -> None:
    chosen = settings(misalignment=None)
    known = make_camera(source, chosen).statistics
    mask = next(KeylessCamera(chosen, CAMERA, source.scene, known, form).masks("x"))
    scenes = source.test().scenes(slice(0, 40))
    readings = mask.read(scenes, torch.Generator().manual_seed(0))
    seen = mask.decode(readings)
    assert seen.shape == readings.shape
    correlation = torch.corrcoef(torch.stack([seen[0], readings[0]]))[0, 1]
    if form is ReleaseForm.RAW:
        assert torch.allclose(seen, readings / readings.mean(1, keepdim=True), rtol=1e-4)
    elif form is ReleaseForm.FLAT:
        brighter = mask.decode(2 * readings)
        assert torch.allclose(seen, brighter, atol=1e-4)
    else:
        assert abs(float(correlation)) < 0.6
        assert 0.3 < float(seen.square().mean()) < 3
    none = KeylessCamera(chosen, CAMERA, source.scene, known, ReleaseForm.NONE)
    with pytest.raises(TrainingError, match="releases nothing"):
        next(none.masks("x")).decode(readings)


def test_a_mask_is_prepared_for_the_nominal_panel_and_shown_by_a_displaced_one(
    source: Source,
) -> None:
    exact = next(make_camera(source, settings(misalignment=None)).masks("x"))
    shown = next(make_camera(source, settings()).masks("x"))
    assert torch.equal(exact.decoder.mean_reading, shown.decoder.mean_reading)
    error = (exact.transfer - shown.transfer).norm() / exact.transfer.norm()
    assert 1e-5 < float(error) < 0.05
    assert "tensor" not in repr(exact)


def test_learned_range_and_its_published_distribution_agree() -> None:
    masks = LearnedRange(CAMERA, 2.0, 0.2, torch.Generator().manual_seed(0))
    with torch.no_grad():
        masks.centre.uniform_(-0.2, 1.2, generator=torch.Generator().manual_seed(1))
    masks.project()
    assert 0 <= float(masks.centre.detach().min()) <= float(masks.centre.detach().max()) <= 1
    generator = torch.Generator().manual_seed(2)
    drawn = torch.stack([masks(generator).detach() for _ in range(400)])
    distribution = masks.distribution()
    levels = np.stack(
        [
            epoch_levels(Secret(bytes(32)), "a", e, camera=CAMERA, distribution=distribution)
            for e in range(400)
        ]
    )
    published = torch.from_numpy(levels / 63)
    assert float((drawn.mean(0) - published.mean(0)).abs().max()) < 0.1
    assert float((drawn.std(0) - published.std(0)).abs().mean()) < 0.01
    masks(generator).sum().backward()
    assert masks.centre.grad is not None
    assert bool(masks.centre.grad.isfinite().all())


def test_pooling_keeps_the_scene_and_its_size() -> None:
    scene = pooled(Scene(28, 30, 0.12), 2)
    assert scene == Scene(14, 15, 0.12)
    with pytest.raises(TrainingError, match="does not divide"):
        pooled(Scene(), 3)


def test_anywhere_is_read_and_decoded_on_the_whole_field(source: Source) -> None:
    small = replace(CAMERA, sensor=Sensor(rows=1700, columns=1550))
    chosen = settings(placement="anywhere", pooling=4, misalignment=None, rank=30)
    statistics = scene_statistics(chosen, small, source.scene, source.training())
    camera = FreshCamera(chosen, small, source.scene, statistics)
    assert camera.placement.scene.shape == (60, 56)
    assert camera.scene.shape == (15, 14)
    mask = next(camera.masks("x"))
    assert mask.transfer.shape == (60 * 56, 48)
    generator = torch.Generator().manual_seed(0)
    scenes = camera.placement(source.test().scenes(slice(0, 3)), generator)
    inputs = mask.decode(mask.read(scenes, generator))
    assert inputs.shape == (3, CHANNELS * 15 * 14)
    # The light is found where it is: estimate and scene agree on their brightest region.
    estimates = inputs[:, : 15 * 14].reshape(3, 1, 15, 14)
    seen, true = (avg_pool2d(x, 5).flatten(1) for x in (estimates, avg_pool2d(scenes[:, None], 4)))
    assert torch.equal(seen.argmax(1), true.argmax(1))


def test_layers_say_how_much_they_multiply() -> None:
    layers = make_fresh_layers("CNN32", 2, Scene(), 10, centred=True)
    first = 14 * 14 * 32 * (2 * 25 + 2 * 32 * 9)
    second = 7 * 7 * 64 * (32 * 9 + 2 * 64 * 9)
    assert multiplications(layers, 2 * 784) == first + second + 64 * 49 * 128 + 128 * 10
    anywhere = make_fresh_layers("CNN32", 2, Scene(55, 73), 10, centred=False)
    assert multiplications(anywhere, 2 * 55 * 73) > first + second
    with pytest.raises(TrainingError, match="use CNN<width>"):
        make_fresh_layers("FC800", 2, Scene(), 10, centred=True)


def test_tasks_are_valid_and_unknown_ones_refused() -> None:
    for name in TASKS:
        find_settings(name)
    assert find_settings("mnist_6x8", seed=3).seed == 3
    with pytest.raises(TrainingError, match="task 'mnist' is unknown"):
        find_settings("mnist")
    with pytest.raises(TrainingError, match="task mnist_6x8: sede is not valid"):
        find_settings("mnist_6x8", sede=3)


def test_too_few_images_are_refused(source: Source) -> None:
    with pytest.raises(TrainingError, match="do not fill a batch"):
        run(source, settings(batch=1024))


def blobs(count: int, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
    labels = torch.arange(4).repeat_interleave(count)
    centres = 10 * torch.eye(4, 6)
    return centres[labels] + torch.randn(len(labels), 6, generator=generator), labels


def test_k_means_finds_blobs() -> None:
    generator = torch.Generator().manual_seed(0)
    points, labels = blobs(50, generator)
    assert adjusted_rand_index(labels, k_means(points, 4, generator)) == 1
    same = torch.zeros(5, 3)
    assert len(k_means(same, 2, generator)) == 5
    with pytest.raises(TrainingError, match="clusters = 6"):
        k_means(same, 6, generator)


def test_subspaces_are_found_where_k_means_finds_none() -> None:
    generator = torch.Generator().manual_seed(0)
    bases = torch.linalg.qr(torch.randn(4, 30, 3, generator=generator))[0]
    points = torch.cat([torch.randn(60, 3, generator=generator) @ basis.T for basis in bases])
    labels = torch.arange(4).repeat_interleave(60)
    assert adjusted_rand_index(labels, subspace_clusters(points, 4, generator)) > 0.95
    assert adjusted_rand_index(labels, k_means(points, 4, generator)) < 0.5
    with pytest.raises(TrainingError, match="too few"):
        subspace_clusters(points[:10], 4, generator)


def test_adjusted_rand_index() -> None:
    one = torch.tensor([0, 0, 1, 1, 2, 2])
    assert adjusted_rand_index(one, (one + 1) % 3) == 1
    # Hubert and Arabie's formula by hand: 1 pair together in both, 3 and 4 in each, 15 in all.
    other = torch.tensor([0, 0, 0, 1, 1, 2])
    expected = 3 * 4 / 15
    assert adjusted_rand_index(one, other) == pytest.approx((1 - expected) / (3.5 - expected))
    generator = torch.Generator().manual_seed(0)
    labels = torch.randint(5, (2000,), generator=generator)
    assert abs(adjusted_rand_index(labels, torch.randint(5, (2000,), generator=generator))) < 0.01
    assert math.isclose(adjusted_rand_index(torch.zeros(4).long(), torch.zeros(4).long()), 1)
    with pytest.raises(TrainingError, match="groupings"):
        adjusted_rand_index(one, other[:3])
