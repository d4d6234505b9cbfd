"""Reports of fits: figures are right, and names of any kind and pictures of any size are shown."""

from __future__ import annotations

import html
import io
import re
from pathlib import Path
from typing import Any

import pytest
import torch
from PIL import Image
from torch import Tensor

from veilcam_training.data import Images
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.report import Report, confusion, worst_first, write_report
from veilcam_training.trainer.callbacks import Epoch

PICTURES = ("accuracy.png", "confusion.png", "worst.png")
HOSTILE = (
    "<script>alert(1)</script>",
    "$\\frac$ & $x$",
    "_x_",
    "猫\U0001f408",
    "قطة",
    "W" * 64,
    "#{}%",
)


def made(labels: tuple[str, ...], truth: Tensor, logits: Tensor, **changes: Any) -> Report:
    shape = changes.pop("shape", (8, 8))
    dtype = changes.pop("dtype", torch.uint8)
    pixels = torch.arange(truth.numel() * torch.Size(shape).numel()).reshape(-1, *shape) % 256
    history = [Epoch(e, 1.0, 0.5, 0.4 + 0.1 * e, 0.9, 1.0, 6.0 + e) for e in range(3)]
    values: dict[str, Any] = {
        "title": "bars",
        "facts": [("data", "bars")],
        "sentences": ["Eyes see nothing."],
    }
    values |= {"history": history, "preparation": 5.0} | changes
    return Report(
        labels=labels, images=Images(pixels.to(dtype), truth), logits=logits.float(), **values
    )


def drawn(classes: int, count: int) -> tuple[Tensor, Tensor]:
    stream = torch.Generator().manual_seed(1)
    truth = torch.randint(classes, (count,), generator=stream)
    return truth, torch.randn(count, classes, generator=stream)


def test_confusion_has_true_classes_in_rows() -> None:
    truth, guessed = torch.tensor([0, 0, 0, 2, 2]), torch.tensor([0, 1, 1, 2, 0])
    logits = torch.nn.functional.one_hot(guessed, 3).float()
    assert confusion(truth, logits).tolist() == [[1, 2, 0], [0, 0, 0], [1, 0, 1]]


def test_worst_pictures_are_those_least_sure_of_the_truth() -> None:
    truth = torch.tensor([0, 0, 1, 1, 1])
    # The last two have no probability left in float32, and an order all the same.
    logits = torch.tensor([[3.0, 0], [0, 1], [0, 2], [900, 0], [800, 0]])
    assert worst_first(truth, logits).tolist() == [3, 4, 1, 2, 0]


def test_page_shows_accuracy_interval_and_figures_of_classes(tmp_path: Path) -> None:
    truth, guessed = torch.tensor([0] * 6 + [1] * 4), torch.tensor([0] * 5 + [1] * 5)
    report = made(("no", "yes", "never"), truth, torch.nn.functional.one_hot(guessed, 3))
    write_report(tmp_path / "new" / "folder", report)
    page = (tmp_path / "new" / "folder" / "report.html").read_text()
    text = re.sub(r"\s+", " ", re.sub(r"<[^>]+>", " ", page))
    # Wilson's interval of 9 of 10.
    assert "90.0 % test accuracy, 59.6 % to 98.2 % with" in text
    assert "0 no 83.3 % 100.0 % 6 1 yes 100.0 % 80.0 % 4 2 never – – 0" in text
    assert "Eyes see nothing." in text
    assert not re.search(r"(src|href)=[\"'](?!data:)", page)
    assert page.count("data:image/png;base64,") == len(PICTURES)


def test_names_of_any_kind_are_escaped_and_drawn(tmp_path: Path) -> None:
    truth, logits = drawn(len(HOSTILE), 30)
    bad = "<b>&\udcff"  # part of a path that is not UTF-8
    facts = [(bad, bad)]
    write_report(tmp_path, made(HOSTILE, truth, logits, title=bad, facts=facts, sentences=[bad]))
    page = (tmp_path / "report.html").read_text()
    assert "<script" not in page
    assert "<b>&" not in page
    for name in HOSTILE:
        assert f"<bdi>{html.escape(name).replace('&#x27;', '&#39;')}</bdi>" in page


@pytest.mark.slow
@pytest.mark.parametrize(
    ("classes", "count", "changes"),
    [
        (2, 1, {"history": [], "preparation": 0.0}),
        (2, 7, {"shape": (3, 128, 16), "history": [Epoch(0, 1.0, 1.0, 1.0, 0.1, 1.0)]}),
        (13, 60, {"shape": (3, 27, 36), "dtype": torch.int32}),
        (100, 300, {"shape": (128, 128), "preparation": 600.0}),
    ],
)
def test_sizes_of_every_kind_are_drawn(
    tmp_path: Path, classes: int, count: int, changes: dict[str, Any]
) -> None:
    labels = tuple(f"a class of things, number {each}" for each in range(classes))
    write_report(tmp_path, made(labels, *drawn(classes, count), **changes))
    for name in PICTURES:
        picture = Image.open(io.BytesIO((tmp_path / name).read_bytes())).convert("L")
        assert min(picture.tobytes()) < 128, name
        assert picture.width > 1000


def test_folder_that_cannot_be_written_is_a_clear_error(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(TrainingError, match="cannot be written to"):
        write_report(tmp_path / "file", made(("a", "b"), *drawn(2, 3)))
