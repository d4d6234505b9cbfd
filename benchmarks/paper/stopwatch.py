"""Times of a fit, whatever else the machine does meanwhile, and of one measurement's label."""

import time
from collections.abc import Sequence
from typing import Literal

import torch
from torch import nn
from torch.utils.benchmark import Timer

from veilcam_training.models.whitening import plain
from veilcam_training.trainer.callbacks import Callback, Epoch

Clock = Literal["processor", "elapsed"]
"""Time that the processor spent on this process, or time that went by."""


class Stopwatch(Callback):
    """Starts when it is made, and watches the epochs of a fit.

    On a CPU it takes the processor's time, so that neighbours do not count; a GPU works beside the
    processor, there it takes the time that goes by.
    """

    def __init__(self, device: torch.device) -> None:
        self._clock: Clock = "processor" if device.type == "cpu" else "elapsed"
        self._started = self._first = self._ended = self._now()
        self._first_share = 0.0
        self._epochs = 0

    def step(self, epoch: int, done: int, steps: int) -> None:  # noqa: ARG002 - part of the interface
        """Take the time after the first step: what was prepared before it is done once only."""
        if self._first_share == 0:
            self._first, self._first_share = self._now(), done / steps

    def epoch(self, epoch: Epoch) -> None:  # noqa: ARG002 - part of the interface
        """Take the time at the end of an epoch."""
        self._ended = self._now()
        self._epochs += 1

    def read(self, history: Sequence[Epoch]) -> tuple[float, Clock]:
        """Seconds of all epochs in ``history`` and of what was prepared, and by which clock.

        An earlier process may have done the first epochs: they are taken to be as long as those
        that were watched. If it did them all, only the time that went by in them is known.
        """
        if self._epochs == 0:
            return sum(epoch.seconds for epoch in history), "elapsed"
        whole, steady = self._ended - self._started, self._ended - self._first
        share = self._epochs - self._first_share
        each = steady / share if share > 0 else whole  # of one step alone
        return whole + each * (len(history) - self._epochs), self._clock

    def _now(self) -> float:
        return time.process_time() if self._clock == "processor" else time.monotonic()


class EpochLines(Callback):
    """A line for every epoch, for runs whose output goes to a file.

    Args:
        name: name of the cell.
    """

    def __init__(self, name: str) -> None:
        self._name = name

    def epoch(self, epoch: Epoch) -> None:
        """Print the line."""
        print(
            f"{self._name}  epoch {epoch.number + 1}  loss {epoch.loss:.4f}  "
            f"validation {100 * epoch.validation_accuracy:.2f} %  {epoch.seconds:.0f} s",
            flush=True,
        )


@torch.inference_mode()
def time_label(classifier: nn.Module, inputs: int) -> float:
    """Seconds from one measurement of ``inputs`` numbers to its label: the median of many.

    On the CPU, with one thread and one measurement at a time, as a device without a GPU does it.
    """
    used = {"classifier": plain(classifier).cpu().eval(), "measurement": torch.rand(1, inputs)}
    timer = Timer("int(classifier(measurement).argmax())", globals=used, num_threads=1)
    return timer.blocked_autorange().median
