"""The paper's tables: their cells, their verdicts, their report, and what is kept of a run."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmarks.figures import Origin
from benchmarks.paper import __main__ as paper
from benchmarks.paper import runner as run_module
from benchmarks.paper.grid import Cell, find_table
from benchmarks.paper.pictures import Pictures
from benchmarks.paper.results import (
    CellResult,
    EpochRecord,
    Finished,
    Summary,
    load_results,
    record_cells,
    save_finished,
)
from benchmarks.tables.paper import score
from typer.testing import CliRunner, Result

from veilcam_optics.simulation.check import Check
from veilcam_training.bundle import read_bundle
from veilcam_training.config.files import load_settings
from veilcam_training.config.settings import FitSettings

Run = Callable[..., Result]


@pytest.fixture
def run(digit_folder: Path, tmp_path: Path) -> Run:
    def invoke(*options: object) -> Result:
        command = ["mnist", "--data", digit_folder, "--work", tmp_path / "work", *options]
        return CliRunner().invoke(paper.app, [str(word) for word in command])

    return invoke


@pytest.mark.thorough
def test_quick_table_is_run_once_and_reported(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    work, figures, out = tmp_path / "work", tmp_path / "figures.json", tmp_path / "report"
    options = ("--quick", "--encoders", "learned,digital", "--binnings", "area", "--seeds", 2)
    checked = Check(1e-4, 5e-5, 2e-4, 0.9, 16)
    monkeypatch.setattr("veilcam_training.experiments.fit.check", lambda *_, **__: checked)
    # A clock on which every cell takes four minutes.
    clock = time.time()
    with monkeypatch.context() as patch:
        patch.setattr(time, "time", lambda: clock + 240 * len(list(work.glob("*/result.json"))))
        begun = run(*options, "--budget", "7m")
    assert "2 of 4 cells are left: start again to go on" in begun.output
    ended = run(*options, "--figures", figures, "--out", out)
    assert ended.exit_code == 0, ended.output
    assert "left" not in ended.output
    results = list(load_results(work))
    assert len(results) == 4
    for result in results:
        assert int(np.trace(result.confusion)) / 100 == result.test_accuracy
        assert not (work / result.cell.name / "checkpoints").exists()
    # A mask that a device could show comes as a bundle.
    assert {path.parent.name for path in work.glob("*/pair.veilcam")} == {
        "mnist_LR_learned_3x4",
        "mnist_LR_learned_3x4_seed1",
    }
    bundle = read_bundle(work / "mnist_LR_learned_3x4" / "pair.veilcam")
    assert bundle.accuracy is not None
    by_name = {result.cell.name: result for result in results}
    assert bundle.accuracy.value == by_name["mnist_LR_learned_3x4"].test_accuracy
    record = json.loads(figures.read_text())
    mean = np.mean(
        [by_name[f"mnist_LR_digital_3x4{seed}"].test_accuracy for seed in ("", "_seed1")]
    )
    assert record["mnist_LR_digital_3x4"]["value"] == pytest.approx(100 * mean, abs=0.005)
    assert "mnist_LR_learned_3x4" in (out / "report.html").read_text()

    # Nothing is run again, and the figures say still what made them.
    def refuse(*arguments: Any, **more: Any) -> None:
        raise AssertionError

    monkeypatch.setattr(run_module, "fit_bundle", refuse)
    figures.unlink()
    assert run(*options, "--figures", figures).exit_code == 0
    assert json.loads(figures.read_text()) == record
    # Other settings are not taken for these.
    error = run(*options, "--recipe", "paper").exception
    assert "was made with other settings" in str(error)
    (work / "mnist_LR_digital_3x4" / "result.json").write_text("{}")
    assert "is not the result of a cell" in str(run(*options).exception)


@pytest.mark.thorough
def test_fresh_cell_is_run(run: Run) -> None:
    ended = run("--quick", "--encoders", "fresh", "--classifiers", "Scene8")
    assert ended.exit_code == 0, ended.exception
    assert "mnist_Scene8_fresh_3x4" in ended.output


def finish(work: Path, test: float, **settings: object) -> CellResult:
    chosen = FitSettings.model_validate(settings)
    rows, columns = map(int, chosen.embedding.split("x"))
    epoch = EpochRecord(
        loss=1.0, training_accuracy=0.5, validation_accuracy=test - 0.01, validation_loss=1.0
    )
    result = CellResult(
        settings=chosen,
        fingerprint=Cell(chosen).name,
        labels=tuple("0123456789"),
        test_set="mnist test",
        test_accuracy=test,
        validation_accuracy=test - 0.01,
        best_epoch=1,
        epochs=(epoch, epoch, epoch),
        confusion=tuple(tuple(int(9 * (i == j) + 1) for i in range(10)) for j in range(10)),
        seconds=12.0,
        clock="elapsed" if chosen.binning == "point" else "processor",
        inference_seconds=34e-6,
        device="cpu",
        origin=Origin("benchmarks.paper mnist <here>", "abc123", "2026-01-31", "a machine"),
        provenance={},
    )
    random = np.random.default_rng(0)
    pictures = Pictures(
        psf=random.random((8, 9)).astype(np.float32),
        scenes=random.random((2, 28, 28)).astype(np.float32),
        embeddings=random.random((2, rows, columns)).astype(np.float32),
    )
    save_finished(work, Finished(result, pictures, None))
    return result


@pytest.mark.parametrize(
    ("tests", "verdict"),
    [
        ((96.5, 96.5), None),
        # Of no spread: the paper's 95.5 stands for all from 95.45 to 95.55.
        ((95.56, 95.56, 95.56), "win"),
        ((95.54, 95.54, 95.54), "tie"),
        ((95.44, 95.44, 95.44), "loss"),
        # Half of the interval of three, d apart, is 4.303 d / sqrt(3).
        ((95.9, 96.0, 96.1), "win"),  # 96 - 0.25
        ((95.8, 96.0, 96.2), "tie"),  # 96 - 0.50
    ],
)
def test_verdict_is_decided_by_seeds(
    tmp_path: Path, tests: tuple[float, ...], verdict: str | None
) -> None:
    results = [
        finish(tmp_path, test / 100, classifier="LR", embedding="24x32", seed=seed)
        for seed, test in enumerate(tests)
    ]
    (entry,) = Summary(find_table("mnist"), results).finished()
    assert entry.paper == 95.5
    assert entry.verdict == verdict


@pytest.mark.parametrize(
    ("settings", "figure", "paper"),
    [
        ({"data": "cifar10", "classifier": "Scene32", "embedding": "27x36"}, "learned_27x36", 63.0),
        (
            {"data": "cifar10", "classifier": "Scene32", "embedding": "6x8", "hidden": False},
            "open_6x8",
            56.9,
        ),
        (
            {"data": "cifar10", "classifier": "Scene32", "embedding": "3x4", "fresh": {}},
            "fresh_3x4",
            None,
        ),
        (
            {"data": "cifar10", "classifier": "Scene32", "embedding": "3x4", "encoder": "lens"},
            "lens_3x4",
            46.5,
        ),
    ],
)
def test_scene_cell_stands_beside_the_papers_best(
    settings: dict[str, Any], figure: str, paper: float | None
) -> None:
    place = Cell(load_settings(None, settings, colour=True)).place
    assert place.figure == f"cifar10_{figure}"
    assert place.paper == paper


def test_score_counts_each_cell_of_the_paper_once(tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    settings = {"hidden": False, "embedding": "24x32", "classifier": "FC800"}
    won = [finish(tmp_path, 0.99 + seed / 1e5, **settings, seed=seed) for seed in range(3)]
    once = [finish(tmp_path, 0.99, **settings, change="shift")]
    # Beside the paper's classifier a scene classifier of the same mask is not counted.
    scene = [finish(tmp_path, 0.5, **settings | {"classifier": "Scene16"})]
    assert score({}).verdicts.total() == 0
    assert len(score({}).missing) == 96
    record_cells(figures, [*won, *once, *scene])
    record = {name: entry["value"] for name, entry in json.loads(figures.read_text()).items()}
    found = score(record)
    assert found.verdicts == {"win": 1, None: 1}
    assert set(score({}).missing) - set(found.missing) == {
        "mnist_FC800_learned_24x32",
        "mnist_FC800_learned_24x32_shift",
    }
