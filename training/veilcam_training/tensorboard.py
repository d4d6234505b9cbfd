"""Logs that TensorBoard shows: accuracies and losses of every epoch. No mask is ever logged."""

from __future__ import annotations

from pathlib import Path

from torch.utils.tensorboard import SummaryWriter

from veilcam_training.fitting import Epoch


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
