"""MNIST and Fashion-MNIST in their published idx files, packed with gzip or not.

The format: two zero bytes, 8 for unsigned bytes, the number of dimensions, every dimension as a
big-endian 32-bit number, then the bytes (http://yann.lecun.com/exdb/mnist).
"""

import gzip
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Scene
from veilcam_training.data.base import FileSource, Images, digest, find
from veilcam_training.errors import TrainingError, require

DIGITS = tuple("0123456789")
CLOTHES = (
    "T-shirt",
    "trouser",
    "pullover",
    "dress",
    "coat",
    "sandal",
    "shirt",
    "sneaker",
    "bag",
    "ankle boot",
)
MAX_BYTES = 2**30


def read_idx(path: Path, dimensions: int) -> Tensor:
    """Read an idx file of unsigned bytes.

    Args:
        path: plain, or with gzip if the name ends in ``.gz``.
        dimensions: number of axes that the file must have.

    Returns:
        uint8 tensor of the shape that the file says.

    Raises:
        TrainingError: the file is missing, damaged, or not such a file.
    """
    try:
        with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as stream:
            data = stream.read(MAX_BYTES + 1)
    except FileNotFoundError:
        raise TrainingError(f"{path} is missing: give the folder that holds it as --data") from None
    except (OSError, EOFError, zlib.error) as error:
        raise TrainingError(f"{path} is damaged ({error}): fetch it again") from None
    header = 4 + 4 * dimensions
    require(
        data[:4] == bytes([0, 0, 8, dimensions]) and len(data) >= header,
        f"{path} is not an idx file of bytes with {dimensions} dimensions: fetch it again",
    )
    shape = tuple(int(size) for size in np.frombuffer(data, ">u4", dimensions, 4))
    expected = header + int(np.prod(shape, dtype=np.uint64))
    require(
        len(data) == expected, f"{path} has {len(data)} bytes but says {expected}: fetch it again"
    )
    pixels = np.frombuffer(data, np.uint8, offset=header).reshape(shape)
    return torch.from_numpy(pixels.copy())


def idx_bytes(array: Tensor) -> bytes:
    """Return ``array``, uint8 of any shape, as the content of an idx file."""
    header = bytes([0, 0, 8, array.ndim]) + struct.pack(f">{array.ndim}I", *array.shape)
    return header + array.contiguous().numpy().tobytes()


@dataclass(frozen=True)
class IdxSource(FileSource):
    """Four idx files in one folder."""

    name: str
    labels: tuple[str, ...]
    folder: Path
    scene: Scene = field(default_factory=Scene)
    colour: bool = False

    def digests(self) -> Mapping[str, str]:
        """SHA-256 of each of the four files, by its name."""
        paths = [path for part in ("train", "t10k") for path in self._paths(part)]
        return {path.name: digest(path) for path in paths}

    def _paths(self, part: str) -> tuple[Path, Path]:
        names = (f"{part}-images-idx3-ubyte", f"{part}-labels-idx1-ubyte")
        images, labels = (find(self.folder / n, self.folder / f"{n}.gz") for n in names)
        return images, labels

    def _read(self, *, test: bool) -> Images:
        images_path, labels_path = self._paths("t10k" if test else "train")
        images, labels = read_idx(images_path, 3), read_idx(labels_path, 1)
        require(
            len(images) == len(labels) > 0,
            f"{images_path} has {len(images)} images but {labels_path.name} {len(labels)} "
            "labels: fetch both again",
        )
        require(
            tuple(images.shape[1:]) == self.scene.shape,
            f"{images_path} has images of {tuple(images.shape[1:])}: use {self.scene.shape}",
        )
        require(
            int(labels.max()) < len(self.labels),
            f"{labels_path} has label {int(labels.max())}: use 0 to {len(self.labels) - 1}",
        )
        return Images(images, labels.long())
