"""A keyring: several pairs of mask and classifier, each from a seed of its own, in one bundle."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from statistics import mean

import torch
from pydantic import JsonValue

from veilcam_optics.camera.geometry import Camera
from veilcam_training.bundle import Accuracy, Bundle
from veilcam_training.data import Images, Source
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.executors import HERE, Executor
from veilcam_training.experiments.fit import Outcome, Settings, as_pair, make_model, run_job
from veilcam_training.experiments.records import provenance
from veilcam_training.seeding import derive
from veilcam_training.trainer.loop import Observer


def fit_keyring(
    settings: Settings,
    pairs: int,
    source: Source,
    camera: Camera,
    *,
    device: torch.device | str = "cpu",
    work: Path | None = None,
    workers: Executor = HERE,
    observe: Callable[[int], Sequence[Observer]] = lambda _: (),
    fitted: Callable[[int, Outcome], None] = lambda *_: None,
) -> Bundle:
    """Fit ``pairs`` pairs and put them into one bundle.

    Args:
        settings: of every pair; pair 0 has their seed, the others have seeds derived from it.
        pairs: how many.
        source: the data set.
        camera: the device.
        device: that computes.
        work: folder for one checkpoint per pair, so that a broken-off run is taken up again.
        workers: fit the pairs; what comes out is the same, given as many threads.
        observe: gives the observers of pair ``i``, which go with it to its worker: none that cannot
            be pickled, if that is another process.
        fitted: told of each pair as it is done.

    Raises:
        TrainingError: settings or data that cannot be used.
    """
    if pairs < 1:
        raise TrainingError(f"pairs = {pairs} is not valid: use at least 1")
    check_pairs(settings, source, camera)
    seeds = [settings.seed, *(derive(settings.seed, "pair", i) for i in range(1, pairs))]
    tasks = [
        _Task(
            settings.model_copy(update={"seed": seed}),
            None if work is None else work / f"pair-{index}.checkpoint",
            observe(index),
        )
        for index, seed in enumerate(seeds)
    ]
    outcomes: dict[int, Outcome] = {}
    for index, outcome in workers.run(_Fitter(source, camera, device), tasks):
        outcomes[index] = outcome
        fitted(index, outcome)
    return as_bundle([outcomes[index] for index in range(pairs)], source, camera)


def check_pairs(settings: Settings, source: Source, camera: Camera) -> None:
    """Refuse before the fit, rather than after hours, what no bundle can hold.

    Raises:
        TrainingError: settings that cannot be used, or that no device can.
    """
    _check_reading(settings)
    as_pair(make_model(settings, source, camera))


def _check_reading(settings: Settings) -> None:
    if settings.reading == "point":
        raise TrainingError(
            "reading 'point' is for comparison alone, a device averages over its pixels: "
            "use reading 'area', or leave out --out"
        )


@dataclass(frozen=True)
class _Task:
    """One pair."""

    settings: Settings
    checkpoint: Path | None
    observers: Sequence[Observer]


@dataclass(frozen=True)
class _Fitter:
    """Fits pairs; every worker has its own and reads the training set once."""

    source: Source
    camera: Camera
    device: torch.device | str

    @cached_property
    def training(self) -> Images:
        return self.source.training()

    def __call__(self, task: _Task) -> Outcome:
        outcome = run_job(
            task.settings,
            self.source,
            self.camera,
            training=self.training,
            device=self.device,
            checkpoint=task.checkpoint,
            observers=task.observers,
        )
        outcome.fit.model.cpu()  # who collects may have no GPU
        return outcome


def as_bundle(outcomes: Sequence[Outcome], source: Source, camera: Camera) -> Bundle:
    """Bundle of fitted pairs that differ in their seeds alone; the accuracy is their mean.

    Raises:
        TrainingError: pairs that no device can use.
    """
    settings, first = outcomes[0].settings, outcomes[0].accuracy
    _check_reading(settings)
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
