"""Logs that TensorBoard shows: accuracies and losses of every epoch. No mask is ever logged."""

from __future__ import annotations

from pathlib import Path

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
from torch.utils.tensorboard import SummaryWriter

from veilcam_training.trainer.loop import Epoch


def make_progress(console: Console) -> Progress:
    """A progress display on ``console``; without a terminal it shows its end alone."""
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
    """Observer that writes one run into ``folder``."""

    def __init__(self, folder: Path) -> None:
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
