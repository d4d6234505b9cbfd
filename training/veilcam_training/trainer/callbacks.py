"""Callbacks of a fit: progress, logs for TensorBoard and as CSV, and a mean of its weights."""

import copy
import csv
import io
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import torch
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from veilcam_optics.files import write_whole
from veilcam_training.models.lensless import LenslessClassifier


@dataclass(frozen=True)
class Epoch:
    """Result of one epoch; accuracies in [0, 1], on noisy measurements."""

    number: int
    loss: float
    """Mean over the epoch's steps."""
    training_accuracy: float
    """Of each batch before its step, mean over the epoch."""
    validation_accuracy: float
    validation_loss: float
    seconds: float
    processor_seconds: float = 0.0
    """Processor time of the fit up to the end of this epoch [s]."""


class Callback(Protocol):
    """Callback that is called as a fit goes on."""

    def step(self, epoch: int, done: int, steps: int) -> None:
        """``done`` of ``steps`` steps of ``epoch`` (from 0) are done."""

    def epoch(self, epoch: Epoch) -> None:
        """Take note that an epoch is over."""


class MovingAverage:
    """Running mean of a classifier's weights over the steps; it forgets the first ones fast.

    Args:
        model: model that is fitted.
        decay: decay of the mean, per step, in [0, 1); 0 keeps the last weights alone.
    """

    def __init__(self, model: LenslessClassifier, decay: float) -> None:
        self._model, self._decay, self._steps = model, decay, 0
        self._mean = copy.deepcopy(model.classifier).requires_grad_(False)

    @torch.no_grad()
    def step(self, epoch: int, done: int, steps: int) -> None:  # noqa: ARG002 - part of the interface
        """Take the new weights into the mean."""
        self._steps += 1
        share = 1 - min(self._decay, self._steps / (self._steps + 9))
        weights = self._model.classifier.state_dict()
        for name, mean in self._mean.state_dict().items():
            if mean.is_floating_point():
                mean.lerp_(weights[name], share)
            else:
                mean.copy_(weights[name])

    def epoch(self, epoch: Epoch) -> None:
        """Nothing: a mean of steps knows no epochs."""

    @contextmanager
    def applied(self) -> Iterator[None]:
        """Let the model have the mean in the place of its weights."""
        fitted, self._model.classifier = self._model.classifier, self._mean
        try:
            yield
        finally:
            self._model.classifier = fitted

    def state_dict(self) -> dict[str, Any]:
        """All that changes."""
        return {"mean": self._mean.state_dict(), "steps": self._steps}

    def load_state_dict(self, saved: dict[str, Any]) -> None:
        """Go on from what :meth:`state_dict` gave."""
        self._mean.load_state_dict(saved["mean"])
        self._steps = saved["steps"]


def make_progress(console: Console) -> Progress:
    """Show progress on ``console``; without a terminal, its end alone."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[note]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=console,
    )


class FitProgress:
    """Shows one fit as one bar, with its validation accuracy."""

    def __init__(self, progress: Progress, name: str, epochs: int) -> None:
        self._progress, self._epochs = progress, epochs
        self._task: TaskID = progress.add_task(name, start=False, total=None, note="")

    def step(self, epoch: int, done: int, steps: int) -> None:
        """Move the bar; its clock starts with the first step."""
        self._progress.start_task(self._task)
        self._progress.update(
            self._task, total=self._epochs * steps, completed=epoch * steps + done
        )

    def epoch(self, epoch: Epoch) -> None:
        """Show how well it does."""
        note = f"epoch {epoch.number + 1}  validation {100 * epoch.validation_accuracy:.2f} %"
        self._progress.update(self._task, note=note)


class TensorBoardLog:
    """Writes accuracies and losses of one run into ``folder``. No mask is ever logged."""

    def __init__(self, folder: Path) -> None:
        from torch.utils.tensorboard import SummaryWriter  # noqa: PLC0415 - slow to import

        self._writer = SummaryWriter(str(folder))

    def step(self, epoch: int, done: int, steps: int) -> None:
        """Nothing: one point for each epoch is enough."""

    def epoch(self, epoch: Epoch) -> None:
        """Write one point of each curve."""
        for name, value in (
            ("loss/training", epoch.loss),
            ("loss/validation", epoch.validation_loss),
            ("accuracy/training", epoch.training_accuracy),
            ("accuracy/validation", epoch.validation_accuracy),
            ("seconds", epoch.seconds),
        ):
            self._writer.add_scalar(name, value, epoch.number + 1)
        self._writer.flush()


class CsvLog:
    """Writes accuracies and losses of one run into a file, a row for each epoch. No mask is logged.

    A run that is taken up goes on in it; rows of epochs that are done again are replaced.
    """

    COLUMNS = (
        *("epoch", "training_loss", "validation_loss"),
        *("training_accuracy", "validation_accuracy", "seconds"),
    )

    def __init__(self, path: Path) -> None:
        self._path = path

    def step(self, epoch: int, done: int, steps: int) -> None:
        """Nothing: one row for each epoch is enough."""

    def epoch(self, epoch: Epoch) -> None:
        """Write one row."""
        content = self._path.read_text() if self._path.exists() else ""
        earlier = [row for row in csv.reader(io.StringIO(content)) if row and row[0].isdigit()]
        rows: list[Sequence[object]] = [
            self.COLUMNS,
            *(row for row in earlier if int(row[0]) <= epoch.number),
            (
                epoch.number + 1,
                epoch.loss,
                epoch.validation_loss,
                epoch.training_accuracy,
                epoch.validation_accuracy,
                epoch.seconds,
            ),
        ]
        written = io.StringIO()
        csv.writer(written, lineterminator="\n").writerows(rows)
        write_whole(self._path, written.getvalue().encode())
