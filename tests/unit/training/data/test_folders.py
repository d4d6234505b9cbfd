"""Folders as people keep them: what is a part, what a class, and what is passed over."""

from __future__ import annotations

import os
import unicodedata
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from PIL import Image

from veilcam_training.data import open_source, recognise, split
from veilcam_training.data.summary import Summary, summarise
from veilcam_training.errors import TrainingError


def fill(folder: Path, count: int = 8, suffix: str = ".png") -> Path:
    """Make a folder of different pictures."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(count):
        pixels = np.random.default_rng(number).integers(0, 256, (6, 8), dtype=np.uint8)
        Image.fromarray(pixels).save(folder / f"{number}{suffix}")
    return folder


def classes(root: Path, *names: str, count: int = 8) -> None:
    for name in names or ("cat", "dog"):
        fill(root / name, count)


def summary(folder: Path) -> Summary:
    assert recognise(folder) == "image-folder"
    source = open_source("image-folder", folder)
    assert source.labels == ("cat", "dog")
    return summarise(source)


@pytest.mark.parametrize(
    ("train", "test"),
    [
        *(("train", "test"), ("Training", "Testing"), ("TRAIN", "Test")),
        *(("train", "val"), ("Train", "Valid"), ("training", "validation")),
    ],
)
def test_part_has_its_usual_name_in_any_case(tmp_path: Path, train: str, test: str) -> None:
    classes(tmp_path / train, count=9)
    classes(tmp_path / test, count=4)
    found = summary(tmp_path)
    assert (found.training, found.test) == ((9, 9), (4, 4))
    assert any("no test part" in remark for remark in found.remarks) == test.lower().startswith("v")


def test_validation_part_is_what_validates(tmp_path: Path) -> None:
    for part, count in (("train", 9), ("val", 3), ("test", 4)):
        classes(tmp_path / part, count=count)
    assert summary(tmp_path).test == (4, 4)
    parts = split(open_source("image-folder", tmp_path).training())
    assert (len(parts.training), len(parts.validation)) == (18, 6)
    lines = ["file,label,part"]
    for path in sorted(tmp_path.rglob("*.png")):
        part, label, _ = path.relative_to(tmp_path).parts
        lines.append(f"{path.relative_to(tmp_path)},{label},{part.upper()}")
    (tmp_path / "labels.csv").write_text("\n".join(lines))
    parts = split(open_source("image-folder", tmp_path).training())
    assert (len(parts.training), len(parts.validation)) == (18, 6)


def test_training_part_alone_tests_with_a_share(tmp_path: Path) -> None:
    classes(tmp_path / "train", count=20)
    found = summary(tmp_path)
    assert (found.training, found.test) == ((17, 17), (3, 3))
    assert any("only part" in remark for remark in found.remarks)


@pytest.mark.parametrize(
    ("folders", "said"),
    [
        (("train", "bus", "car"), "train as parts and bus, car as classes"),
        (("valid", "invalid"), "valid as parts and invalid as classes"),
        (("train/cat", "train/dog", "test"), "test is a part whose pictures lie in no folders"),
        (("train/cat", "train/dog", "Training/cat"), "both the train part"),
        (("val/cat", "test/cat"), "no train"),
        (("train2017/cat", "val2017/cat"), "train2017, val2017 may be parts"),
        (("train/cat", "train/dog", "test_2/cat", "test/cat"), "test_2 as classes"),
        (("split1", "split2"), "may be parts"),
        (("fold_a/cat", "fold_a/dog", "fold_b/cat", "fold_b/dog"), "both hold cat, dog"),
        (("cat/day", "dog/day"), "both hold day"),
        (("cat/train", "dog"), "the class cat holds train"),
        (("images/train/cat", "images/val/cat"), "give .*/images as --data"),
        (("pictures/cat", "pictures/dog"), "give .*/pictures as --data"),
        (("train/cat", "train/test", "test/cat", "test/test"), "test may be parts"),
    ],
)
def test_doubtful_layout_is_refused_and_told(
    tmp_path: Path, folders: tuple[str, ...], said: str
) -> None:
    for name in folders:
        fill(tmp_path / name, 2)
    assert recognise(tmp_path) == "image-folder"
    with pytest.raises(TrainingError, match=said):
        open_source("image-folder", tmp_path).labels  # noqa: B018 - looks at the folders


def test_files_passed_over_are_counted_by_kind(tmp_path: Path) -> None:
    classes(tmp_path)
    for number in range(3):
        (tmp_path / "cat" / f"{number}.HEIC").write_bytes(b"")
    (tmp_path / "bird").mkdir()
    (tmp_path / "bird" / "a.avif").write_bytes(b"")
    (tmp_path / "cat" / "README").write_text("")
    (tmp_path / "cat" / ".DS_Store").write_bytes(b"")
    (tmp_path / "Thumbs.db").write_bytes(b"")
    fill(tmp_path / "__MACOSX" / "cat")
    fill(tmp_path / "dog" / "@eaDir")
    (tmp_path / "dog" / "gone.png").symlink_to(tmp_path / "nowhere.png")
    (tmp_path / "dog" / "back").symlink_to(tmp_path)
    os.mkfifo(tmp_path / "dog" / "pipe.png")
    fill(tmp_path, 2)
    found = summary(tmp_path)
    assert sum(found.training) + sum(found.test) == 16
    assert found.remarks == (
        "passed over: 1 .avif, 3 .heic, 2 beside the folders of classes, 1 broken link, "
        "4 hidden, 1 linked folder, 1 special file, 1 without suffix",
        "no picture is read in bird: no class",
    )


def test_class_may_be_a_link_to_elsewhere(tmp_path: Path) -> None:
    data = tmp_path / "data"
    fill(data / "cat")
    (data / "dog").symlink_to(fill(tmp_path / "elsewhere"))
    assert summary(data).training == (7, 7)


def test_every_format_is_read(tmp_path: Path) -> None:
    for number, suffix in enumerate((".PNG", ".jpeg", ".webp", ".bmp", ".tif", ".TIFF", ".gif")):
        fill(tmp_path / ("cat", "dog")[number % 2], 4, suffix)
    found = summary(tmp_path)
    assert sum(found.training) + sum(found.test) == 7 * 4


def test_composed_and_decomposed_names_are_one_class(tmp_path: Path) -> None:
    forms: tuple[tuple[str, Literal["NFC", "NFD"]], ...] = (("train", "NFC"), ("test", "NFD"))
    for part, form in forms:
        for label in ("café", "tea"):
            fill(tmp_path / part / unicodedata.normalize(form, label))
    fill(tmp_path / "train" / unicodedata.normalize("NFD", "café"), 3)
    source = open_source("image-folder", tmp_path)
    assert source.labels == ("café", "tea")
    assert summarise(source).test == (8, 8)


def test_file_of_any_bytes_is_read_and_named(tmp_path: Path) -> None:
    classes(tmp_path)
    odd = os.fsencode(tmp_path / "cat") + b"/caf\xe9\x1b.png"
    with open(odd, "wb") as file:
        file.write((tmp_path / "cat" / "1.png").read_bytes())
    source = open_source("image-folder", tmp_path)
    assert len(source.digests()["pictures"]) == 64
    with open(odd, "wb") as file:
        file.write(b"damaged")
    with pytest.raises(TrainingError) as caught:
        open_source("image-folder", tmp_path).training()
    assert r"cat/caf\udce9\x1b.png" in str(caught.value)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        (b"caf\xe9", r"'caf\\udce9' is not valid UTF-8"),
        (b"a\nb", "control characters"),
        (b"None", "'None' is the word"),
    ],
)
def test_name_that_is_no_label_is_refused(tmp_path: Path, name: bytes, said: str) -> None:
    fill(tmp_path / "tea")
    folder = os.fsencode(tmp_path) + b"/" + name
    os.mkdir(folder)
    with open(folder + b"/a.png", "wb") as file:
        file.write((tmp_path / "tea" / "1.png").read_bytes())
    with pytest.raises(TrainingError, match=said):
        open_source("image-folder", tmp_path).labels  # noqa: B018 - looks at the folders


def test_picture_of_a_small_range_is_warned_of(tmp_path: Path) -> None:
    for label, top in (("dark", 2000), ("light", 60_000)):
        (tmp_path / label).mkdir()
        for number in range(8):
            pixels = np.linspace(0, top, 48).reshape(6, 8).astype(np.uint16)
            Image.fromarray(pixels).save(tmp_path / label / f"{number}.png")
    warnings = summarise(open_source("image-folder", tmp_path)).warnings
    (remark,) = (warning for warning in warnings if "range" in warning)
    assert "8 of 16 pictures use less than an eighth of their range" in remark
    assert "dark/0.png (0 to 2000 of 0 to 65535)" in remark
