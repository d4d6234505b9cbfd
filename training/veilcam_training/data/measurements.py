"""Labelled measurements of a camera, as 'veilcam collect' keeps them.

JSON lines: docs/adaptation.md. The SDK writes them, and training, which does not know the SDK,
reads them; ``tests/unit/training/data/test_measurements.py`` holds the two against each other.
"""

import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import torch
from pydantic import BaseModel, Field, ValidationError
from torch import Tensor

from veilcam_training.errors import TrainingError, require

MAX_BYTES = 2**30
"""Of a file: some 100,000 measurements of 24 x 32."""

Hex = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]


class Header(BaseModel, frozen=True, extra="ignore"):
    """The first line, as far as training reads it; open to what a later version adds."""

    format: Literal["veilcam-measurements"]
    version: Literal[1]
    device: Hex
    bundle: Hex
    mode: Literal["pairs", "fresh"]
    labels: tuple[str, ...]
    shape: tuple[Annotated[int, Field(ge=1)], ...]


class Measured(BaseModel, frozen=True, extra="ignore"):
    """Every other line, as far as training reads it; open to what a later version adds."""

    label: str
    epoch: str
    values: tuple[Annotated[float, Field(allow_inf_nan=False)], ...] = Field(repr=False)
    mask_key: Hex | None = Field(default=None, repr=False)


@dataclass(frozen=True)
class Measurements:
    """Contents of a file, in its order."""

    header: Header
    values: Tensor = field(repr=False)
    """float32 (count, numbers of an embedding)."""
    labels: Tensor
    """int64 (count,), indices into the header's."""
    epochs: tuple[str, ...]
    """One for each measurement."""
    mask_keys: dict[str, bytes] = field(repr=False)
    """Of every epoch behind a fresh mask: what its levels are drawn from."""
    digest: str
    """SHA-256 of the file."""

    def __len__(self) -> int:
        return len(self.labels)


def read_measurements(path: Path) -> Measurements:
    """Read a file of measurements. A last line that was cut off is left out, as collecting does.

    Raises:
        TrainingError: the file cannot be read, or holds something else. No message repeats a
            number of it.
    """
    try:
        size = path.stat().st_size
        require(size <= MAX_BYTES, f"{path} is larger than {MAX_BYTES >> 20} MiB: use a part of it")
        content = path.read_bytes()
    except OSError as error:
        raise TrainingError(f"{path} cannot be read ({error.strerror}): check the path") from None
    first, *lines = content.split(b"\n")[:-1] or [b""]
    try:
        header = Header.model_validate_json(first)
    except ValidationError:
        raise TrainingError(
            f"{path} is no file of measurements: make one with 'veilcam collect'"
        ) from None
    found = [_measured(path, number, line, header) for number, line in enumerate(lines, 2)]
    require(len(found) > 0, f"{path} holds no measurements: go on with 'veilcam collect'")
    return Measurements(
        header,
        torch.tensor([each.values for each in found], dtype=torch.float32),
        torch.tensor([header.labels.index(each.label) for each in found]),
        tuple(each.epoch for each in found),
        {each.epoch: bytes.fromhex(each.mask_key) for each in found if each.mask_key is not None},
        hashlib.sha256(content).hexdigest(),
    )


def _measured(path: Path, number: int, line: bytes, header: Header) -> Measured:
    size = 1
    for length in header.shape:
        size *= length
    try:
        measured = Measured.model_validate_json(line)
    except ValidationError:
        measured = None
    if (
        measured is None
        or len(measured.values) != size
        or measured.label not in header.labels
        or (measured.mask_key is None) != (header.mode == "pairs")
    ):
        raise TrainingError(f"{path}, line {number}: this is no measurement: remove it")
    return measured
