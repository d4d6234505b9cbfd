"""Fixtures for the tests of training."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from veilcam_training.data import Images, Source, open_source
from veilcam_training.data.idx import idx_bytes
from veilcam_training.seeding import stream


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


def write_faces(folder: Path, **changes: Any) -> Path:
    """Write ``faces.npz``: 120 faces of 40 people; ``changes`` replace its arrays."""
    random = np.random.default_rng(0)
    content: dict[str, Any] = {
        "images": random.integers(0, 256, (120, 64, 52), dtype=np.uint8),
        "identity": np.repeat(np.arange(40), 3),
        "female": random.integers(0, 2, 120),
        "smiling": random.integers(0, 2, 120).astype(bool),
        "glasses": random.integers(0, 2, 120),
    }
    content.update(changes)
    np.savez(folder / "faces.npz", **{k: v for k, v in content.items() if v is not None})
    return folder


def write_cifar10(folder: Path, count: int = 4) -> Path:
    """Write the six binary files of CIFAR-10, ``count`` images each."""
    folder.mkdir(exist_ok=True)
    random = np.random.default_rng(0)
    for name in (*(f"data_batch_{n}" for n in range(1, 6)), "test_batch"):
        records = random.integers(0, 256, (count, 3073), dtype=np.uint8)
        records[:, 0] %= 10
        (folder / f"{name}.bin").write_bytes(records.tobytes())
    return folder


def write_celeba(folder: Path, count: int = 40) -> Path:
    """Write ``count`` photographs and their attributes as CelebA has them."""
    random = np.random.default_rng(0)
    images = folder / "img_align_celeba"
    images.mkdir()
    lines = [str(count), "5_o_Clock_Shadow Male Smiling Young"]
    for number in range(1, count + 1):
        name = f"{number:06d}.jpg"
        male, smiling = number % 4 == 0, number % 2 == 0
        shade = 200 if male else 60
        pixels = random.integers(shade - 20, shade + 20, (218, 178, 3), dtype=np.uint8)
        Image.fromarray(pixels).save(images / name, quality=90)
        lines.append(f"{name} -1 {1 if male else -1:2d} {1 if smiling else -1:2d}  1")
    (folder / "list_attr_celeba.txt").write_text("\n".join(lines) + "\n")
    return folder


Writer = Callable[..., Path]


@pytest.fixture
def faces_file() -> Writer:
    """Writes drawn faces into a folder, which it returns."""
    return write_faces


@pytest.fixture
def cifar_files() -> Writer:
    """Writes CIFAR-10 into a folder, which it returns."""
    return write_cifar10


@pytest.fixture
def celeba_files() -> Writer:
    """Writes CelebA into a folder, which it returns."""
    return write_celeba


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
