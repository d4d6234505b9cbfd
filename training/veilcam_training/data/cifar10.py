"""CIFAR-10 in its binary format (https://www.cs.toronto.edu/~kriz/cifar.html): no pickle.

Each record is a label byte and 3,072 bytes of pixels: red, green, blue, each row by row.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch

from veilcam_optics.camera.geometry import Scene
from veilcam_training.data.base import FileSource, Images, digest, find
from veilcam_training.errors import require

LABELS = (
    "airplane",
    "automobile",
    "bird",
    "cat",
    "deer",
    "dog",
    "frog",
    "horse",
    "ship",
    "truck",
)
TRAINING = tuple(f"data_batch_{number}.bin" for number in range(1, 6))
TEST = ("test_batch.bin",)
FOLDER = "cifar-10-batches-bin"
RECORD = 1 + 3 * 32 * 32


@dataclass(frozen=True)
class Cifar10Source(FileSource):
    """Six binary files, in the folder or in the one that the archive unpacks to."""

    folder: Path
    name: str = "cifar10"
    labels: tuple[str, ...] = LABELS
    scene: Scene = field(default_factory=lambda: Scene(32, 32, 0.25, 0.40))
    colour: bool = True

    def digests(self) -> Mapping[str, str]:
        """SHA-256 of each of the six files, by its name."""
        return {name: digest(self._path(name)) for name in (*TRAINING, *TEST)}

    def _path(self, name: str) -> Path:
        return find(self.folder / name, self.folder / FOLDER / name)

    def _read(self, *, test: bool) -> Images:
        records = []
        for name in TEST if test else TRAINING:
            data = self._path(name).read_bytes()
            require(
                len(data) > 0 and len(data) % RECORD == 0,
                f"{name} has {len(data)} bytes, not a multiple of {RECORD}: fetch it again "
                "(the binary version, not the Python one)",
            )
            batch = np.frombuffer(data, np.uint8).reshape(-1, RECORD)
            require(
                int(np.max(batch[:, 0])) < len(LABELS),
                f"{name} has label {int(np.max(batch[:, 0]))}: use 0 to 9; fetch it again",
            )
            records.append(batch)
        together = torch.from_numpy(np.concatenate(records))
        return Images(together[:, 1:].reshape(-1, 3, 32, 32).contiguous(), together[:, 0].long())
