"""A fit for fresh masks: what it learns, what it leaves, and the bundle made of it."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import torch

from veilcam_optics.camera.geometry import Camera, Window
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.keys.masks import MaskDistribution, draw_levels
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_training.bundle import classifier_inputs, read_bundle, write_bundle
from veilcam_training.config.recipes import SCENES
from veilcam_training.config.settings import FitSettings, FreshMasks
from veilcam_training.data import Source, open_source
from veilcam_training.encoders.fresh import Misalignment
from veilcam_training.errors import TrainingError
from veilcam_training.experiments import fit as fitting
from veilcam_training.experiments.fit import FreshResult, run_fresh
from veilcam_training.experiments.keyring import as_fresh_bundle
from veilcam_training.models.network import build_classifier
from veilcam_training.trainer.step import evaluate

CAMERA = Camera(window=Window(rows=18, columns=9))


def settings(
    epochs: int = 3, batch: int = 64, spread: float | None = None, seed: int = 0
) -> FitSettings:
    small = {"rank": 40, "epochs": epochs, "batch": batch, "rate": 0.2, "averaging": 0.9}
    masks = FreshMasks(
        misalignment=Misalignment(panels=2), masks=20, validation_masks=10, spread=spread
    )
    chosen = FitSettings(embedding="6x8", classifier="Scene4", fresh=masks, seed=seed)
    return chosen.model_copy(update={**SCENES, **small})


@pytest.fixture(scope="module")
def fitted(
    source: Source, tmp_path_factory: pytest.TempPathFactory
) -> tuple[FreshResult, FreshResult]:
    """A fit with learned ranges, and the same again from its work folder."""
    chosen, work = settings(epochs=6, spread=0.4), tmp_path_factory.mktemp("work")
    one, again = (run_fresh(chosen, source, CAMERA, work=work, masks=50) for _ in range(2))
    return one, again


@pytest.mark.slow
def test_fit_learns_to_read_behind_new_masks(fitted: tuple[FreshResult, FreshResult]) -> None:
    result, again = fitted
    assert result.masks == 50
    # Ten classes: chance is 0.1.
    assert result.accuracy.value > 0.5
    first, *_, last = result.fit.history
    assert last.validation_accuracy > first.validation_accuracy + 0.3
    # A decoder of another mask reads less. Two shares of 100 scenes differ by 0.2 in three standard
    # deviations at most.
    assert result.wrong_key_accuracy < result.accuracy.value - 0.2
    # Nothing is left to do, and the same comes of it.
    assert again.accuracy == result.accuracy
    one, other = result.camera.distribution, again.camera.distribution
    assert np.array_equal(one.lowest, other.lowest)
    assert np.array_equal(one.highest, other.highest)
    assert 0 < one.bits < MaskDistribution.power(CAMERA, 1.0).bits


@pytest.mark.slow
def test_bundle_classifies_behind_a_mask_from_its_key_policy(
    source: Source, fitted: tuple[FreshResult, FreshResult], tmp_path: Path
) -> None:
    result, _ = fitted
    write_bundle(tmp_path / "a.veilcam", as_fresh_bundle(result, source, CAMERA))
    bundle = read_bundle(tmp_path / "a.veilcam")
    fresh = bundle.fresh
    assert fresh is not None
    assert bundle.accuracy == result.accuracy
    assert np.array_equal(fresh.distribution.lowest, result.camera.distribution.lowest)
    levels = draw_levels(os.urandom(32), camera=CAMERA, distribution=fresh.distribution)
    weights = torch.from_numpy(to_weights(levels, CAMERA.panel))
    decoder = (
        fresh.frame(CAMERA, bundle.scene, bundle.embedding).in_torch().decoding().prepare(weights)
    )
    test = source.test()
    clean = TransferOperator(CAMERA, bundle.scene, bundle.embedding).embed(test.scenes(), weights)
    measurements = shot_noise(clean, 40.0, torch.Generator().manual_seed(0))
    classifier = build_classifier(fresh.layers, fresh.weights)
    predicted = classifier(classifier_inputs(decoder, measurements)).argmax(1)
    assert float((predicted == test.labels).float().mean()) > 0.6


def test_statistics_of_another_fit_are_refused(
    monkeypatch: pytest.MonkeyPatch, source: Source, plain_folder: Path, tmp_path: Path
) -> None:
    work = tmp_path / "work"

    class StopError(Exception):
        pass

    def stop(*_: object, **__: object) -> None:
        raise StopError

    monkeypatch.setattr(fitting, "fit", stop)  # before there is a checkpoint of the fit
    with pytest.raises(StopError):
        run_fresh(settings(batch=16), source, CAMERA, work=work)
    (left,) = work.iterdir()
    assert left.name == "statistics.checkpoint"
    other = open_source("mnist", plain_folder)
    for chosen, data in ((settings(batch=16), other), (settings(batch=16, seed=1), source)):
        with pytest.raises(TrainingError, match=f"{left} is of another fit"):
            run_fresh(chosen, data, CAMERA, work=work)
    # Those of the same fit are not made again.
    monkeypatch.setattr(fitting, "fresh_statistics", None)
    with pytest.raises(StopError):
        run_fresh(settings(batch=16), source, CAMERA, work=work)


@pytest.mark.slow
def test_masks_of_a_test_change_what_is_seen(source: Source) -> None:
    model = run_fresh(settings(epochs=1), source, CAMERA, masks=5).fit.model
    few, many = (evaluate(model, source.test(), 0, "x", batches=masks) for masks in (2, 50))
    assert few.loss != many.loss
    for masks in (0, 101):
        with pytest.raises(TrainingError, match=f"masks = {masks} is not valid: use 1 to 100"):
            evaluate(model, source.test(), 0, "x", batches=masks)
