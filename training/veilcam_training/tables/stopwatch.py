"""How long a fit takes, whatever else the machine does meanwhile."""

from __future__ import annotations

import time
from collections.abc import Sequence

import torch

from veilcam_training.fitting import Epoch


class Stopwatch:
    """Starts when it is made, and watches the epochs of a fit.

    On a CPU it takes the time that the processor spent on this process, so that its neighbours do
    not count; on a GPU, which works beside the processor, the time that went by.
    """

    def __init__(self, device: torch.device) -> None:
        self._clock = time.process_time if device.type == "cpu" else time.monotonic
        self._started = self._ended = self._clock()
        self._epochs = 0

    def step(self, epoch: int, done: int, steps: int) -> None:
        """Epochs are counted, not steps."""

    def epoch(self, epoch: Epoch) -> None:
        """Take the time at the end of an epoch."""
        del epoch
        self._ended = self._clock()
        self._epochs += 1

    def seconds(self, history: Sequence[Epoch]) -> float:
        """Of all epochs in ``history``, of which an earlier process may have done the first ones.

        If it did them all, the time that went by in them.
        """
        if self._epochs == 0:
            return sum(epoch.seconds for epoch in history)
        return (self._ended - self._started) / self._epochs * len(history)
