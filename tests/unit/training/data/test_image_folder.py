"""Somebody's own pictures: every form in which they may lie there, and what is refused."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from PIL import Image

from veilcam_optics.camera.geometry import Scene
from veilcam_training.data import Images, open_source, recognise, split
from veilcam_training.data.summary import summarise
from veilcam_training.errors import TrainingError

Draw = npt.NDArray[np.uint8 | np.uint16]


def gray(value: int, rows: int = 12, columns: int = 16) -> Draw:
    """A picture that says its number by its first pixel."""
    pixels = np.full((rows, columns), 100, dtype=np.uint8)
    pixels[0, 0] = value
    return pixels


def save(path: Path, pixels: Draw, **how: Any) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path, **how)
    return path


def by_class(root: Path, count: int = 20, first: int = 0) -> Path:
    for number in range(count):
        name = "cat" if number % 2 else "dog"
        save(root / name / f"{number:03}.png", gray(first + number))
    return root


def numbers(images: Images) -> set[int]:
    """What the first pixels say."""
    return set(images.pixels.flatten(1)[:, 0].tolist())


def of_parts(folder: Path) -> None:
    by_class(folder / "train", 14)
    by_class(folder / "test", 6, first=14)


def of_a_table(folder: Path) -> None:
    lines = ["file,label,part"]
    for number in range(20):
        save(folder / "all" / f"{number}.png", gray(number))
        part = "test" if number >= 14 else "train"
        lines.append(f"all/{number}.png,{'cat' if number % 2 else 'dog'},{part}")
    (folder / "labels.csv").write_text("\n".join(lines))


def arrays(first: int, count: int) -> dict[str, Any]:
    images = np.stack([gray(first + number) for number in range(count)])
    labels = np.array(["cat" if number % 2 else "dog" for number in range(count)])
    return {"images": images, "labels": labels}


def of_one_array(folder: Path) -> None:
    np.savez(folder / "images.npz", **arrays(0, 20))


def of_arrays(folder: Path) -> None:
    np.savez(folder / "train.npz", **arrays(0, 14))
    np.savez(folder / "test.npz", **arrays(14, 6))


@pytest.mark.parametrize(
    ("write", "named"),
    [
        *((by_class, False), (of_parts, True), (of_a_table, True)),
        *((of_arrays, True), (of_one_array, False)),
    ],
)
def test_every_form_is_read(write: Callable[[Path], object], named: bool, tmp_path: Path) -> None:
    write(tmp_path)
    assert recognise(tmp_path) == "image-folder"
    source = open_source("image-folder", tmp_path)
    assert (source.labels, source.colour) == (("cat", "dog"), False)
    assert source.scene == Scene(12, 16, 0.27, 0.55)
    training, test = source.training(), source.test()
    assert training.pixels.shape[1:] == (12, 16)
    assert numbers(training) | numbers(test) == set(range(20))
    assert not numbers(training) & numbers(test)
    if named:
        assert numbers(test) == set(range(14, 20))
    for images in (training, test):
        odd = images.pixels.flatten(1)[:, 0] % 2 == 1
        assert torch.equal(images.labels == 0, odd)
    # Unnamed: two of each ten, by a fixed seed.
    assert len(test) == (6 if named else 4)
    again = open_source("image-folder", tmp_path)
    assert torch.equal(again.test().pixels, test.pixels)
    assert again.digests() == source.digests()


def test_other_files_are_no_class(tmp_path: Path) -> None:
    assert recognise(tmp_path) is None
    assert recognise(tmp_path / "none") is None
    save(tmp_path / "one class" / "img_align_celeba" / "0.jpg", gray(0))
    assert recognise(tmp_path / "one class") is None
    shutil.rmtree(tmp_path / "one class")
    (tmp_path / "train-images-idx3-ubyte").write_bytes(b"")
    assert recognise(tmp_path) is None
    by_class(tmp_path)
    shutil.move(tmp_path / "cat" / "001.png", save(tmp_path / "cat" / "day" / "x.PNG", gray(0)))
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "read.txt").write_text("none of them is a picture")
    save(tmp_path / ".thumbnails" / "0.png", gray(0))
    save(tmp_path / "__MACOSX" / "0.png", gray(0))
    save(tmp_path / "cat" / "._002.png", gray(200))
    source = open_source("image-folder", tmp_path)
    assert source.labels == ("cat", "dog")
    assert len(source.training()) + len(source.test()) == 20


def test_classes_that_are_numbers_stand_in_their_order(tmp_path: Path) -> None:
    for label in (2, 10, 9):
        for number in range(8):
            save(tmp_path / str(label) / f"{number}.png", gray(number))
    assert open_source("image-folder", tmp_path).labels == ("2", "9", "10")


def test_large_pictures_are_reduced_by_area_about_their_centre(tmp_path: Path) -> None:
    # Left half white; wide pictures of 256 x 128 come to 32 x 16, as the median has it.
    wide = np.zeros((128, 256), dtype=np.uint8)
    wide[:, :128] = 255
    for number in range(20):
        save(tmp_path / "ab"[number % 2] / f"{number}.png", wide)
    tall = np.zeros((512, 256), dtype=np.uint8)  # of it, the middle 128 rows are left
    tall[192:320] = 255
    save(tmp_path / "a" / "tall.png", tall)
    source = open_source("image-folder", tmp_path)
    assert source.scene.shape == (16, 32)
    pixels = torch.cat([source.training().pixels, source.test().pixels])
    halves = pixels[(pixels == 0).flatten(1).any(1)]
    assert len(halves) == 20
    assert (halves[:, :, :16] == 255).all()
    assert (halves[:, :, 16:] == 0).all()
    assert (pixels[(pixels == 255).flatten(1).all(1)]).shape[0] == 1


def test_colour_turned_and_transparent_pictures(tmp_path: Path) -> None:
    red = np.zeros((20, 30, 3), dtype=np.uint8)
    red[:10, :, 0] = 255  # the upper half
    for number in range(18):
        save(tmp_path / "ab"[number % 2] / f"{number}.png", red)
    exif = Image.Exif()
    exif[0x0112] = 6  # stored lying: to be turned by 90 degrees clockwise
    stored = np.ascontiguousarray(np.rot90(red, 1))
    save(tmp_path / "a" / "turned.jpg", stored, exif=exif, quality=100, subsampling=0)
    clear = np.dstack([np.full((20, 30, 3), 255, np.uint8), np.zeros((20, 30), np.uint8)])
    save(tmp_path / "b" / "clear.png", clear)
    source = open_source("image-folder", tmp_path)
    assert source.colour
    assert source.scene.shape == (20, 30)
    images = torch.cat([source.training().pixels, source.test().pixels]).int()
    assert images.shape == (20, 3, 20, 30)
    black = images.flatten(1).amax(1) == 0
    assert int(black.sum()) == 1
    expected = torch.from_numpy(red).permute(2, 0, 1).int()
    # What JPEG at quality 100 rounds: a unit or two of 255 each for its colours and its blocks.
    assert int((images[~black] - expected).abs().max()) <= 6
    before = source.digests()
    (tmp_path / "dataset.toml").write_text("colour = false")
    plain = open_source("image-folder", tmp_path)
    assert not plain.colour
    assert plain.training().pixels.ndim == 3
    assert plain.digests() != before


def test_sixteen_bits_are_kept(tmp_path: Path) -> None:
    for number in range(20):
        pixels = np.full((4, 4), 30_000 + number, dtype=np.uint16)
        save(tmp_path / "ab"[number % 2] / f"{number}.png", pixels)
    source = open_source("image-folder", tmp_path)
    read = numbers(source.training()) | numbers(source.test())
    assert read == {30_000 + number for number in range(20)}
    scenes = source.training().scenes()
    assert float(scenes.min()) == pytest.approx(30_000 / 65_535, abs=2e-5)
    # One such picture among others: white is white in both.
    save(tmp_path / "a" / "eight.png", np.full((4, 4), 255, np.uint8))
    mixed = open_source("image-folder", tmp_path)
    assert 65_535 in numbers(mixed.training()) | numbers(mixed.test())


def test_groups_are_never_split(tmp_path: Path) -> None:
    for person in range(20):
        for shot in range(3):
            number = 3 * person + shot
            save(tmp_path / "ab"[shot % 2] / f"person{person}-{shot}.png", gray(number))
    (tmp_path / "dataset.toml").write_text("group = '(person[0-9]+)-'\ntest_share = 0.25")
    source = open_source("image-folder", tmp_path)
    parts = split(source.training())
    people = [
        {number // 3 for number in numbers(images)}
        for images in (parts.training, parts.validation, source.test())
    ]
    assert sum(map(len, people)) == 20
    assert set.union(*people) == set(range(20))
    assert len(people[2]) == 5
    groups = source.test().groups
    assert groups is not None
    assert len(torch.unique(groups)) == 5


def test_table_may_name_groups(tmp_path: Path) -> None:
    of_a_table(tmp_path)
    table = tmp_path / "labels.csv"
    lines = [line.rsplit(",", 1)[0] for line in table.read_text().splitlines()]
    said = ["file,label,group", *(f"{line},{number // 4}" for number, line in enumerate(lines[1:]))]
    table.write_text("\n".join(said))
    source = open_source("image-folder", tmp_path)
    assert len(source.test()) == 4
    assert len({number // 4 for number in numbers(source.test())}) == 1


def test_damaged_pictures_are_all_named_at_once(tmp_path: Path) -> None:
    by_class(tmp_path)
    whole = (tmp_path / "cat" / "001.png").read_bytes()
    (tmp_path / "cat" / "001.png").write_bytes(whole[:-30])
    (tmp_path / "dog" / "002.png").write_bytes(b"no picture")
    (tmp_path / "dog" / "004.png").write_bytes(b"")
    with pytest.raises(TrainingError) as caught:
        open_source("image-folder", tmp_path).scene.shape  # noqa: B018 - reads them
    said = str(caught.value)
    assert "3 of 20 pictures cannot be read" in said
    assert all(name in said for name in ("cat/001.png", "dog/002.png", "dog/004.png"))
    assert "get them again, or remove them" in said
    assert str(tmp_path / "cat") not in said.replace(str(tmp_path) + ":", "")
    source = open_source("image-folder", tmp_path, skip_damaged=True)
    assert len(source.training()) + len(source.test()) == 17
    (remark,) = summarise(source).remarks
    assert "3 damaged pictures are left out: cat/001.png, dog/002.png, dog/004.png" in remark
    with pytest.raises(TrainingError, match="leave out --skip-damaged"):
        open_source("mnist", tmp_path, skip_damaged=True)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("rows = 24", "give both or neither"),
        ("rows = 0\ncolumns = 3", "rows is not valid"),
        ("height = -1.0", "height is not valid"),
        ("sise = 3", "sise is not valid"),
        ("rows =", "mend it"),
        ("group = '('", "mend it"),
        ("group = 'person'", "parentheses"),
        ("group = '(nobody)'", "does not occur"),
        ("test_share = 0.01", "use more of them"),
    ],
)
def test_bad_description_is_refused(text: str, said: str, tmp_path: Path) -> None:
    by_class(tmp_path)
    (tmp_path / "dataset.toml").write_text("rows=6\ncolumns=8\nheight=0.1\ndistance=0.3")
    source = open_source("image-folder", tmp_path)
    assert source.scene == Scene(6, 8, 0.1, 0.3)
    assert source.training().pixels.shape[1:] == (6, 8)
    (tmp_path / "dataset.toml").write_text(text)
    with pytest.raises(TrainingError, match=said):
        open_source("image-folder", tmp_path).training()


@pytest.mark.parametrize(
    ("lines", "said"),
    [
        (["label", "a"], "has the columns label"),
        (["file,label,colour", "all/0.png,a,red"], "columns"),
        *(
            (["file,label", line], "line 2 has too few or too many")
            for line in ("all/0.png,", "all/0.png", "all/0.png,a,b")
        ),
        (["file,label", "none.png,a"], "none.png is missing"),
        (["file,label", "../outside.png,a"], "missing in"),
        (["file,label", "labels.csv,a"], "is no picture"),
        (["file,label", "all/0.png,a", "all/0.png,b"], "line 3 repeats"),
        (["file,label,part", "all/0.png,a,holdout"], "use train, validation or test"),
        (["file,label,part", "all/0.png,a,test", "all/1.png,b,"], "part for 1 of 2"),
        (["file,label,group", "all/0.png,a,x", "all/1.png,b,"], "group for 1 of 2"),
        (["file,label", "all/0.png,a", "all/1.png,a"], "one class"),
    ],
)
def test_bad_table_is_refused(lines: list[str], said: str, tmp_path: Path) -> None:
    folder = tmp_path / "data"
    folder.mkdir()
    of_a_table(folder)
    save(tmp_path / "outside.png", gray(0))
    (folder / "labels.csv").write_text("\n".join(lines))
    with pytest.raises(TrainingError, match=said):
        open_source("image-folder", folder).labels  # noqa: B018 - reads the table


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"images": np.zeros((20, 3, 4))}, "use uint8"),
        ({"images": np.zeros((20, 3, 4, 2), np.uint8)}, "use uint8"),
        ({"images": np.zeros((0, 3, 4), np.uint8)}, "use uint8"),
        ({"labels": np.zeros(19, int)}, "labels of another kind or number"),
        ({"labels": np.zeros(20)}, "labels of another kind or number"),
        ({"groups": np.zeros(3, int)}, "groups of another kind or number"),
        ({"images": None}, "lacks images or labels"),
    ],
)
def test_bad_arrays_are_refused(change: dict[str, Any], said: str, tmp_path: Path) -> None:
    content = {**arrays(0, 20), **change}
    np.savez(tmp_path / "images.npz", **{k: v for k, v in content.items() if v is not None})
    with pytest.raises(TrainingError, match=said):
        open_source("image-folder", tmp_path).training()
    (tmp_path / "images.npz").unlink()
    of_arrays(tmp_path)
    np.savez(tmp_path / "test.npz", images=np.zeros((6, 3, 3), np.uint8), labels=np.arange(6) % 2)
    with pytest.raises(TrainingError, match="use one size"):
        open_source("image-folder", tmp_path).labels  # noqa: B018 - reads the arrays


def test_arrays_may_be_in_colour_and_in_groups(tmp_path: Path) -> None:
    images = np.zeros((20, 6, 8, 3), dtype=np.uint8)
    images[..., 1] = np.arange(20)[:, None, None]
    groups = np.arange(20) // 2
    np.savez(tmp_path / "images.npz", images=images, labels=np.arange(20) % 2, groups=groups)
    source = open_source("image-folder", tmp_path)
    training, test = source.training(), source.test()
    assert source.colour
    assert (training.pixels[:, (0, 2)] == 0).all()
    seen = [set(part.pixels[:, 1, 0, 0].tolist()) for part in (training, test)]
    assert not {number // 2 for number in seen[0]} & {number // 2 for number in seen[1]}


def test_group_or_a_class_in_one_part_alone_is_refused(tmp_path: Path) -> None:
    by_class(tmp_path / "train", 14)
    save(tmp_path / "test" / "dog" / "1.png", gray(0))
    source = open_source("image-folder", tmp_path)
    with pytest.raises(TrainingError, match="cat is in no test picture"):
        source.test()
    save(tmp_path / "test" / "cat" / "2.png", gray(0))
    assert len(open_source("image-folder", tmp_path).test()) == 2
    (tmp_path / "dataset.toml").write_text("group = '/([0-9]+)[.]'")
    for path in (tmp_path / "test").rglob("*.png"):
        path.rename(path.parent / "001.png")
    with pytest.raises(TrainingError, match=r"groups are in the training and in the test set"):
        open_source("image-folder", tmp_path).training()
