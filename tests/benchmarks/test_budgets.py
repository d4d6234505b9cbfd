"""Budgets follow from what is shown to be read, and what was measured is not measured again."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
import typer
from benchmarks.privacy.budgets import curves as of_curves
from benchmarks.privacy.budgets import study
from benchmarks.privacy.budgets.curves import Cell, Cells, draw, measured
from benchmarks.privacy.budgets.study import Digits, Form, Plan, Point

from veilcam_optics.camera.geometry import Embedding
from veilcam_server.demo_data import FRESH
from veilcam_training.bundle import read_bundle
from veilcam_training.data import Images

SMALL, LARGE = Embedding(3, 4), Embedding(6, 8)
PLAN = Plan(
    counts=(0, 20), own=3, check=1, test=4, asked=60, wide=(4, 30), crowd=(19,), sets=(6, 2, 4)
)


def curves(form: Form, small: list[float], large: list[float], crowd: float = 10.0) -> Cells:
    """Of counts 0, 1 and 3, read evenly behind four masks; two others say nothing or something."""
    return {
        (form, size): Cell(
            {
                count: Point("x", [each - 1, each + 1] * 2)
                for count, each in zip((0, 1, 3), shares, strict=True)
            },
            {2: Point("x", [crowd] * 4)},
            0.5,
        )
        for size, shares in ((SMALL, small), (LARGE, large))
    }


def digits(seed: int) -> Digits:
    """Pictures of which a bar's place says the class, the last class ten times rarer."""
    random = torch.Generator().manual_seed(seed)
    labels = torch.cat([torch.arange(9).repeat(10), torch.tensor([9])])
    pixels = torch.randint(60, (len(labels), 28, 28), generator=random, dtype=torch.uint8)
    for place, label in enumerate(labels.tolist()):
        pixels[place, :, 2 * label + 4 : 2 * label + 8] = 250
    return Digits(Images(pixels, labels))


@pytest.mark.slow
def test_cells_are_measured_once_and_charted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(of_curves, "EMBEDDINGS", (SMALL,))
    monkeypatch.setattr(study, "EPOCHS", 2)
    data = digits(1), digits(2)
    found = measured(read_bundle(FRESH), data, tmp_path, PLAN, 1)
    assert list(found) == [("white", SMALL), ("raw", SMALL)]
    for cell in found.values():
        assert (sorted(cell.known), sorted(cell.crowd)) == ([0, 20], [19])
        assert {len(each.shares) for each in (*cell.known.values(), *cell.crowd.values())} == {4}
    white = found["white", SMALL]
    # Behind one mask the same scene gives nearly the same direction.
    assert white.same_scene > 0.7
    assert white.known[20].mean > white.known[0].mean
    monkeypatch.setattr(of_curves, "Study", None)
    assert measured(read_bundle(FRESH), data, tmp_path, PLAN, 1) == found
    with pytest.raises(typer.BadParameter, match="another plan"):
        measured(read_bundle(FRESH), data, tmp_path, Plan(), 1)
    picture = tmp_path / "budgets.png"
    draw(found, picture, 1)
    assert picture.stat().st_size > 1000
