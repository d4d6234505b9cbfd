"""Tables of the paper's attacks: each cell is computed once, and stands beside the paper's."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np
import pytest
import typer
from benchmarks.privacy.paper import attributes, convex, generator, masks
from benchmarks.privacy.paper.cells import published
from benchmarks.privacy.paper.convex_attack import ConvexAttack, tune
from benchmarks.privacy.paper.generator_attack import GeneratorTrial
from tests.benchmarks.conftest import figures_of

from veilcam_optics.camera.geometry import Scene

SCENE = Scene(64, 52, 0.27, 0.55)


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """Faces of two hundred people: noise, brighter where it is female or smiles."""
    random = np.random.default_rng(1)
    female, smiling = random.integers(2, size=(2, 400))
    images = random.integers(100, size=(400, *SCENE.shape))
    images[:, :32] += 100 * female[:, None, None]
    images[:, 32:] += 100 * smiling[:, None, None]
    folder = tmp_path / "data"
    folder.mkdir()
    np.savez(
        folder / "faces.npz",
        images=images.astype(np.uint8),
        identity=np.arange(400) // 2,
        female=female.astype(np.uint8),
        smiling=smiling.astype(np.uint8),
    )
    return folder


def refuse(*_: object) -> None:
    raise AssertionError("this cell was computed before")


@pytest.mark.slow
def test_convex_cells_are_computed_once(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(convex, "SENSOR", (48, 64))
    monkeypatch.setattr(convex, "SIZES", ((6, 8), (3, 4)))
    monkeypatch.setattr(convex, "TUNED_ON", 3)
    monkeypatch.setattr(convex, "UNTUNED", ConvexAttack(0.0, 5))
    monkeypatch.setattr(convex, "CONVERGED", 5)
    monkeypatch.setattr(convex, "tune", partial(tune, variations=(1e-3,), stops=(5,)))
    figures, pictures = tmp_path / "figures.json", tmp_path / "pictures"
    run = partial(convex.command, data=data, work=tmp_path / "work", figures=figures)
    run(count=5, pictures=pictures)
    first = figures_of(figures)
    for kind in ("good", "bad"):
        for size in ("6x8", "3x4"):
            assert 5 < first[f"convex_psnr_{kind}_{size}"] < 40
            assert first[f"convex_ssim_{kind}_{size}"] < 1
    assert first["convex_gain_least_6x8"] < first["convex_gain_6x8"]
    assert sorted(path.name for path in pictures.iterdir()) == ["convex-bad.png", "convex-good.png"]
    monkeypatch.setattr(convex, "attack", refuse)
    run(count=5)
    assert figures_of(figures) == first
    with pytest.raises(typer.BadParameter, match="other cells"):
        run(count=6)
    with pytest.raises(typer.BadParameter, match="sizes are"):
        run(count=5, size=["7x7"])


@pytest.mark.slow
def test_generator_cells_are_computed_once(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(masks, "STEPS", 2)
    monkeypatch.setattr(masks, "BATCH", 8)
    asked: list[tuple[int, str]] = []

    def trials(pairs: int, design: generator.DesignName) -> list[GeneratorTrial]:
        asked.append((pairs, design))
        return [GeneratorTrial(batch=16, epochs=1)]

    # A tenth of few pairs is enough here.
    monkeypatch.setattr(generator, "LEAST_HELD", 2)
    monkeypatch.setattr(generator, "trials", trials)
    figures, work = tmp_path / "figures.json", tmp_path / "work"
    run = partial(generator.command, data=data, work=work, count=10, figures=figures)
    run(kind=["1", "10random"], pairs=[20, 40], pictures=tmp_path / "pictures")
    assert asked == 2 * [(20, "light"), (40, "light")]
    first = figures_of(figures)
    for name in ("1_20", "1_40", "10random_20", "10random_40"):
        assert 5 < first[f"generator_psnr_{name}"] < 40
        assert first[f"generator_psnr_half_{name}"] > 0
    learned = tmp_path / "paper-masks-faces-gender"
    assert [path.name for path in learned.iterdir()] == ["mask-000.npy"]  # others are drawn
    assert learned.stat().st_mode & 0o77 == 0
    assert (tmp_path / "pictures" / "generator.png").exists()
    monkeypatch.setattr(generator, "attack", refuse)
    run(kind=["1", "10random"], pairs=[20, 40])
    assert figures_of(figures) == first
    with pytest.raises(typer.BadParameter, match="other cells"):
        run(design="paper")


@pytest.mark.slow
def test_attributes_are_read_where_a_mask_is_stored(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The upper half of a picture is brighter by half: that has to be seen."""
    monkeypatch.setattr(masks, "STEPS", 2)
    figures = tmp_path / "figures.json"
    attributes.command(
        data=data,
        source=["faces-gender"],
        work=tmp_path / "work",
        count=50,
        pairs=[200],
        kind=["1"],
        figures=figures,
    )
    assert figures_of(figures).keys() == {"attribute_auc_gender_1_200"}
    monkeypatch.setattr(attributes, "attack", refuse)
    # 30 people times 2: an area is off by 0.07, and one that sees nothing is at 0.5.
    assert figures_of(figures)["attribute_auc_gender_1_200"] > 0.8
    kept = partial(attributes.command, data=data, work=tmp_path / "work", count=50, pairs=[200])
    kept(source=["faces-gender"], kind=["1"])


def test_cells_of_the_paper_are_tables_5_and_6() -> None:
    cells = published()
    assert len(cells) == 2 * 2 * 5 + 2 * 4 * 4
    assert (cells["convex_psnr_good_384x512"], cells["convex_ssim_bad_24x32"]) == (22.6, 0.22)
    assert (cells["generator_psnr_1_100"], cells["generator_ssim_10random_100000"]) == (13.9, 0.53)
