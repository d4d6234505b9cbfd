"""What the tests of workers let them do; other processes import it, so it imports little."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import torch

from veilcam_training.errors import TrainingError


def place(_: object) -> tuple[int, int, torch.Tensor]:
    """Process, its threads, and a tensor that is to outlive it."""
    return os.getpid(), torch.get_num_threads(), torch.ones(1000)


def gpus(_: object) -> list[int]:
    import ray

    return [int(number) for number in ray.get_gpu_ids()]


def kill_once(folder: Path) -> int:
    """Count the attempts; the first one kills its worker. The number of threads."""
    if count(folder) == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return torch.get_num_threads()


def kill(folder: Path) -> None:
    count(folder)
    os.kill(os.getpid(), signal.SIGKILL)


def count(folder: Path) -> int:
    (folder / str(time.monotonic_ns())).touch()
    return len(list(folder.iterdir()))


def refuse(value: int) -> int:
    raise TrainingError(f"value = {value} is not valid")


def linger(folder: Path) -> None:
    """Say that it runs, then run for long."""
    (folder / "running").touch()
    time.sleep(100)
