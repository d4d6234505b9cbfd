"""One fit for fresh masks from its settings, its one look at the test set, and its bundle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from pydantic import JsonValue

from veilcam_optics.decoding import SceneStatistics, read_frame, write_frame
from veilcam_optics.geometry import Camera
from veilcam_training.bundle import Accuracy, Bundle, Fresh
from veilcam_training.data import Images, Source, split
from veilcam_training.errors import TrainingError
from veilcam_training.fitting import Observer
from veilcam_training.fresh.camera import CHANNELS, FreshCamera, scene_statistics
from veilcam_training.fresh.classifier import make_fresh_layers
from veilcam_training.fresh.evaluation import FreshEvaluation, evaluate_fresh
from veilcam_training.fresh.fitting import FreshFit, fit_fresh
from veilcam_training.fresh.settings import FreshSettings
from veilcam_training.provenance import provenance

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
    fingerprint = settings.fingerprint(source)
    statistics = _statistics(settings, source, camera, images.training, work)
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
    test = source.test()
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
    settings: FreshSettings, source: Source, camera: Camera, training: Images, work: Path | None
) -> SceneStatistics:
    """Statistics from the working folder if they are there; they take minutes for large scenes."""
    if work is None:
        return scene_statistics(settings, camera, source.scene, training)
    work.mkdir(parents=True, exist_ok=True)
    path = work / "frame.safetensors"
    if path.exists():
        statistics = read_frame(path).statistics
        if statistics.rank > settings.rank:
            raise TrainingError(
                f"{path} has rank {statistics.rank}, not {settings.rank}: remove it, "
                "or use the settings that it was made with"
            )
        return statistics
    statistics = scene_statistics(settings, camera, source.scene, training)
    write_frame(path, FreshCamera(settings, camera, source.scene, statistics).frame)
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
