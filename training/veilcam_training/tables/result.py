"""What a finished cell leaves behind: its numbers as JSON, its pictures, and its bundle."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, JsonValue, ValidationError

from veilcam_training.bundle import Bundle, write_bundle
from veilcam_training.errors import TrainingError
from veilcam_training.figures import Origin
from veilcam_training.job import Settings
from veilcam_training.tables.cell import Cell
from veilcam_training.tables.pictures import Pictures, save_pictures
from veilcam_training.tables.stopwatch import Clock

RESULT = "result.json"
PICTURES = "pictures.npz"
BUNDLE = "pair.veilcam"
CHECKPOINT = "checkpoint"


class EpochRecord(BaseModel):
    """One epoch's accuracies in [0, 1]."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    loss: float
    training_accuracy: float
    validation_accuracy: float
    validation_loss: float


class CellResult(BaseModel):
    """The numbers of a finished cell; accuracies in [0, 1]."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    settings: Settings
    fingerprint: str
    """Of all that the numbers depend on."""
    labels: tuple[str, ...]
    test_set: str
    test_accuracy: float
    validation_accuracy: float
    best_epoch: int
    """From 0."""
    epochs: tuple[EpochRecord, ...]
    confusion: tuple[tuple[int, ...], ...]
    """Of the test set: a row for each true class, a column for each predicted one."""
    seconds: float
    """All epochs together."""
    clock: Clock = "elapsed"
    """Which measured ``seconds``, see :class:`~veilcam_training.tables.stopwatch.Stopwatch`."""
    inference_seconds: float
    """From one reading to its label, see :func:`~veilcam_training.tables.inference.time_label`."""
    device: str
    origin: Origin
    provenance: dict[str, JsonValue]

    @property
    def cell(self) -> Cell:
        """Where it belongs."""
        return Cell(self.settings)

    def numbers(self) -> dict[str, Any]:
        """What another run with the same seed must give again: all but times and origin."""
        changing = {"seconds", "clock", "inference_seconds", "device", "origin", "provenance"}
        return self.model_dump(mode="json", exclude=changing)


@dataclass(frozen=True)
class Finished:
    """All of a finished cell; a camera without a panel has no bundle."""

    result: CellResult
    pictures: Pictures
    bundle: Bundle | None


def save_finished(work: Path, finished: Finished) -> None:
    """Write a cell into its folder in ``work``; its numbers come last and say that all is there."""
    folder = cell_folder(work, finished.result.cell)
    folder.mkdir(parents=True, exist_ok=True)
    if finished.bundle is not None:
        write_bundle(folder / BUNDLE, finished.bundle)
    save_pictures(folder / PICTURES, finished.pictures)
    temporary = folder / f".{RESULT}.{os.getpid()}"
    with temporary.open("w") as stream:
        stream.write(finished.result.model_dump_json(indent=1) + "\n")
        stream.flush()
        os.fsync(stream.fileno())
    temporary.replace(folder / RESULT)
    (folder / CHECKPOINT).unlink(missing_ok=True)


def load_result(work: Path, cell: Cell, fingerprint: str) -> CellResult | None:
    """The result of ``cell``, or None if it is not finished.

    Raises:
        TrainingError: the file is damaged, or of other settings, data or torch.
    """
    path = cell_folder(work, cell) / RESULT
    if not path.exists():
        return None
    result = _read(path)
    if result.fingerprint != fingerprint:
        raise TrainingError(
            f"{path.parent} was made with other settings, data or torch: "
            "remove it to run it again, or use another --work"
        )
    return result


def load_results(work: Path) -> Iterator[CellResult]:
    """Every finished cell in ``work``, whatever its settings, by name.

    Raises:
        TrainingError: a file is damaged.
    """
    for path in sorted(work.glob(f"*/{RESULT}")):
        yield _read(path)


def cell_folder(work: Path, cell: Cell) -> Path:
    """Folder of ``cell`` in the folder ``work``."""
    return work / cell.name


def _read(path: Path) -> CellResult:
    try:
        return CellResult.model_validate_json(path.read_text())
    except (OSError, UnicodeDecodeError, ValidationError):
        raise TrainingError(
            f"{path} is not the result of a cell: remove {path.parent} to run it again"
        ) from None
