"""Where a fit stands, on disk, so that a fit killed at any moment can be taken up again."""

from __future__ import annotations

import os
import pickle
from pathlib import Path
from typing import Any

import torch

from veilcam_training.errors import TrainingError


def save_checkpoint(path: Path, fingerprint: str, state: dict[str, Any]) -> None:
    """Write ``state`` so that ``path`` always holds a whole checkpoint, the old or the new one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    with temporary.open("wb") as stream:
        torch.save({"fingerprint": fingerprint, "state": state}, stream)
        stream.flush()
        os.fsync(stream.fileno())
    temporary.replace(path)


def load_checkpoint(path: Path, fingerprint: str) -> dict[str, Any] | None:
    """State of the checkpoint at ``path``, or None where there is none.

    Loading runs no code: torch takes nothing but tensors and plain values.

    Raises:
        TrainingError: it cannot be read, or belongs to another fit than ``fingerprint``.
    """
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        return None
    except (RuntimeError, EOFError, OSError, ValueError, pickle.UnpicklingError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise TrainingError(
            f"checkpoint {path} cannot be read ({reason}): remove it to start again"
        ) from None
    if not isinstance(content, dict) or content.get("fingerprint") != fingerprint:
        raise TrainingError(
            f"checkpoint {path} is of another fit (other data, settings or seed): "
            "remove it to start again, or use the settings that it was made with"
        )
    state: dict[str, Any] = content["state"]
    return state
