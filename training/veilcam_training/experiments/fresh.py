"""One fit for fresh masks from its settings, its one look at the test set, and its bundle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from pydantic import JsonValue

from veilcam_optics.camera.geometry import Camera
from veilcam_optics.decoding import SceneStatistics
from veilcam_training.bundle import Accuracy, Bundle, Fresh
from veilcam_training.config.fresh import FreshSettings
from veilcam_training.data import Source, split
from veilcam_training.encoders.fresh import CHANNELS, FreshCamera, scene_statistics
from veilcam_training.experiments.records import provenance
from veilcam_training.models.fresh import make_fresh_layers
from veilcam_training.trainer.checkpoint import load_checkpoint, save_checkpoint
from veilcam_training.trainer.fresh_evaluation import FreshEvaluation, evaluate_fresh
from veilcam_training.trainer.fresh_loop import FreshFit, fit_fresh
from veilcam_training.trainer.loop import Observer

WRONG_KEY_IMAGES = 1000
"""Test images that are decoded with another key: enough to tell that accuracy is at chance."""


@dataclass(frozen=True)
class FreshOutcome:
    """A fit and how it does on the test set."""

    settings: FreshSettings
    camera: FreshCamera
    fit: FreshFit
    test: FreshEvaluation
    wrong_key: FreshEvaluation
    """The same, every reading decoded with the mask of another epoch."""


def run_fresh(
    settings: FreshSettings,
    source: Source,
    camera: Camera,
    *,
    masks: int | None = None,
    work: Path | None = None,
    observers: Sequence[Observer] = (),
) -> FreshOutcome:
    """Fit, select on the validation split, then look at the test set once.

    Args:
        settings: what to fit and how.
        source: the data set.
        camera: the device.
        masks: how many masks to test on; by default one for each test image.
        work: folder to leave statistics and checkpoints in; what is in it is taken up again.
        observers: told how far it has come.

    Raises:
        TrainingError: settings or data that cannot be used.
    """
    images = split(source.training())
    test = source.test()  # now, so that a bad file does not cost a fit
    fingerprint = settings.fingerprint(source)
    statistics = _statistics(
        None if work is None else work / "statistics.checkpoint",
        fingerprint,
        lambda: scene_statistics(settings, camera, source.scene, images.training),
    )
    fresh = FreshCamera(settings, camera, source.scene, statistics)
    layers = make_fresh_layers(
        settings.classifier,
        CHANNELS,
        fresh.scene,
        len(source.labels),
        centred=settings.placement == "centred",
    )
    fit = fit_fresh(
        fresh,
        layers,
        images,
        checkpoint=None if work is None else work / "fit.checkpoint",
        fingerprint=fingerprint,
        observers=observers,
    )
    right = evaluate_fresh(fit.classifier, fresh, test, masks=masks, purpose="test")
    some = test.take(torch.arange(min(len(test), WRONG_KEY_IMAGES)))
    wrong = evaluate_fresh(
        fit.classifier,
        fresh,
        some,
        masks=None if masks is None else min(masks, len(some)),
        purpose="test",
        wrong_key=True,
    )
    return FreshOutcome(settings, fresh, fit, right, wrong)


def _statistics(
    checkpoint: Path | None, fingerprint: str, make: Callable[[], SceneStatistics]
) -> SceneStatistics:
    """Statistics as they were left, if they were; they take minutes for large scenes."""
    if checkpoint is not None and (saved := load_checkpoint(checkpoint, fingerprint)) is not None:
        return SceneStatistics(**saved)
    statistics = make()
    if checkpoint is not None:
        save_checkpoint(checkpoint, fingerprint, vars(statistics))
    return statistics


def as_fresh_bundle(
    outcome: FreshOutcome, source: Source, camera: Camera, *, device: str
) -> Bundle:
    """Bundle of mode ``fresh``: no mask is in it, and one classifier for all.

    Args:
        outcome: of the fit.
        source: that it was fitted to.
        camera: that it was fitted for.
        device: name of the camera in its key schedule.
    """
    settings, fit, fresh = outcome.settings, outcome.fit, outcome.camera
    common: JsonValue = settings.model_dump(mode="json")
    record = provenance(common, source.digests())
    record["fit"] = {
        "validation_accuracy": fit.best.validation_accuracy,
        "epoch": fit.best.number + 1,
        "test_masks": outcome.test.masks,
        "wrong_key_accuracy": outcome.wrong_key.accuracy,
    }
    weights = {
        name: tensor.detach().clone(memory_format=torch.contiguous_format)
        for name, tensor in fit.classifier.state_dict().items()
    }
    samples = len(outcome.test.predictions)
    return Bundle(
        task=source.name,
        labels=source.labels,
        camera=camera,
        scene=fresh.scene,
        embedding=fresh.embedding,
        mode="fresh",
        fresh=Fresh(
            device=device,
            distribution=fit.distribution,
            statistics=fresh.statistics,
            noise=fresh.frame.noise,
            layers=fit.layers,
            weights=weights,
        ),
        provenance=record,
        accuracy=Accuracy(outcome.test.accuracy, f"{source.name} test", samples),
    )
