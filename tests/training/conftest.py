"""Fixtures for the tests of training."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest
import torch

from veilcam_training.data import Images, Source, open_source
from veilcam_training.data.idx import idx_bytes
from veilcam_training.randomness import stream


def make_digits(count: int, seed: int) -> Images:
    """Images of a bright bar, each class at its own place, on a noisy ground: an easy task."""
    generator = stream(seed, "digits")
    labels = torch.randint(0, 10, (count,), generator=generator)
    images = torch.randint(0, 60, (count, 28, 28), generator=generator, dtype=torch.uint8)
    for image, label in zip(images, labels.tolist(), strict=True):
        row, column = 4 + 10 * (label // 5), 2 + 5 * (label % 5)
        image[row : row + 8, column : column + 4] = 255
    return Images(images, labels)


def write_digits(folder: Path, training: int, test: int, *, packed: bool) -> Path:
    """Write such a set into ``folder``, in MNIST's format."""
    for part, count, seed in (("train", training, 1), ("t10k", test, 2)):
        images = make_digits(count, seed)
        for name, array in (("images-idx3", images.pixels), ("labels-idx1", images.labels)):
            data = idx_bytes(array.to(torch.uint8))
            path = folder / f"{part}-{name}-ubyte{'.gz' if packed else ''}"
            path.write_bytes(gzip.compress(data, 1) if packed else data)
    return folder


@pytest.fixture(scope="session")
def digit_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a small, easy data set in MNIST's format; not to be changed."""
    return write_digits(tmp_path_factory.mktemp("digits"), 900, 100, packed=True)


@pytest.fixture
def plain_folder(tmp_path: Path) -> Path:
    """A folder of one's own with 30 and 20 images, not packed."""
    folder = tmp_path / "plain"
    folder.mkdir()
    return write_digits(folder, 30, 20, packed=False)


@pytest.fixture(scope="session")
def source(digit_folder: Path) -> Source:
    """The data set of ``digit_folder``."""
    return open_source("mnist", digit_folder)
