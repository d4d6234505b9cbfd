"""A keyring: several pairs of mask and classifier, each from a seed of its own, in one bundle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import mean

import torch
from pydantic import JsonValue

from veilcam_optics.geometry import Camera
from veilcam_training.bundle import Accuracy, Bundle
from veilcam_training.data import Source
from veilcam_training.errors import TrainingError
from veilcam_training.fitting import Observer
from veilcam_training.job import Outcome, Settings, as_pair, make_model, run_job
from veilcam_training.provenance import provenance
from veilcam_training.randomness import derive


def fit_keyring(
    settings: Settings,
    pairs: int,
    source: Source,
    camera: Camera,
    *,
    device: torch.device | str = "cpu",
    work: Path | None = None,
    observe: Callable[[int], Sequence[Observer]] = lambda _: (),
) -> Bundle:
    """Fit ``pairs`` pairs and put them into one bundle.

    Args:
        settings: of every pair; pair 0 has their seed, the others have seeds derived from it.
        pairs: how many.
        source: the data set.
        camera: the device.
        device: that computes.
        work: folder for one checkpoint per pair, so that a broken-off run is taken up again.
        observe: gives the observers of pair ``i``.

    Raises:
        TrainingError: settings or data that cannot be used.
    """
    if pairs < 1:
        raise TrainingError(f"pairs = {pairs} is not valid: use at least 1")
    as_pair(make_model(settings, source, camera))  # fails here rather than after hours
    training = source.training()
    outcomes: list[Outcome] = []
    for index in range(pairs):
        seed = settings.seed if index == 0 else derive(settings.seed, "pair", index)
        outcomes.append(
            run_job(
                settings.model_copy(update={"seed": seed}),
                source,
                camera,
                training=training,
                device=device,
                checkpoint=None if work is None else work / f"pair-{index}.checkpoint",
                observers=observe(index),
            )
        )
    return as_bundle(outcomes, source, camera)


def as_bundle(outcomes: Sequence[Outcome], source: Source, camera: Camera) -> Bundle:
    """Bundle of fitted pairs that differ in their seeds alone; the accuracy is their mean."""
    settings, first = outcomes[0].settings, outcomes[0].accuracy
    setup = outcomes[0].fit.model.encoder.setup
    common: JsonValue = settings.model_dump(mode="json", exclude={"seed"})
    record = provenance(common, source.digests())
    record["pairs"] = [
        {
            "seed": outcome.settings.seed,
            "test_accuracy": outcome.accuracy.value,
            "validation_accuracy": outcome.fit.best.validation_accuracy,
            "epoch": outcome.fit.best.number + 1,
        }
        for outcome in outcomes
    ]
    return Bundle(
        task=source.name,
        labels=source.labels,
        camera=camera,
        scene=setup.scene,
        embedding=setup.embedding,
        channels=3 if setup.colour else 1,
        mode="pairs",
        pairs=tuple(as_pair(outcome.fit.model) for outcome in outcomes),
        provenance=record,
        accuracy=Accuracy(
            mean(outcome.accuracy.value for outcome in outcomes), first.test_set, first.samples
        ),
    )
