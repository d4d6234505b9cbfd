"""Faces, CIFAR-10 and CelebA are read from small files in their published formats."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from veilcam_optics.camera.geometry import Camera
from veilcam_training.bundle import read_bundle, write_bundle
from veilcam_training.config.settings import FitSettings
from veilcam_training.data import SOURCES, open_source, split
from veilcam_training.data.base import stratified
from veilcam_training.data.celeba import CelebaSource
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.fit import run_fit
from veilcam_training.experiments.keyring import as_bundle
from veilcam_training.models.network import build_classifier

Writer = Callable[..., Path]
THIRDS = np.arange(120) / 3
FILES = ("cifar_files", "celeba_files", "faces_file")


@pytest.mark.parametrize("task", ["gender", "smiling", "glasses"])
def test_faces(faces_file: Writer, tmp_path: Path, task: str) -> None:
    source = open_source(f"faces-{task}", faces_file(tmp_path))
    training, test = source.training(), source.test()
    assert len(training) == 102
    assert len(test) == 18
    with np.load(tmp_path / "faces.npz") as content:
        column = content["female" if task == "gender" else task].astype(int)
        for images in (training, test):
            for pixels, label in zip(images.pixels, images.labels, strict=True):
                index = int((content["images"] == pixels.numpy()).all((1, 2)).argmax())
                assert int(label) == column[index]
    # No identity is in two of the three parts.
    parts = split(training)
    groups = [set(p.groups.tolist()) for p in (parts.training, parts.validation, test)]  # type: ignore[union-attr]
    assert not groups[0] & groups[1]
    assert not (groups[0] | groups[1]) & groups[2]
    assert len(groups[0] | groups[1] | groups[2]) == 40
    assert len(source.labels) == 2
    assert set(source.digests()) == {"faces.npz"}


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"female": None}, "lacks images, female or identity"),
        ({"images": np.uint8(3)}, r"images uint8 \(\): use uint8 \(count, 64, 52\)"),
        ({"images": np.zeros((0, 64, 52), np.uint8)}, r"images uint8 \(0, 64, 52\): use"),
        ({"identity": np.arange(3)}, r"identity int64 \(3,\): use a whole number for each"),
        ({"identity": np.int64(3)}, r"identity int64 \(\): use a whole number for each of the 120"),
        *(({"identity": bad}, "identity float64") for bad in (np.full(120, np.nan), THIRDS)),
        ({"identity": np.full(120, "Ada")}, "identity <U3"),
        ({"identity": np.full(120, None)}, "damaged"),
        ({"female": np.int64(1)}, r"female int64 \(\)"),
        ({"female": np.full(120, "1")}, "female <U1"),
        ({"female": np.full(120, np.nan)}, "female float64"),
        *(({"female": np.full(120, value)}, "other than 0 and 1") for value in (-1, 2)),
        ({"images": np.zeros((120, 64, 50), np.uint8)}, r"use uint8 \(count, 64, 52\)"),
        ({"images": np.zeros((120, 64, 52))}, "use uint8"),
    ],
)
def test_bad_face(faces_file: Writer, tmp_path: Path, changes: dict[str, Any], reason: str) -> None:
    source = open_source("faces-gender", faces_file(tmp_path, **changes))
    with pytest.raises(TrainingError, match=reason) as caught:
        source.training()
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("people", [1, 3])
def test_too_few_people(faces_file: Writer, tmp_path: Path, people: int) -> None:
    source = open_source("faces-gender", faces_file(tmp_path, identity=np.arange(120) % people))
    for read in (source.training, source.test):
        with pytest.raises(TrainingError, match=rf"z has groups: {people}, .* use more of them"):
            read()


def test_missing_and_broken_faces(tmp_path: Path) -> None:
    source = open_source("faces-gender", tmp_path)
    for read in (source.training, source.digests):
        with pytest.raises(TrainingError, match="missing"):
            read()
    with (tmp_path / "array.npy").open("wb") as file:
        np.save(file, np.zeros((120, 64, 52), np.uint8))
    for data in (b"", b"PK\x03\x04", b"images", (tmp_path / "array.npy").read_bytes()):
        (tmp_path / "faces.npz").write_bytes(data)
        with pytest.raises(TrainingError, match="damaged"):
            source.training()


@pytest.mark.slow
def test_faces_with_a_wrong_byte(faces_file: Writer, tmp_path: Path) -> None:
    """numpy and zipfile raise all kinds of errors; here it is one, or the byte did not matter."""
    path = faces_file(tmp_path, images=np.zeros((120, 64, 52), np.uint8)) / "faces.npz"
    with np.load(path) as content:
        np.savez_compressed(path, **content)
    whole, source = path.read_bytes(), open_source("faces-gender", tmp_path)
    refused: list[str] = []
    for at in range(0, len(whole), 3):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0x48]) + whole[at + 1 :])
        try:
            source.training()
        except TrainingError as error:
            refused.append(str(error))
    assert len(refused) > len(whole) / 6
    assert "\n" not in "".join(refused)


@pytest.mark.parametrize("inside", ["", "cifar-10-batches-bin"])
def test_cifar10(cifar_files: Writer, tmp_path: Path, inside: str) -> None:
    files = cifar_files(tmp_path / inside)
    source = open_source("cifar10", tmp_path)
    training, test = source.training(), source.test()
    assert training.pixels.shape == (20, 3, 32, 32)
    assert len(test) == 4
    raw = (files / "data_batch_2.bin").read_bytes()
    assert int(training.labels[4]) == raw[0]
    # Green, row 1, column 2 of the first record of the second batch.
    assert int(training.pixels[4, 1, 1, 2]) == raw[1 + 1024 + 32 + 2]
    assert source.colour
    assert source.labels[3] == "cat"
    assert len(source.digests()) == 6


def test_bad_cifar10(cifar_files: Writer, tmp_path: Path) -> None:
    cifar_files(tmp_path)
    path = tmp_path / "data_batch_3.bin"
    data = path.read_bytes()
    for bad, reason in (
        (data[:-1], "not a multiple of 3073"),
        (b"", "not a multiple of 3073"),
        (b"\x0b" + data[1:], "label 11: use 0 to 9"),
    ):
        path.write_bytes(bad)
        with pytest.raises(TrainingError, match=reason):
            open_source("cifar10", tmp_path).training()
    path.unlink()
    source = open_source("cifar10", tmp_path)
    for read in (source.training, source.digests):
        with pytest.raises(TrainingError, match=r"data_batch_3.bin is missing"):
            read()


def test_celeba(celeba_files: Writer, tmp_path: Path) -> None:
    source = open_source("celeba-gender", celeba_files(tmp_path))
    training, test = source.training(), source.test()
    assert training.pixels.shape == (34, 64, 52)
    assert len(test) == 6
    # 10 of 40 are male, and 85 to 15 of either class are kept apart.
    assert int(training.labels.sum()) == 8
    assert int(test.labels.sum()) == 2
    # The photograph belongs to its label.
    bright = torch.cat([training.pixels, test.pixels]).float().mean((1, 2)) > 130
    assert torch.equal(bright.long(), torch.cat([training.labels, test.labels]))
    assert source.labels == ("female", "male")
    assert int(open_source("celeba-smiling", tmp_path).training().labels.sum()) == 17
    before = source.digests()
    assert set(before) == {"list_attr_celeba.txt", "img_align_celeba"}
    Image.new("RGB", (178, 218)).save(tmp_path / "img_align_celeba" / "000007.jpg")
    assert source.digests() != before
    first = CelebaSource("celeba-smiling", tmp_path, first=20)
    assert len(first.training()) + len(first.test()) == 20
    with pytest.raises(TrainingError, match="use more of them"):
        stratified(torch.tensor([0] * 50 + [1]), 0.15, where=Path(), classes=2)


def test_bad_celeba(celeba_files: Writer, tmp_path: Path) -> None:
    source = open_source("celeba-gender", celeba_files(tmp_path))
    photograph = tmp_path / "img_align_celeba" / "000005.jpg"
    data = photograph.read_bytes()
    for bad in (b"", data[:300], b"GIF89a"):
        photograph.write_bytes(bad)
        with pytest.raises(TrainingError, match=r"000005.jpg is damaged"):
            [source.training(), source.test()]
    for size in ((178, 100), (218, 178), (32, 32)):
        Image.new("RGB", size).save(photograph)
        with pytest.raises(TrainingError, match=r"000005.jpg has .* use the aligned .* 218 x 178"):
            [source.training(), source.test()]
    frame = data.index(b"\xff\xc0") + 5  # where a JPEG says how many rows and columns it has
    photograph.write_bytes(data[:frame] + b"\xff\xff\xff\xff" + data[frame + 4 :])
    with pytest.raises(TrainingError, match=r"000005.jpg is damaged"):
        [source.training(), source.test()]
    photograph.unlink()
    with pytest.raises(TrainingError, match=r"unpack img_align_celeba.zip there"):
        [source.training(), source.test()]
    table = tmp_path / "list_attr_celeba.txt"
    text = table.read_text()
    for bad_text, reason in (
        ("", "has no column Male"),
        (text.replace("Male", "Mail"), "has no column Male"),
        (text.replace("000003.jpg -1 -1", "000003.jpg -1 0"), "line 5 is not valid"),
        (text.replace("000003.jpg", ""), "line 5 is not valid"),
        (text.replace("000003.jpg", "000001.jpg"), "line 5 repeats 000001.jpg"),
        ("\n".join(text.splitlines()[:22]), "has 20 photographs, not as many as its first line"),
        (text.replace("40", "41", 1), "has 40 photographs, not as many as its first line"),
        (text.replace("40", "forty", 1), "not as many as its first line"),
    ):
        table.write_text(bad_text)
        with pytest.raises(TrainingError, match=reason):
            source.training()
    table.unlink()
    with pytest.raises(TrainingError, match=r"list_attr_celeba.txt is missing"):
        source.training()


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("name", "files"),
    [
        ("cifar10", "cifar_files"),
        ("celeba-smiling", "celeba_files"),
        ("faces-glasses", "faces_file"),
    ],
)
def test_files_to_bundle(
    name: str, files: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    source = open_source(name, request.getfixturevalue(files)(tmp_path))
    settings = FitSettings(data=name, embedding="3x4", classifier="FC8", epochs=1, batch=8)
    outcome = run_fit(settings, source, Camera())
    assert 0 <= outcome.accuracy.value <= 1
    path = tmp_path / "a.veilcam"
    write_bundle(path, as_bundle([outcome], source, Camera()))
    bundle = read_bundle(path)
    assert bundle.labels == source.labels
    assert bundle.scene == source.scene
    assert bundle.channels == (3 if source.colour else 1)
    pair = bundle.pairs[0]
    logits = build_classifier(pair.layers, pair.weights)(torch.rand(2, bundle.inputs))
    assert logits.shape == (2, len(source.labels))


@pytest.mark.parametrize("name", [name for name in SOURCES if name != "image-folder"])
def test_every_source_says_what_it_is(name: str, tmp_path: Path) -> None:
    source = open_source(name, tmp_path)
    assert source.name == name
    assert len(set(source.labels)) == len(source.labels) >= 2
    assert source.scene.height > 0
    for read in (source.training, source.test):
        with pytest.raises(TrainingError, match="missing"):
            read()
