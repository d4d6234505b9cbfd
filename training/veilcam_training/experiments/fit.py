"""One fit from its settings: data, camera and classifier are made, fitted and tested once."""

import math
import secrets
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Camera
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.decoding import SceneStatistics
from veilcam_optics.effects import Model
from veilcam_optics.errors import OpticsError
from veilcam_optics.simulation.check import check
from veilcam_optics.simulation.operator import LightOperator
from veilcam_training.bundle import Accuracy, LightPlan, TransferError
from veilcam_training.bundle.hiding import LEAST_PINHOLE, MARGIN
from veilcam_training.config.settings import FitSettings
from veilcam_training.data import Images, Source, Split, split
from veilcam_training.encoders import LearnedMask, Mask, Setup
from veilcam_training.encoders.fresh import FreshCamera
from veilcam_training.encoders.imperfections import plan_light
from veilcam_training.errors import require
from veilcam_training.experiments.model import (
    fresh_statistics,
    make_fresh_model,
    make_model,
    prepare,
)
from veilcam_training.files import read_private, write_private
from veilcam_training.hiding.eye import Eye, drawn_eye
from veilcam_training.models.classifiers import reads_scenes
from veilcam_training.models.lensless import FreshClassifier, LenslessClassifier
from veilcam_training.trainer.callbacks import Callback
from veilcam_training.trainer.loop import Fit, fit, load_checkpoint, save_checkpoint
from veilcam_training.trainer.step import judge, measure

WRONG_KEY_IMAGES = 1000
"""Test images that are decoded with another key: enough to tell that accuracy is at chance."""
CHECKED_ENTRIES = 16
"""Of a transfer: an interval of a factor 1.5 to either side, in half a second of one core."""
SEED_BITS = 63
CLOSING = 8.0
"""Processor time that is kept of a budget for the test, the bundle and the report [s]."""
ATTEMPTS = ((0.95, 0), (1.25, 0), (1.25, 1), (1.6, 2))
"""Attempts to learn a mask; the next one is made where an eye sees the scene behind the last.
Least count of copies, as a share of that of random masks, and what is added to the start's seed."""
SECOND: Mapping[str, object] = {"optimiser": "adam", "rate": 1e-3, "weight_decay": 0.0}
"""Changes of the settings in the second stage of a fit."""
TEST_MASKS = 200
"""Fresh masks that the test set is spread over, unless it is said."""


@dataclass(frozen=True)
class FitResult:
    """A fit and its one look at the test set."""

    settings: FitSettings
    fit: Fit
    accuracy: Accuracy
    logits: Tensor
    """Of the test set, float32 (count, classes)."""

    @property
    def light(self) -> LightPlan | None:
        """Plan of the light behind a mask; None for another encoder and for points."""
        encoder = self.fit.model.encoder
        return light_plan(encoder.setup) if isinstance(encoder, Mask) else None

    @cached_property
    def transfer_error(self) -> TransferError | None:
        """Error of the mask's transfer, see :func:`transfer_error`; None if there is none."""
        encoder = self.fit.model.encoder
        return transfer_error(encoder) if isinstance(encoder, Mask) else None


@dataclass(frozen=True)
class FreshResult:
    """A fit for fresh masks and its one look at the test set."""

    settings: FitSettings
    fit: Fit
    camera: FreshCamera
    accuracy: Accuracy
    masks: int
    """How many different masks were tested on, none of which it was fitted to."""
    wrong_key_accuracy: float
    """The same, every measurement decoded with the mask of another epoch."""
    logits: Tensor
    """Of the test set, float32 (count, classes)."""

    @property
    def light(self) -> LightPlan | None:
        """Plan of the light."""
        return light_plan(self.camera.setup)


def run_fit(
    settings: FitSettings,
    source: Source,
    camera: Camera,
    *,
    training: Images | None = None,
    budget: float | None = None,
    device: torch.device | str = "cpu",
    checkpoint: Path | None = None,
    callbacks: Sequence[Callback] = (),
    held: Callable[[LenslessClassifier], None] = lambda _: None,
) -> FitResult:
    """Fit, select on the validation split, then look at the test set once.

    Args:
        settings: settings of the fit.
        source: the data set.
        camera: the device.
        training: training images if they have been read before.
        budget: processor time that the fit may take [s]; the number of epochs follows from it. None
            for the epochs of the settings.
        device: device that computes.
        checkpoint: see :func:`veilcam_training.trainer.loop.fit`.
        callbacks: called after every step and epoch.
        held: called with the model once its mask is learned, where the classifier is fitted after.

    Raises:
        TrainingError: settings or data that cannot be used.
    """
    begun = time.process_time()
    check_budget(settings, budget)
    parts, test = _read(source, device, training)
    model = make_model(settings, source, camera).to(device)
    for callback in callbacks:
        callback.stage("learning the mask")
    eye = _eye(model) if settings.hidden else None
    known: SceneStatistics | None = None
    for attempt, (least, start) in enumerate(((0.0, 0),) if eye is None else ATTEMPTS):
        if attempt:
            started = settings.model_copy(update={"seed": settings.seed + start})
            model = make_model(started, source, camera).to(device)
        if isinstance(model.encoder, LearnedMask):
            model.encoder.hide(least)
        known = prepare(model, settings, parts.training, known)
        again = attempt + 1 < len(ATTEMPTS)
        # A second attempt costs little; further ones are for masks that a daemon refuses.
        margin = MARGIN if attempt else MARGIN / 2
        held_fast = model.measures_once and not settings.end_to_end
        if again and held_fast and _seen(eye, model, margin):
            continue  # what is learned from now on is the classifier alone
        tested: Tensor | None = None
        if held_fast:
            held(model)
            tested = measure(model, test, settings.seed, "test")
        fitted = _in_stages(
            model,
            parts,
            settings,
            checkpoint=_numbered(checkpoint, attempt),
            fingerprint=settings.fingerprint(source),
            callbacks=callbacks,
            until=None if budget is None else begun + budget - CLOSING,
            begun=begun,
        )
        if not (again and _seen(eye, model, margin)):
            break
    if tested is None:
        tested = measure(fitted.model, test, settings.seed, "test")
    result = judge(fitted.model, tested, test.labels)
    accuracy = Accuracy(result.accuracy, f"{source.name} test", len(test))
    return FitResult(settings, fitted, accuracy, result.logits)


def check_budget(settings: FitSettings, budget: float | None) -> None:
    """Refuse a budget for a fit whose time cannot be told from a few steps.

    Raises:
        TrainingError: a classifier that is learned together with its mask.
    """
    require(
        budget is None or (reads_scenes(settings.classifier) and not settings.end_to_end),
        "a budget is for a Scene classifier that is fitted behind a finished mask: "
        "leave out the budget, or end_to_end",
    )


def _eye(model: LenslessClassifier) -> Eye | None:
    """Return the eye that a daemon judges a mask by; None where a mask has no bound.

    That is where the encoder learns no mask, and where an eye does not find what one pinhole shows.
    """
    setup = model.encoder.setup
    if not isinstance(model.encoder, LearnedMask):
        return None
    eye = drawn_eye(setup.camera, setup.scene, setup.embedding, setup.channels)
    return eye if eye.pinhole >= LEAST_PINHOLE else None


def _seen(eye: Eye | None, model: LenslessClassifier, margin: float) -> bool:
    """Return whether an eye sees more behind a mask than behind random ones, and a margin."""
    encoder = model.encoder
    if eye is None or not isinstance(encoder, LearnedMask):
        return False
    weights = to_weights(encoder.levels(), encoder.setup.camera.panel)
    return eye.seen(weights) > eye.random + margin


def _in_stages(
    model: LenslessClassifier,
    parts: Split,
    settings: FitSettings,
    *,
    checkpoint: Path | None,
    fingerprint: str,
    callbacks: Sequence[Callback],
    until: float | None,
    begun: float,
) -> Fit:
    """Fit the classifier, and then mask and classifier together where that is asked for."""
    go_on = partial(fit, fingerprint=fingerprint, callbacks=callbacks, begun=begun)
    fitted = go_on(model, parts, settings, checkpoint=checkpoint, until=until)
    if not (settings.end_to_end and isinstance(model.encoder, LearnedMask)):
        return fitted
    model.encoder.hold(held=False)
    second = settings.model_copy(update={**SECOND, "epochs": math.ceil(settings.epochs / 2)})
    return go_on(model, parts, second, checkpoint=_numbered(checkpoint, 9))


def _numbered(checkpoint: Path | None, number: int) -> Path | None:
    """Return the place of another checkpoint beside the first."""
    if checkpoint is None or not number:
        return checkpoint
    return checkpoint.with_name(f"{checkpoint.stem}-{number}{checkpoint.suffix}")


def light_plan(setup: Setup) -> LightPlan | None:
    """Return the plan of a setup's light, of the grid with the largest predicted error.

    Args:
        setup: setup of an encoder with a mask.

    Returns:
        None for a measurement at points, which has no plan.
    """
    worst = max(plan_light(setup), key=lambda found: found.error, default=None)
    if worst is None:
        return None
    sampling = worst.model.sampling
    return LightPlan(
        tolerance=worst.tolerance,
        error=worst.error,
        reached=worst.reached,
        method="transfer",
        diffraction=sampling.diffraction,
        reach=sampling.reach,
        zones=sampling.zones,
        step=sampling.step,
        dtype="float64" if sampling.dtype == torch.float64 else "float32",
    )


def transfer_error(encoder: Mask) -> TransferError | None:
    """Return the error of a mask's transfer as planned against the full field, on the worst grid.

    How a panel errs is no part of it. In colour it is the error of the three channels' sum. Two
    digits of it are kept: no more is known, and the less of a mask leaves the better.

    Args:
        encoder: encoder with the mask.

    Returns:
        None for a measurement at points, of which there is no full field, and where a check would
        take minutes.
    """
    plans = plan_light(encoder.setup)
    if not plans:
        return None
    weights = torch.from_numpy(to_weights(encoder.levels(), encoder.setup.camera.panel))
    try:
        checks = [
            check(_by_factors(found.model), found.asked, weights, entries=CHECKED_ENTRIES)
            for found in plans
        ]
    except OpticsError:  # too many fringes: hours of fitting are not lost to that
        return None
    worst = max(checks, key=lambda found: found.error)
    error, low, high = (float(f"{value:.2g}") for value in (worst.error, worst.low, worst.high))
    return TransferError(error, low, high, worst.confidence)


def _by_factors(model: Model) -> LightOperator:
    """Return the operator of a model without the whole matrix.

    A scene much larger than the images is trained on in parts: its matrix may be too large.
    """
    return LightOperator(replace(model, sampling=replace(model.sampling, method="factors")))


def run_fresh(
    settings: FitSettings,
    source: Source,
    camera: Camera,
    *,
    masks: int | None = None,
    budget: float | None = None,
    device: torch.device | str = "cpu",
    work: Path | None = None,
    callbacks: Sequence[Callback] = (),
    held: Callable[[FreshClassifier], None] = lambda _: None,
) -> FreshResult:
    """Fit for fresh masks, select on the validation split, then look at the test set once.

    Args:
        settings: settings of the fit.
        source: the data set.
        camera: the device.
        masks: number of masks to test on; by default ``TEST_MASKS``.
        budget: processor time of the fit, see :func:`run_fit`.
        device: device that computes.
        work: folder to leave statistics and checkpoints in; what is in it is taken up again.
        callbacks: called after every step and epoch.
        held: called with the model once its masks' ranges are learned.

    Raises:
        TrainingError: settings or data that cannot be used.
    """
    begun = time.process_time()
    parts, test = _read(source, device)
    fingerprint = settings.fingerprint(source)
    statistics = _statistics(
        None if work is None else work / "statistics.checkpoint",
        fingerprint,
        lambda: fresh_statistics(settings, camera, source.scene, parts.training),
    )
    model = make_fresh_model(settings, source, camera, statistics).to(device)
    for callback in callbacks:
        callback.stage("learning the ranges of masks")
    model.encoder.learn_range()
    held(model)
    tested = min(TEST_MASKS, len(test)) if masks is None else masks
    some = test.take(torch.arange(min(len(test), WRONG_KEY_IMAGES)))

    def measured(images: Images, batches: int, *, wrong_key: bool) -> Tensor:
        model.wrong_key = wrong_key
        return measure(model, images, settings.seed, "test", batches=batches)

    wrong = measured(some, min(tested, len(some)), wrong_key=True)
    right = measured(test, tested, wrong_key=False)
    fitted = fit(
        model,
        parts,
        settings,
        until=None if budget is None else begun + budget - CLOSING,
        begun=begun,
        checkpoint=None if work is None else work / "fit.checkpoint",
        fingerprint=fingerprint,
        callbacks=callbacks,
    )
    result = judge(model, right, test.labels)
    accuracy = Accuracy(result.accuracy, f"{source.name} test", len(test))
    mistaken = judge(model, wrong, some.labels).accuracy
    return FreshResult(settings, fitted, model.encoder, accuracy, tested, mistaken, result.logits)


def _read(
    source: Source, device: torch.device | str, training: Images | None = None
) -> tuple[Split, Images]:
    """Both parts of the training set, and the test set: fitting has no part in it.

    It is read now, so that a bad file does not cost a fit.
    """
    parts = split(source.training() if training is None else training)
    test = source.test()
    require(len(test) > 0, f"{source.name} has no test images: use a data set that holds some")
    return Split(parts.training.to(device), parts.validation.to(device)), test.to(device)


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


def settle_seed(settings: FitSettings, work: Path | None) -> FitSettings:
    """Return ``settings`` with their own seed, or else with one that is drawn.

    A mask can be made again by whoever knows its seed, so none is the same for everybody.

    Args:
        settings: settings of the run.
        work: folder to keep a drawn seed in: the run that is taken up there has it again.

    Raises:
        TrainingError: the seed in ``work`` is damaged.
    """
    if "seed" in settings.model_fields_set:
        return settings
    return settings.model_copy(update={"seed": _drawn_seed(work)})


def _drawn_seed(work: Path | None) -> int:
    if work is None:
        return secrets.randbits(SEED_BITS)
    path = work / "seed"
    kept = read_private(path)
    if kept is None:
        kept = str(secrets.randbits(SEED_BITS)).encode()
        write_private(path, kept)  # before the fit, which could be killed
    return int(kept)
