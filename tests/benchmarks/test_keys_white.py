"""White embeddings are collected as the daemon releases them, and every row is attacked once."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
import typer
from benchmarks.privacy.keys import white
from benchmarks.privacy.keys.released import CAPTURES, Camera, Floats32, collect
from benchmarks.privacy.keys.scenes import Question, Scene, Scenes, Stock
from tests.benchmarks.conftest import figures_of
from tests.unit.server.conftest import make_fresh_bundle

from veilcam_server.masks.source import Mask
from veilcam_training.attacks.intervals import Gain
from veilcam_training.attacks.networks import FAMILIES
from veilcam_training.bundle import write_bundle

SHAPE = (28, 28)


def stock(classes: int) -> Stock:
    labels = np.repeat(np.arange(classes), [1, *(classes - 1) * [3]])
    pixels = np.broadcast_to(labels[:, None, None], (len(labels), *SHAPE)).astype(np.uint8)
    return Stock(pixels, labels)


class Watched(Camera):
    shown: list[list[Scene]]

    def read(self, mask: Mask, scenes: list[Scene], noise: torch.Generator) -> Floats32:
        self.shown.append(scenes)
        return super().read(mask, scenes, noise)


def test_masks_are_white_of_one_use_and_pairs_see_the_same_scene() -> None:
    camera = Watched(make_fresh_bundle())
    camera.shown = []
    made = collect(camera, Scenes(SHAPE, stock(10), None), masks=6, seed=1)
    questions: tuple[Question, ...] = ("digit", "presence", "kind", "linkage")
    assert [made[each].shape for each in questions] == [
        (6, CAPTURES[each], 20) for each in questions
    ]
    for each in questions:
        # Each is rounded to float32 once, which is 2^-24 of it.
        np.testing.assert_allclose(np.linalg.norm(made[each], axis=2), 1, atol=1e-6)
    linked = [scenes[-1] for scenes in camera.shown]
    for first in (0, 2, 4):
        np.testing.assert_array_equal(linked[first], linked[first + 1])
    assert any(bool((linked[0] != linked[each]).any()) for each in (2, 4))
    short = collect(camera, Scenes(SHAPE, stock(10), None), masks=2, seed=1)
    assert not np.array_equal(short["digit"], made["digit"][:2])  # other keys


@pytest.mark.slow
def test_rows_are_attacked_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.privacy.keys.released.CHUNK", 50)
    monkeypatch.setattr(white, "CHUNK", 50)
    bundle, work, figures = tmp_path / "a.veilcam", tmp_path / "work", tmp_path / "figures.json"
    write_bundle(bundle, make_fresh_bundle())
    white.collect_command(work, masks=100, bundle=bundle, figures=figures)

    white.attack_command(work, masks=100, epochs=1, figures=figures)
    record = figures_of(figures)
    assert {f"white_{each}_auc_upper" for each in ("presence", "linkage")} <= record.keys()
    assert "white_digit_advantage_upper" in record
    assert record["white_mask_ms"] > 0
    seen: list[tuple[object, ...]] = []

    def counted(*asked: object, **_: object) -> Gain:
        seen.append(asked[:2])
        return Gain(0.0, 0.01, 0.02, 100, 0.5)

    monkeypatch.setattr(white, "attack", counted)
    white.attack_command(work, row=["linkage"], masks=100, epochs=1)
    assert seen == []
    white.attack_command(work, row=["linkage"], masks=100, epochs=2)
    assert seen == [("linkage", family) for family in FAMILIES]
    with pytest.raises(typer.BadParameter, match="all rows"):
        white.attack_command(work, row=["linkage"], masks=100, figures=figures)
    with pytest.raises(typer.BadParameter, match="other captures"):
        white.collect_command(work, masks=100, bundle=bundle, seed=2)
    with pytest.raises(typer.BadParameter, match="give both"):
        white.collect_command(work, masks=100, bundle=bundle, rows=3)
