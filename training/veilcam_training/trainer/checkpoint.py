"""Checkpoint of a fit on disk, so that a fit killed at any moment can be taken up again."""

import io
import pickle
from pathlib import Path
from typing import Any

import torch

from veilcam_training.errors import require
from veilcam_training.files import read_private, unreadable, write_private


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
