"""The paper's tables: their cells, their verdicts, their report, and what is kept of a run."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Callable
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from benchmarks.figures import Origin
from benchmarks.paper import __main__ as paper
from benchmarks.paper import runner as run_module
from benchmarks.paper.grid import (
    TABLES,
    Cell,
    Column,
    Part,
    Place,
    Row,
    find_table,
    load_paper,
)
from benchmarks.paper.pictures import Pictures, load_pictures, make_pictures, save_pictures
from benchmarks.paper.plots import draw_charts, draw_cost
from benchmarks.paper.report import write_report
from benchmarks.paper.results import (
    CellResult,
    EpochRecord,
    Finished,
    Summary,
    load_results,
    record_cells,
    save_finished,
)
from benchmarks.paper.runner import confusion
from benchmarks.paper.stopwatch import Stopwatch
from matplotlib.collections import PathCollection
from typer.testing import CliRunner, Result

from veilcam_optics.camera.geometry import Camera
from veilcam_training.bundle import read_bundle
from veilcam_training.config.recipes import Recipe
from veilcam_training.config.settings import Settings
from veilcam_training.data import Source, split
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.model import make_model
from veilcam_training.trainer.callbacks import Epoch

Run = Callable[..., Result]


@pytest.fixture
def run(digit_folder: Path, tmp_path: Path) -> Run:
    """Table ``mnist`` with more options."""

    def invoke(*options: object) -> Result:
        command = ["mnist", "--data", digit_folder, "--work", tmp_path / "work", *options]
        return CliRunner().invoke(paper.app, [str(word) for word in command])

    return invoke


# --- which cells there are


def test_every_number_of_the_paper_has_its_cell() -> None:
    places = chain.from_iterable(table.places(psf=True) for table in TABLES.values())
    assert {place.title for place in places} >= load_paper().accuracy.keys()
    assert len(load_paper().accuracy) == 48 + 24 + 24 + 24
    # Read off the paper.
    assert load_paper().accuracy["mnist_LR_learned_3x4"] == 79.3
    assert load_paper().accuracy["cifar10_VGG11_lens_27x36"] == 86.8


@pytest.mark.parametrize(
    ("table", "part", "count"),
    [
        ("mnist", Part(), 2 * 4 * (5 + 1 + 1)),
        ("mnist", Part(encoders=["lens", "lens"], classifiers=["LR", "LR"]), 4),
        ("mnist", Part(classifiers=["CNN16"], embeddings=["3x4"]), 7),
        ("mnist", Part(binnings=["area"]), 2 * 4 * 6),
        ("mnist", Part(binnings=["point"]), 2 * 4 * 5),
        ("mnist", Part(encoders=["fixed_measured"]), 2 * 4),
        ("robust", Part(changes=["none", "shift"]), 2 * 7),
        ("faces", Part(datasets=["faces-glasses"]), 2 * 7),
    ],
)
def test_part_of_a_table(table: str, part: Part, count: int) -> None:
    places = find_table(table).places(part)
    assert len(set(places)) == len(places) == count
    chosen = [Settings(**place.row._asdict(), **place.column._asdict()) for place in places]
    assert all(find_table(table).holds(settings) for settings in chosen)
    assert len({Cell(settings).name for settings in chosen}) == count


@pytest.mark.parametrize(
    ("place", "name", "figure"),
    [
        (("LR", "lens", "point", "mnist", "none", "3x4"), "mnist_LR_lens_3x4_point", None),
        (
            ("CNN16", "learned", "area", "mnist", "shift", "24x32"),
            "mnist_CNN16_learned_24x32_shift",
            "robust_shift_CNN16_learned",
        ),
        (
            ("FC800", "learned", "area", "fashion", "none", "24x32"),
            "fashion_FC800_learned_24x32",
            "fashion_fc800_learned_24x32",
        ),
    ],
)
def test_names_of_a_place(place: tuple[str, ...], name: str, figure: str | None) -> None:
    where = Place(Row(*place[:3]), Column(*place[3:]))
    assert (where.name, where.figure) == (name, figure or name)


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--encoders", "lens,eye"), "no 'eye' among its encoders"),
        (("--classifiers", "FC0"), "classifier 'FC0' is unknown"),
        (("--encoders", "digital", "--binnings", "point"), "has no binning 'point'"),
        (("--budget", "10"), "--budget '10' is not valid: use e.g. 90s, 10m or 2h"),
        (("--encoders", "fixed_measured"), "give --psf FILE"),
        (("--psf", "none.npz"), "none.npz is missing"),
        (("--psf", f"learned={__file__}"), "encoder 'learned' takes no PSF"),
        (("--psf", __file__, "--encoders", "lens"), "--psf is of fixed_measured"),
        (("--out", __file__), "cannot be written to"),
        (("--figures", __file__), "is not a record of figures"),
    ],
)
def test_options_that_cannot_be_used(run: Run, options: tuple[str, ...], reason: str) -> None:
    error = run(*options).exception
    assert isinstance(error, TrainingError)
    assert reason in str(error)


# --- running them


@pytest.mark.thorough
def test_quick_table_is_run_once_and_reported(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    work, figures, out = tmp_path / "work", tmp_path / "figures.json", tmp_path / "report"
    options = ("--quick", "--encoders", "learned,digital", "--binnings", "area", "--seeds", 2)
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
        assert len(result.epochs) == 1
        assert int(np.trace(result.confusion)) / 100 == result.test_accuracy
        assert result.inference_seconds > 0
        assert str(result.provenance["command"]) == result.origin.command
        assert not (work / result.cell.name / "checkpoint").exists()
    said = {result.cell.name: f"test {100 * result.test_accuracy:.2f} %" for result in results}
    assert all(
        any(f"{n}  " in x and s in x for x in (begun.output + ended.output).splitlines())
        for n, s in said.items()
    )
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
    assert "4 cells" in ended.output
    assert "mnist_LR_learned_3x4" in (out / "report.md").read_text()

    # Nothing is run again, and the figures say still what made them.
    def refuse(*arguments: Any, **more: Any) -> None:
        raise AssertionError

    monkeypatch.setattr(run_module, "run_fit", refuse)
    figures.unlink()
    assert run(*options, "--figures", figures).exit_code == 0
    assert json.loads(figures.read_text()) == record
    # Other settings are not taken for these.
    error = run(*options, "--recipe", "paper").exception
    assert "was made with other settings" in str(error)
    (work / "mnist_LR_digital_3x4" / "result.json").write_text("{}")
    assert "is not the result of a cell" in str(run(*options).exception)


def test_confusion_counts_pairs() -> None:
    counts = confusion(torch.tensor([0, 0, 1, 2]), torch.tensor([0, 2, 1, 1]), 3)
    assert counts.tolist() == [[1, 0, 1], [0, 1, 0], [0, 1, 0]]


@pytest.mark.parametrize(
    ("at", "watched", "seconds"),
    [
        # Two epochs of 2 s after 3 s of preparation; the first step ends a quarter in.
        ([0.0, 3.5, 5.0, 7.0], 2, 7.0),
        # As many epochs again by an earlier process.
        ([0.0, 3.5, 5.0, 7.0], 4, 11.0),
    ],
)
def test_stopwatch_counts_preparation_once(
    monkeypatch: pytest.MonkeyPatch, at: list[float], watched: int, seconds: float
) -> None:
    times = iter(at)
    monkeypatch.setattr(time, "process_time", lambda: next(times))
    watch = Stopwatch(torch.device("cpu"))
    epoch = Epoch(0, 1.0, 0.5, 0.5, 1.0, 9.0)
    watch.step(0, 1, 4)
    watch.epoch(epoch)
    watch.epoch(epoch)
    assert watch.read([epoch] * watched) == (seconds, "processor")


def test_stopwatch_that_watched_nothing_knows_elapsed_time() -> None:
    epoch = Epoch(0, 1.0, 0.5, 0.5, 1.0, 9.0)
    assert Stopwatch(torch.device("cpu")).read([epoch] * 2) == (18.0, "elapsed")


# --- the report


def finish(work: Path, test: float, **settings: object) -> CellResult:
    """Put a finished cell with a made-up accuracy into ``work``."""
    chosen = Settings.model_validate(settings)
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


@pytest.mark.slow
def test_report_says_what_the_cells_found(tmp_path: Path) -> None:
    work, out = tmp_path / "work", tmp_path / "report"
    finish(work, 0.96, classifier="LR", embedding="24x32")  # the paper: 95.5
    finish(work, 0.78, classifier="LR", embedding="3x4", seed=0)  # 79.3
    finish(work, 0.80, classifier="LR", embedding="3x4", seed=1)
    finish(work, 0.88, classifier="LR", embedding="3x4", binning="point")
    for seed in range(3):
        finish(work, 0.950 + 0.001 * seed, classifier="LR", embedding="12x16", seed=seed)  # 93.5
        finish(work, 0.90 + 0.01 * seed, classifier="LR", embedding="6x8", seed=seed)  # 91.4
    finish(work, 0.99, classifier="CNN16", embedding="24x32")
    write_report(out, find_table("mnist"), list(load_results(work)), work)
    markdown, page = ((out / name).read_text() for name in ("report.md", "report.html"))
    rows = {
        (cells[1], cells[2]): cells[3:7]
        for line in markdown.splitlines()
        if len(cells := [cell.strip() for cell in line.split("|")]) == 8
    }
    assert rows["LR", "learned mask"] == [
        "96.00 (95.5, +0.5)",  # one seed decides nothing
        "95.10 ± 0.25 (93.5, ▲ +1.6)",
        "91.00 ± 2.48 (91.4, = −0.4)",
        "79.00 ± 12.71 (79.3, −0.3)",
    ]
    assert rows["LR", "learned mask, point binning"][3] == "88.00 (79.3, +8.7)"
    assert rows["LR", "fixed mask, measured"] == ["– (92.8)", "– (91.9)", "– (87.7)", "– (73.4)"]
    assert markdown.count("| 12 s | 34 µs |") == 5
    assert markdown.count("| 12 s* | 34 µs |") == 1
    for verdict, count in (("win", 1), ("tie", 1), ("loss", 0)):
        assert page.count(f'class="{verdict}"') == 2 * count  # in the table and in the list
    assert "mnist &lt;here&gt;" in page
    pictures = re.findall(r"\]\(pictures/(\w+)\.png\)", markdown)
    assert set(pictures) == {
        *("cost", "curves", "psfs", "embeddings", "confusion_LR", "confusion_CNN16"),
    }
    assert len(re.findall(r'src="data:image/png;base64,', page)) == page.count("src=") == 6


@pytest.mark.parametrize(
    ("tests", "verdict"),
    [
        ((96.5, 96.5), None),
        # Of no spread: the paper's 95.5 stands for all from 95.45 to 95.55.
        ((95.56, 95.56, 95.56), "win"),
        ((95.54, 95.54, 95.54), "tie"),
        ((95.44, 95.44, 95.44), "loss"),
        # Half of the interval of three, d apart, is 4.303 d / sqrt(3); of four 3.182 * 1.291 d / 2.
        ((95.9, 96.0, 96.1), "win"),  # 96 - 0.25
        ((95.8, 96.0, 96.2), "tie"),  # 96 - 0.50
        ((95.75, 95.9, 96.05, 96.2), "win"),  # 95.975 - 0.31
    ],
)
def test_seeds_decide(tmp_path: Path, tests: tuple[float, ...], verdict: str | None) -> None:
    results = [
        finish(tmp_path, test / 100, classifier="LR", embedding="24x32", seed=seed)
        for seed, test in enumerate(tests)
    ]
    (entry,) = Summary(find_table("mnist"), results).finished()
    assert entry.paper == 95.5
    assert entry.verdict == verdict


def test_report_of_nothing_shows_the_paper(tmp_path: Path) -> None:
    write_report(tmp_path, find_table("robust"), [], tmp_path)
    text = (tmp_path / "report.md").read_text()
    assert "| FC800 | learned mask | – (98.7) | – (68.8) |" in text
    assert "![" not in text


def test_cost_chart_shows_accuracy_size_and_both_times(tmp_path: Path) -> None:
    first = finish(tmp_path, 0.96, classifier="LR", embedding="24x32")
    first = first.model_copy(update={"seconds": 99.0, "inference_seconds": 1e-3})
    other = finish(tmp_path, 0.78, classifier="LR", embedding="3x4")
    axes = draw_cost(Summary(find_table("mnist"), [first, other])).axes[0]
    points = [point for point in axes.collections if isinstance(point, PathCollection)]
    places = np.array([point.get_offsets() for point in points])[:, 0]
    assert places[:, 0].tolist() == [99.0, 12.0]
    assert places[:, 1] == pytest.approx([4.0, 22.0])
    assert float(points[0].get_sizes()[0]) > float(points[1].get_sizes()[0])
    colours = [float(np.asarray(point.get_array())[0]) for point in points]
    assert colours == pytest.approx([1000.0, 34.0])


def test_charts_want_the_pictures_of_a_cell(tmp_path: Path) -> None:
    work = tmp_path / "work"
    result = finish(work, 1.0, classifier="LR", encoder="digital", embedding="3x4")
    charts = draw_charts(tmp_path, Summary(find_table("mnist"), [result]), work)
    assert all((tmp_path / name).stat().st_size for name, _ in charts)
    (work / result.cell.name / "pictures.npz").unlink()
    with pytest.raises(TrainingError, match="holds no pictures"):
        draw_charts(tmp_path, Summary(find_table("mnist"), [result]), work)


def test_pictures_show_the_mask_that_was_learned(source: Source, tmp_path: Path) -> None:
    settings = Settings(embedding="3x4")
    model = make_model(settings, source, Camera())
    validation = split(source.training()).validation
    with torch.no_grad():
        next(iter(model.encoder.parameters()))[:25] = 0  # the upper half is closed
    made = make_pictures(model, settings, validation)
    assert np.allclose(made.scenes, validation.scenes(slice(3)))
    assert (made.embeddings.max((1, 2)) == 1).all()
    save_pictures(tmp_path / "a.npz", made)
    kept = load_pictures(tmp_path / "a.npz")
    assert np.allclose(kept.embeddings, made.embeddings, atol=0.5 / 255 + 1e-6)
    assert kept.psf is not None
    halves = sorted((float(kept.psf[:40].sum()), float(kept.psf[-40:].sum())))
    assert halves[0] < 0.05 * halves[1]


# --- figures


def test_change_is_recorded_with_the_classifier_that_validates_best(tmp_path: Path) -> None:
    path = tmp_path / "figures.json"
    results = [
        finish(tmp_path, test, classifier=classifier, encoder=encoder, change="shift")
        for test, classifier, encoder in (
            (0.96, "CNN16", "learned"),
            (0.60, "FC800", "learned"),
            (0.99, "FC800", "lens"),
        )
    ]
    # What it tests at does not choose it.
    results[1] = results[1].model_copy(update={"test_accuracy": 0.999})
    record_cells(path, results)
    found = {name: figure["value"] for name, figure in json.loads(path.read_text()).items()}
    assert found == {
        "robust_shift": 96.0,
        "robust_shift_CNN16_learned": 96.0,
        "robust_shift_FC800_learned": 99.9,
        "robust_shift_FC800_lens": 99.0,
    }


def test_seeds_that_several_commands_ran_name_them_all(tmp_path: Path) -> None:
    path = tmp_path / "figures.json"
    first, second = (finish(tmp_path, 0.8, encoder="lens", seed=seed) for seed in (0, 1))
    origin = Origin("benchmarks.paper again", "def456", "2026-01-30", "another machine")
    record_cells(path, [first, second.model_copy(update={"origin": origin})])
    assert json.loads(path.read_text())["mnist_LR_lens_24x32"] == {
        "value": 80.0,
        "command": "benchmarks.paper again; benchmarks.paper mnist <here>",
        "commit": "def456, abc123",
        "date": "2026-01-31",
        "machine": "a machine",
    }


def test_cells_with_other_settings_are_no_seeds_of_each_other(tmp_path: Path) -> None:
    results = [
        finish(tmp_path, 0.8, encoder="lens"),
        finish(tmp_path, 0.9, encoder="lens", seed=1, recipe=Recipe(epochs=7)),
    ]
    said = "mnist_LR_lens_24x32 and mnist_LR_lens_24x32_seed1 differ in more than their seed"
    with pytest.raises(TrainingError, match=said):
        record_cells(tmp_path / "figures.json", results)
    with pytest.raises(TrainingError, match=said):
        Summary(find_table("mnist"), results)
