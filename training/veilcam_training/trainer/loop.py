"""Fitting encoder and classifier together; a fit killed at any moment can be taken up again."""

import copy
import dataclasses
import io
import pickle
import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from veilcam_training.config.settings import FitSettings
from veilcam_training.data import Split
from veilcam_training.errors import require
from veilcam_training.files import read_private, unreadable, write_private
from veilcam_training.models.lensless import LenslessClassifier
from veilcam_training.models.scene import begin, confidence_factor
from veilcam_training.seeding import seeded, stream
from veilcam_training.trainer.callbacks import Callback, Epoch, MovingAverage
from veilcam_training.trainer.step import (
    Evaluation,
    Inputs,
    evaluate,
    judge,
    logits_of,
    make_optimiser,
    measure,
    train_step,
)

TRIED_STEPS = 5
"""Steps that are timed to choose a number of epochs."""
MOST_EPOCHS = 300


@dataclass(frozen=True)
class Fit:
    """A fitted model, as it was after the epoch that did best on the validation set."""

    model: LenslessClassifier
    history: tuple[Epoch, ...]
    best: Epoch
    epochs: int
    """Epochs of its whole cycle."""


def fit(
    model: LenslessClassifier,
    split: Split,
    settings: FitSettings,
    *,
    until: float | None = None,
    begun: float | None = None,
    checkpoint: Path | None = None,
    fingerprint: str = "",
    callbacks: Sequence[Callback] = (),
) -> Fit:
    """Fit ``model`` in place.

    The validation part selects the epoch; there is no test set here to look at. With the same
    model, data and settings the result is the same, also when the fit was broken off and taken up
    again from its checkpoint.

    Args:
        model: freshly made, on the device that is to be used.
        split: images to fit to and to select with.
        settings: settings of the fit.
        until: time of the process's clock (:func:`time.process_time`) at which the epochs are to be
            over [s]: as many are chosen as fit. None for those of the settings.
        begun: time of that clock at which the fit began, if that was earlier [s].
        checkpoint: written after every epoch, and read first if it is there.
        fingerprint: digest of all that the result depends on; guards the checkpoint.
        callbacks: called after every step and epoch.

    Raises:
        TrainingError: a checkpoint of another fit, or a loss that is no number.
    """
    seed, fresh = settings.seed, settings.fresh
    for callback in callbacks:
        callback.stage("measuring the training images")
    inputs = Inputs(model, split.training, settings)
    if inputs.begun_with is not None:
        begin(model.classifier, inputs.begun_with)
    average = MovingAverage(model, settings.averaging) if settings.averaging else None
    state = _State(model, settings, average)
    state.begun = time.process_time() if begun is None else begun
    batches = None if fresh is None else min(fresh.validation_masks, len(split.validation))
    held: Tensor | None = None
    if model.measures_once:
        held = measure(model, split.validation, seed, "validation", batches=batches)

    def validate() -> Evaluation:
        if held is not None:
            return judge(model, held, split.validation.labels)
        return evaluate(model, split.validation, seed, "validation", batches=batches)

    if checkpoint is not None and (saved := load_checkpoint(checkpoint, fingerprint)) is not None:
        state.load(saved)
    elif until is not None:
        epochs = _affordable(state, inputs, len(split.training), validate, until)
        state.settings = settings.model_copy(update={"epochs": epochs})
        if checkpoint is not None:  # a run that is taken up has the same cycle
            save_checkpoint(checkpoint, fingerprint, state.dump())
    for callback in callbacks:
        callback.begin(state.settings.epochs, len(split.training))
    watched = callbacks if average is None else (average, *callbacks)
    while not state.is_over:
        started = time.monotonic()
        with seeded(seed, "epoch", state.next_epoch):
            inputs.begin_epoch(seed, state.next_epoch)
            loss, accuracy = _run_epoch(state, inputs, split.training.labels, seed, watched)
        with state.averaged():
            result = validate()
            epoch = Epoch(
                state.next_epoch,
                loss,
                accuracy,
                result.accuracy,
                result.loss,
                time.monotonic() - started,
                state.spent + time.process_time() - state.begun,
            )
            state.finish(epoch)
        if checkpoint is not None:
            save_checkpoint(checkpoint, fingerprint, state.dump())
        for callback in watched:
            callback.epoch(epoch)
    model.load_state_dict(state.best_weights)
    model.eval()
    if held is not None:
        logits = logits_of(model, held)
        model.rescale(confidence_factor(logits, split.validation.labels))
    return Fit(model, tuple(state.history), state.best, state.settings.epochs)


def _affordable(
    state: "_State", inputs: Inputs, count: int, validate: Callable[[], object], until: float
) -> int:
    """Return how many epochs fit until a time, from a few steps that leave no trace; at least 1."""
    settings, kept = state.settings, copy.deepcopy(state.dump())
    batch = min(settings.batch, count)
    inputs.begin_epoch(settings.seed, 0)
    state.model.train()
    times = []
    with seeded(settings.seed, "budget"):
        for _ in range(TRIED_STEPS):
            started = time.process_time()
            train_step(state.model, inputs, torch.arange(batch), state.optimiser)
            times.append(time.process_time() - started)
    started = time.process_time()
    validate()
    epoch = statistics.median(times) * (count // batch) + time.process_time() - started
    state.load(kept)
    return max(1, min(MOST_EPOCHS, int((until - time.process_time()) / epoch)))


class _State:
    """All that changes during a fit."""

    def __init__(
        self, model: LenslessClassifier, settings: FitSettings, average: MovingAverage | None
    ) -> None:
        self.model, self.settings, self.average = model, settings, average
        self.optimiser = make_optimiser(model, settings)
        self.history: list[Epoch] = []
        self.best_weights: dict[str, Tensor] = {}
        self.begun = self.spent = 0.0
        """Start on the process's clock, and processor time before that [s]."""

    @property
    def next_epoch(self) -> int:
        return len(self.history)

    @property
    def is_over(self) -> bool:
        settings = self.settings
        if self.next_epoch >= settings.epochs:
            return True
        if settings.patience is None or not self.history:
            return False
        return self.next_epoch - 1 - self.best.number >= settings.patience

    @property
    def best(self) -> Epoch:
        return max(self.history, key=lambda e: (e.validation_accuracy, -e.validation_loss))

    def averaged(self) -> AbstractContextManager[None]:
        """Let the model have the weights to validate and to keep meanwhile."""
        return nullcontext() if self.average is None else self.average.applied()

    def finish(self, epoch: Epoch) -> None:
        self.history.append(epoch)
        if self.best is epoch:
            self.best_weights = copy.deepcopy(self.model.state_dict())

    def dump(self) -> dict[str, Any]:
        average = {} if self.average is None else {"average": self.average.state_dict()}
        return average | {
            "model": self.model.state_dict(),
            "optimiser": self.optimiser.state_dict(),
            "best_weights": self.best_weights,
            "epochs": self.settings.epochs,
            "history": [dataclasses.asdict(epoch) for epoch in self.history],
        }

    def load(self, saved: dict[str, Any]) -> None:
        self.model.load_state_dict(saved["model"])
        self.optimiser.load_state_dict(saved["optimiser"])
        if self.average is not None:
            self.average.load_state_dict(saved["average"])
        self.best_weights = saved["best_weights"]
        self.settings = self.settings.model_copy(update={"epochs": saved["epochs"]})
        self.history = [Epoch(**epoch) for epoch in saved["history"]]
        if self.history:
            self.spent = self.history[-1].processor_seconds


def _run_epoch(
    state: _State,
    inputs: Inputs,
    labels: Tensor,
    seed: int,
    callbacks: Iterable[Callback],
) -> tuple[float, float]:
    """One pass over the training images; mean loss and accuracy."""
    settings, number, count = state.settings, state.next_epoch, len(labels)
    order = torch.randperm(count, generator=stream(seed, "order", number)).to(labels.device)
    batch = min(settings.batch, count)
    steps = count // batch  # what does not fill a batch waits for another epoch's order
    total, right = 0.0, 0.0
    state.model.train()
    for step in range(steps):
        factor = settings.rate_factor((number + step / steps) / settings.epochs)
        for group in state.optimiser.param_groups:
            group["lr"] = group["peak"] * factor
        loss, hits = train_step(
            state.model,
            inputs,
            order[step * batch : (step + 1) * batch],
            state.optimiser,
            label_smoothing=settings.label_smoothing,
        )
        total, right = total + loss, right + hits
        for callback in callbacks:
            callback.step(number, step + 1, steps)
    return total / steps, right / (steps * batch)


def save_checkpoint(path: Path, fingerprint: str, state: dict[str, Any]) -> None:
    """Write ``state`` so that ``path`` always holds a whole checkpoint, the old or the new one.

    It is for its owner alone: it may hold masks, which are the camera's secret.
    """
    buffer = io.BytesIO()
    torch.save({"fingerprint": fingerprint, "state": state}, buffer)
    write_private(path, buffer.getvalue())


def load_checkpoint(path: Path, fingerprint: str) -> dict[str, Any] | None:
    """State of the checkpoint at ``path``, or None where there is none.

    Loading runs no code: torch takes nothing but tensors and plain values.

    Raises:
        TrainingError: it cannot be read, or belongs to another fit than ``fingerprint``.
    """
    data = read_private(path)
    if data is None:
        return None
    try:
        content = torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except (RuntimeError, pickle.UnpicklingError):  # whole, so another torch wrote it
        raise unreadable(path, "not by this version of torch") from None
    require(
        content["fingerprint"] == fingerprint,
        f"checkpoint {path} is of another fit (other data, settings or seed): "
        "remove it to start again, or use the settings that it was made with",
    )
    state: dict[str, Any] = content["state"]
    return state
