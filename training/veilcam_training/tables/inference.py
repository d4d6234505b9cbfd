"""How long a classifier takes from a reading to a label."""

from __future__ import annotations

import time
from statistics import median

import torch
from torch import nn

from veilcam_training.decorrelation import plain

REPEATS = 100
WARM_UP = 10


@torch.inference_mode()
def time_label(classifier: nn.Module, inputs: int) -> float:
    """Seconds from one reading of ``inputs`` numbers to its label: the median of many.

    On the CPU, with one thread and one reading at a time, as a device without a GPU does it.
    """
    classifier = plain(classifier).cpu().eval()
    reading = torch.rand(1, inputs)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    times = []
    try:
        for _ in range(WARM_UP + REPEATS):
            started = time.perf_counter()
            int(classifier(reading).argmax())
            times.append(time.perf_counter() - started)
    finally:
        torch.set_num_threads(threads)
    return median(times[WARM_UP:])
