"""Bundles of what was fitted: pairs of mask and classifier, or one classifier for fresh masks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from statistics import mean
from tempfile import TemporaryDirectory

import torch
from pydantic import JsonValue

from veilcam_optics.camera.geometry import Camera
from veilcam_training.bundle import (
    Accuracy,
    Bundle,
    BundleError,
    Fresh,
    Hiding,
    Pair,
    TransferError,
    read_bundle,
    write_bundle,
)
from veilcam_training.config.settings import FitSettings
from veilcam_training.data import Images, Source
from veilcam_training.encoders import Mask
from veilcam_training.encoders.fresh import FreshCamera
from veilcam_training.encoders.registry import WITH_PANEL
from veilcam_training.errors import TrainingError, require
from veilcam_training.experiments.executors import HERE, Executor
from veilcam_training.experiments.fit import (
    FitResult,
    FreshResult,
    check_budget,
    light_plan,
    run_fit,
    run_fresh,
)
from veilcam_training.experiments.model import make_fresh_model, make_model, no_statistics
from veilcam_training.experiments.records import provenance
from veilcam_training.hiding.measuring import measure
from veilcam_training.models.lensless import FreshClassifier, LenslessClassifier
from veilcam_training.models.network import weights_of
from veilcam_training.seeding import derive
from veilcam_training.trainer.callbacks import Callback
from veilcam_training.transforms.scene import Transform

_NO_ACCURACY = Accuracy(0.0, "no test", 1)
"""Of a bundle that is written before a fit."""
_SHOWN = 10_000
"""Images of a data set that attackers without a key learn or attack."""


def fit_keyring(
    settings: FitSettings,
    pairs: int,
    source: Source,
    camera: Camera,
    *,
    device: torch.device | str = "cpu",
    work: Path | None = None,
    workers: Executor = HERE,
    observe: Callable[[int], Sequence[Callback]] = lambda _: (),
    fitted: Callable[[int, FitResult], None] = lambda *_: None,
) -> Bundle:
    """Fit ``pairs`` pairs and put them into one bundle.

    Args:
        settings: settings of every pair; pair 0 has their seed, the others seeds derived from it.
        pairs: number of pairs.
        source: the data set.
        camera: the device.
        device: device that computes.
        work: folder for one checkpoint per pair, so that a broken-off run is taken up again.
        workers: fit the pairs; what comes out is the same, given as many threads.
        observe: gives the callbacks of pair ``i``, which go with it to its worker: none that cannot
            be pickled, if that is another process.
        fitted: function that is told of each pair as it is done.

    Raises:
        TrainingError: settings or data that cannot be used.
    """
    require(pairs >= 1, f"pairs = {pairs} is not valid: use at least 1")
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
    results: dict[int, FitResult] = {}
    for index, result in workers.run(_Fitter(source, camera, device), tasks):
        results[index] = result
        fitted(index, result)
    return as_bundle([results[index] for index in range(pairs)], source, camera)


def fit_bundle(
    settings: FitSettings,
    source: Source,
    camera: Camera,
    *,
    budget: float | None = None,
    device: torch.device | str = "cpu",
    work: Path | None = None,
    callbacks: Sequence[Callback] = (),
) -> tuple[FitResult | FreshResult, Bundle | None]:
    """Fit one camera with its classifier, and make the bundle.

    Args:
        settings: settings of the fit.
        source: the data set.
        camera: the device.
        budget: processor time that all of it may take [s], see :func:`.fit.run_fit`.
        device: device that computes.
        work: folder of checkpoints: a run that was broken off is taken up in it.
        callbacks: called as the fit goes on.

    Returns:
        The result, and the bundle; None where no panel can show the encoder, or at points.

    Raises:
        TrainingError: settings or data that cannot be used.
    """
    hiding: list[Hiding | None] = []

    def hold(bundle: Bundle, change: Transform) -> None:
        for callback in callbacks:
            callback.stage("measuring what the masks hide")
        hiding[:] = [_measured(bundle, source, change).hiding]

    def hold_pair(model: LenslessClassifier) -> None:
        if on_panel(settings):
            hold(_of_pairs(model, [as_pair(model)], source, camera), model.change)

    def hold_fresh(model: FreshClassifier) -> None:
        hold(_of_fresh(model, model.encoder, source, camera), model.change)

    if settings.fresh is not None:
        fresh = run_fresh(
            *(settings, source, camera),
            budget=budget,
            device=device,
            work=work,
            callbacks=callbacks,
            held=hold_fresh,
        )
        return fresh, as_fresh_bundle(fresh, source, camera, *hiding)
    result = run_fit(
        *(settings, source, camera),
        budget=budget,
        device=device,
        checkpoint=None if work is None else work / "fit.checkpoint",
        callbacks=callbacks,
        held=hold_pair,
    )
    if not on_panel(settings):
        return result, None
    return result, as_bundle([result], source, camera, *hiding)


def on_panel(settings: FitSettings) -> bool:
    """Return whether a device can show the camera that ``settings`` describe."""
    return settings.encoder in WITH_PANEL and settings.binning == "area"


def check_fit(
    settings: FitSettings, source: Source, camera: Camera, *, budget: float | None = None
) -> None:
    """Refuse before :func:`fit_bundle` what cannot be fitted, or held by a bundle.

    Raises:
        TrainingError: settings that cannot be used.
    """
    check_budget(settings, budget)
    if settings.fresh is not None:
        check_fresh(settings, source, camera)
    elif on_panel(settings):
        check_pairs(settings, source, camera)
    else:
        make_model(settings, source, camera)


def check_pairs(settings: FitSettings, source: Source, camera: Camera) -> None:
    """Refuse before the fit what no bundle can hold: one is written without a fit, and read.

    Raises:
        TrainingError: settings that cannot be used, or that no device can.
    """
    _check_binning(settings)
    model = make_model(settings, source, camera)
    record = provenance(settings.model_dump(mode="json", exclude={"seed"}), {})
    _write_and_read(_of_pairs(model, [as_pair(model)], source, camera, record=record))


def check_fresh(settings: FitSettings, source: Source, camera: Camera) -> None:
    """Return the same of a fit for fresh masks."""
    statistics = no_statistics(settings, camera, source.scene, colour=source.colour)
    model = make_fresh_model(settings, source, camera, statistics)
    record = provenance(settings.model_dump(mode="json"), {})
    _write_and_read(_of_fresh(model, model.encoder, source, camera, record=record))


def _write_and_read(bundle: Bundle) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "empty.veilcam"
        try:
            write_bundle(path, bundle)
            read_bundle(path)
        except (BundleError, OSError) as error:
            reason = str(error).removeprefix(f"{path}: ")
            raise TrainingError(f"no bundle can hold what would be fitted: {reason}") from None


def _check_binning(settings: FitSettings) -> None:
    require(
        settings.binning != "point",
        "binning 'point' is for comparison alone, a device averages over its pixels: "
        "use binning 'area', or leave out --out",
    )


@dataclass(frozen=True)
class _Task:
    """One pair."""

    settings: FitSettings
    checkpoint: Path | None
    callbacks: Sequence[Callback]


@dataclass(frozen=True)
class _Fitter:
    """Fits pairs; every worker has its own and reads the training set once."""

    source: Source
    camera: Camera
    device: torch.device | str

    @cached_property
    def training(self) -> Images:
        return self.source.training()

    def __call__(self, task: _Task) -> FitResult:
        result = run_fit(
            task.settings,
            self.source,
            self.camera,
            training=self.training,
            device=self.device,
            checkpoint=task.checkpoint,
            callbacks=task.callbacks,
        )
        result.fit.model.cpu()  # who collects may have no GPU
        return result


def as_pair(model: LenslessClassifier, error: TransferError | None = None) -> Pair:
    """Mask and classifier of a fitted model, for a bundle.

    Args:
        model: fitted.
        error: error of the transfer that it was fitted with.

    Raises:
        TrainingError: the encoder has no mask that a panel could show.
    """
    encoder = model.encoder
    if not isinstance(encoder, Mask):
        raise TrainingError(
            "this encoder has no mask that a panel can show: "
            "use 'learned' or 'fixed_simulated', or leave out --out"
        )
    return Pair(encoder.levels(), model.layers, weights_of(model.reader()), error)


def as_bundle(
    results: Sequence[FitResult], source: Source, camera: Camera, hiding: Hiding | None = None
) -> Bundle:
    """Bundle of fitted pairs that differ in their seeds alone; the accuracy is their mean.

    Args:
        results: results of the fits.
        source: data set of the fits.
        camera: camera of the fits.
        hiding: record of what the masks hide, if they were measured before.

    Raises:
        TrainingError: pairs that no device can use.
    """
    settings, first = results[0].settings, results[0].accuracy
    _check_binning(settings)
    record = provenance(settings.model_dump(mode="json", exclude={"seed"}), source.digests())
    record["pairs"] = [
        {
            "seed": result.settings.seed,
            "test_accuracy": result.accuracy.value,
            "validation_accuracy": result.fit.best.validation_accuracy,
            "epoch": result.fit.best.number + 1,
        }
        for result in results
    ]
    pairs = [as_pair(result.fit.model, result.transfer_error) for result in results]
    accuracy = replace(first, value=mean(result.accuracy.value for result in results))
    model = results[0].fit.model
    bundle = _of_pairs(model, pairs, source, camera, record=record, accuracy=accuracy)
    return _measured(bundle, source, model.change, hiding)


def _of_pairs(
    model: LenslessClassifier,
    pairs: Sequence[Pair],
    source: Source,
    camera: Camera,
    *,
    record: dict[str, JsonValue] | None = None,
    accuracy: Accuracy = _NO_ACCURACY,
) -> Bundle:
    setup = model.encoder.setup
    return Bundle(
        task=source.name,
        labels=source.labels,
        camera=camera,
        scene=setup.scene,
        embedding=setup.embedding,
        channels=3 if setup.colour else 1,
        mode="pairs",
        pairs=tuple(pairs),
        provenance=record or {},
        accuracy=accuracy,
        light=light_plan(setup),
    )


def as_fresh_bundle(
    result: FreshResult, source: Source, camera: Camera, hiding: Hiding | None = None
) -> Bundle:
    """Bundle of mode ``fresh``: no mask is in it, and one classifier for all.

    Args:
        result: result of the fit.
        source: data set of the fit.
        camera: camera of the fit.
        hiding: record of what the masks hide, if they were measured before.
    """
    best = result.fit.best
    record = provenance(result.settings.model_dump(mode="json"), source.digests())
    record["fit"] = {
        "validation_accuracy": best.validation_accuracy,
        "epoch": best.number + 1,
        "test_masks": result.masks,
        "wrong_key_accuracy": result.wrong_key_accuracy,
    }
    model = result.fit.model
    bundle = _of_fresh(
        model, result.camera, source, camera, record=record, accuracy=result.accuracy
    )
    return _measured(bundle, source, model.change, hiding)


def _measured(
    bundle: Bundle, source: Source, change: Transform, hiding: Hiding | None = None
) -> Bundle:
    """Return the bundle with a record of what its masks hide.

    Args:
        bundle: bundle of a fit.
        source: data set of the fit.
        change: way in which its images are shown.
        hiding: record, if the masks were measured before.
    """
    if hiding is not None:
        return replace(bundle, hiding=hiding)
    generator = torch.Generator().manual_seed(0)

    def shown(images: Images) -> Images:
        few = images.take(torch.randperm(len(images), generator=generator)[:_SHOWN])
        scenes = change(few.scenes(), generator)
        scenes = torch.nn.functional.adaptive_avg_pool2d(scenes, bundle.scene.shape)
        return replace(few, pixels=(255 * scenes).round().to(torch.uint8))

    return replace(bundle, hiding=measure(bundle, shown(source.training()), shown(source.test())))


def _of_fresh(
    model: LenslessClassifier,
    encoder: FreshCamera,
    source: Source,
    camera: Camera,
    *,
    record: dict[str, JsonValue] | None = None,
    accuracy: Accuracy = _NO_ACCURACY,
) -> Bundle:
    frame = encoder.frame
    return Bundle(
        task=source.name,
        labels=source.labels,
        camera=camera,
        scene=frame.scene,
        embedding=frame.embedding,
        channels=3 if frame.colour else 1,
        mode="fresh",
        fresh=Fresh(
            distribution=encoder.distribution,
            statistics=frame.statistics.in_numpy(),
            noise=frame.noise,
            layers=model.layers,
            weights=weights_of(model.reader()),
        ),
        provenance=record or {},
        accuracy=accuracy,
        light=light_plan(encoder.setup),
    )
