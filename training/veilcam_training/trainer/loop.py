"""Fitting encoder and classifier together; a fit killed at any moment can be taken up again."""

import copy
import dataclasses
import io
import pickle
import time
from collections.abc import Iterable, Sequence
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
    Inputs,
    evaluate,
    judge,
    logits_of,
    make_optimiser,
    measure,
    train_step,
)


@dataclass(frozen=True)
class Fit:
    """A fitted model, as it was after the epoch that did best on the validation set."""

    model: LenslessClassifier
    history: tuple[Epoch, ...]
    best: Epoch


def fit(
    model: LenslessClassifier,
    split: Split,
    settings: FitSettings,
    *,
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
        checkpoint: written after every epoch, and read first if it is there.
        fingerprint: digest of all that the result depends on; guards the checkpoint.
        callbacks: called after every step and epoch.

    Raises:
        TrainingError: a checkpoint of another fit, or a loss that is no number.
    """
    seed, fresh = settings.seed, settings.fresh
    inputs = Inputs(model, split.training, settings)
    if inputs.begun_with is not None:
        begin(model.classifier, inputs.begun_with)
    average = MovingAverage(model, settings.averaging) if settings.averaging else None
    state = _State(model, settings, average)
    if checkpoint is not None and (saved := load_checkpoint(checkpoint, fingerprint)) is not None:
        state.load(saved)
    batches = None if fresh is None else min(fresh.validation_masks, len(split.validation))
    held: Tensor | None = None
    if model.measures_once:
        held = measure(model, split.validation, seed, "validation", batches=batches)
    watched = callbacks if average is None else (average, *callbacks)
    while not state.is_over:
        started = time.monotonic()
        with seeded(seed, "epoch", state.next_epoch):
            inputs.begin_epoch(seed, state.next_epoch)
            loss, accuracy = _run_epoch(state, inputs, split.training.labels, seed, watched)
        with state.averaged():
            if held is not None:
                result = judge(model, held, split.validation.labels)
            else:
                result = evaluate(model, split.validation, seed, "validation", batches=batches)
            seconds = time.monotonic() - started
            epoch = Epoch(state.next_epoch, loss, accuracy, result.accuracy, result.loss, seconds)
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
    return Fit(model, tuple(state.history), state.best)


class _State:
    """All that changes during a fit."""

    def __init__(
        self, model: LenslessClassifier, settings: FitSettings, average: MovingAverage | None
    ) -> None:
        self.model, self.settings, self.average = model, settings, average
        self.optimiser = make_optimiser(model, settings)
        self.history: list[Epoch] = []
        self.best_weights: dict[str, Tensor] = {}

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
            "history": [dataclasses.asdict(epoch) for epoch in self.history],
        }

    def load(self, saved: dict[str, Any]) -> None:
        self.model.load_state_dict(saved["model"])
        self.optimiser.load_state_dict(saved["optimiser"])
        if self.average is not None:
            self.average.load_state_dict(saved["average"])
        self.best_weights = saved["best_weights"]
        self.history = [Epoch(**epoch) for epoch in saved["history"]]


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
