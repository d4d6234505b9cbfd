"""Data sets are read as published, and a bad file is a clear error."""

from __future__ import annotations

import gzip
from pathlib import Path

import pytest
import torch

from veilcam_training.data import Images, open_source, split
from veilcam_training.data.idx import idx_bytes
from veilcam_training.errors import TrainingError

IMAGES, LABELS = "train-images-idx3-ubyte", "train-labels-idx1-ubyte"


def test_idx_files_come_back_packed_or_not(plain_folder: Path) -> None:
    source = open_source("mnist", plain_folder)
    plain = source.training()
    # MNIST's own header: magic number 2051, then the sizes, big-endian.
    raw = (plain_folder / IMAGES).read_bytes()
    assert raw[:16] == bytes.fromhex("00000803 0000001e 0000001c 0000001c")
    assert bytes(plain.pixels.numpy().tobytes()) == raw[16:]
    assert (plain_folder / LABELS).read_bytes()[8:] == bytes(plain.labels.tolist())
    assert len(source.test()) == 20
    scenes = plain.scenes()
    assert scenes.dtype == torch.float32
    assert float(scenes.max()) == 1.0
    digests = source.digests()
    assert len(digests) == 4
    for path in list(plain_folder.iterdir()):
        path.with_name(f"{path.name}.gz").write_bytes(gzip.compress(path.read_bytes()))
        path.unlink()
    packed = source.training()
    torch.testing.assert_close(packed.pixels, plain.pixels)
    torch.testing.assert_close(packed.labels, plain.labels)


def test_unknown_name_and_missing_folder(tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match="use one of mnist"):
        open_source("imagenet", tmp_path)
    with pytest.raises(TrainingError, match="not a folder"):
        open_source("mnist", tmp_path / "none")
    assert open_source("fashion", tmp_path).labels[9] == "ankle boot"


def zeros(*shape: int) -> bytes:
    return idx_bytes(torch.zeros(shape, dtype=torch.uint8))


@pytest.mark.parametrize(
    ("name", "data", "reason"),
    [
        *((IMAGES, data, "not an idx file") for data in (b"", b"<html>", zeros(30, 28, 28)[:9])),
        (IMAGES, zeros(30, 28, 28)[:-1], "bytes but says"),
        (IMAGES, zeros(30, 28, 28) + b"x", "bytes but says"),
        (IMAGES, zeros(30), "not an idx file of bytes with 3"),
        (IMAGES, zeros(29, 28, 28), "29 images but .* 30 labels"),
        (IMAGES, zeros(30, 20, 28), r"use \(28, 28\)"),
        (LABELS, idx_bytes(torch.full((30,), 10, dtype=torch.uint8)), "label 10: use 0 to 9"),
    ],
)
def test_corrupt_files(plain_folder: Path, name: str, data: bytes, reason: str) -> None:
    (plain_folder / name).unlink()
    with pytest.raises(TrainingError, match=f"{name}.* is missing: give the folder"):
        open_source("mnist", plain_folder).training()
    for damaged in (gzip.compress(data)[:-12], b"no gzip"):
        (plain_folder / f"{name}.gz").write_bytes(damaged)
        with pytest.raises(TrainingError, match="damaged"):
            open_source("mnist", plain_folder).training()
    (plain_folder / f"{name}.gz").unlink()
    (plain_folder / name).write_bytes(data)
    with pytest.raises(TrainingError, match=reason) as caught:
        open_source("mnist", plain_folder).training()
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


def numbered(count: int) -> Images:
    return Images(torch.zeros(count, 1, 1, dtype=torch.uint8), torch.arange(count))


def test_split_is_fixed_and_its_parts_are_disjoint() -> None:
    torch.manual_seed(1)
    first = split(numbered(100))
    torch.manual_seed(2)
    second = split(numbered(100))
    assert len(first.validation) == 10
    torch.testing.assert_close(first.validation.labels, second.validation.labels)
    together = torch.cat([first.training.labels, first.validation.labels])
    assert sorted(together.tolist()) == list(range(100))
    assert len(split(numbered(100), 0.3).validation) == 30


@pytest.mark.parametrize("share", [0.0, 1.0, 0.001])
def test_split_with_an_empty_part(share: float) -> None:
    with pytest.raises(TrainingError, match="both parts"):
        split(numbered(100), share)
    with pytest.raises(TrainingError, match="2 images but 3 labels"):
        Images(torch.zeros(2, 1, 1, dtype=torch.uint8), torch.zeros(3, dtype=torch.int64))
