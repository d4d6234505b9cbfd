"""Which device computes."""

from __future__ import annotations

import torch

from veilcam_training.errors import TrainingError


def choose_device(name: str) -> torch.device:
    """The device called ``name``: cpu, cuda, or auto for cuda if there is one.

    Raises:
        TrainingError: an unknown name, or CUDA where there is none.
    """
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    if name not in ("cpu", "cuda"):
        raise TrainingError(f"--device {name} is not valid: use cpu, cuda or auto")
    if name == "cuda" and not torch.cuda.is_available():
        raise TrainingError("--device cuda is not valid: torch sees no CUDA device; use cpu")
    return torch.device(name)
