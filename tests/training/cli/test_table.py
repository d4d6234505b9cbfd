"""``veilcam-train table``: parts, resume, budget, workers, figures."""

from __future__ import annotations

import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from veilcam_training.bundle import read_bundle
from veilcam_training.cli import main as cli
from veilcam_training.cli import table as command
from veilcam_training.config.settings import Settings
from veilcam_training.experiments import runner as run_module
from veilcam_training.experiments.grid import (
    TABLES,
    Cell,
    Column,
    Part,
    Place,
    Row,
    find_table,
    load_paper,
)
from veilcam_training.experiments.results import load_results
from veilcam_training.experiments.stopwatch import Stopwatch, time_label
from veilcam_training.files import read_private
from veilcam_training.trainer.callbacks import Epoch
from veilcam_training.trainer.evaluation import confusion

Call = Callable[..., int]
ONE = ("--encoders", "learned", "--embeddings", "6x8", "--binnings", "area", "--classifiers", "LR")


@pytest.fixture
def train(monkeypatch: pytest.MonkeyPatch) -> Call:
    """``veilcam-train`` with arguments; its exit status."""

    def run(*arguments: object) -> int:
        monkeypatch.setattr(sys, "argv", ["veilcam-train", *map(str, arguments)])
        with pytest.raises(SystemExit) as caught:
            cli.main()
        return int(caught.value.code or 0)

    return run


@pytest.fixture
def call(train: Call) -> Call:
    """``veilcam-train table`` with arguments."""
    return partial(train, "table")


@pytest.fixture
def report(train: Call) -> Call:
    """``veilcam-train report`` with arguments."""
    return partial(train, "report")


def numbers(work: Path) -> list[dict[str, Any]]:
    return [result.numbers() for result in load_results(work)]


# --- which cells there are


def test_every_number_of_the_paper_has_its_cell() -> None:
    places = chain.from_iterable(table.places(psf=True) for table in TABLES.values())
    assert {place.title for place in places} >= load_paper().accuracy.keys()
    assert len(load_paper().accuracy) == 48 + 24 + 24 + 24
    # Read off the paper.
    for title, percent in (
        ("mnist_LR_learned_3x4", 79.3),
        ("mnist_FC800_coded_aperture_24x32_shift", 22.2),
        ("celeba-smiling_FC800_learned_3x4", 76.0),
        ("cifar10_VGG11_lens_27x36", 86.8),
    ):
        assert load_paper().accuracy[title] == percent


def test_a_table_has_the_papers_sampling_beside_each_learned_mask() -> None:
    places = find_table("mnist").places()
    assert len(set(places)) == len(places) == 2 * 4 * (5 + 1 + 1)
    sampled = [place for place in places if place.row.binning == "point"]
    assert {place.row.encoder for place in sampled} == {"learned"}
    assert len(sampled) == 2 * 4
    assert all(p.row.encoder != "fixed_measured" for p in places)
    names = [Cell(settings(place)).name for place in places]
    assert len(set(names)) == len(names)
    assert "mnist_FC800_learned_24x32" in names
    assert "mnist_FC800_learned_24x32_point" in names


def settings(place: Place, **changes: Any) -> Settings:
    return Settings(**place.row._asdict(), **place.column._asdict(), **changes)


@pytest.mark.parametrize(
    ("table", "part", "count"),
    [
        ("mnist", Part(encoders=["lens", "learned"]), 2 * 4 * 3),
        ("mnist", Part(encoders=["lens", "lens"], classifiers=["LR", "LR"]), 4),
        ("mnist", Part(classifiers=["CNN16"]), 4 * 7),
        ("mnist", Part(embeddings=["3x4"]), 2 * 7),
        ("mnist", Part(binnings=["area"]), 2 * 4 * 6),
        ("mnist", Part(binnings=["point"]), 2 * 4 * 5),
        ("mnist", Part(encoders=["fixed_measured"]), 2 * 4),
        ("robust", Part(), 5 * 7),
        ("robust", Part(changes=["none", "shift"]), 2 * 7),
        ("faces", Part(), 3 * 2 * 7),
        ("faces", Part(datasets=["faces-glasses"]), 2 * 7),
        ("celeba", Part(), 2 * 2 * 7),
        ("cifar10", Part(), 4 * 7),
        ("own", Part(), 2 * 4 * 7),
    ],
)
def test_a_chosen_part(table: str, part: Part, count: int) -> None:
    places = find_table(table).places(part)
    assert len(set(places)) == len(places) == count
    assert all(find_table(table).holds(settings(place)) for place in places)


@pytest.mark.parametrize(
    ("place", "name", "figure"),
    [
        (("LR", "lens", "area", "mnist", "none", "3x4"), "mnist_LR_lens_3x4", None),
        (
            ("FC800", "learned", "point", "mnist", "none", "6x8"),
            "mnist_FC800_learned_6x8_point",
            None,
        ),
        (
            ("FC800", "learned", "area", "mnist", "shift", "24x32"),
            "mnist_FC800_learned_24x32_shift",
            "robust_shift_FC800_learned",
        ),
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
def test_names(place: tuple[str, ...], name: str, figure: str | None) -> None:
    where = Place(Row(*place[:3]), Column(*place[3:]))
    assert where.name == name
    assert where.figure == (figure or name)
    assert Cell(settings(where, seed=4)).name == f"{name}_seed4"


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("digits",), "table 'digits' is unknown: use one of mnist, fashion, robust"),
        (("mnist", "--encoders", "lens,eye"), "no 'eye' among its encoders"),
        (("mnist", "--classifiers", "FC0"), "classifier 'FC0' is unknown"),
        (("mnist", "--embeddings", "5x5"), "no '5x5' among its embeddings: use one or more of 24"),
        (("mnist", "--binnings", "line"), "no 'line' among its binnings"),
        (("mnist", "--datasets", "fashion"), "no 'fashion' among its datasets"),
        (("mnist", "--changes", "shift"), "no 'shift' among its changes"),
        (("mnist", "--encoders", "digital", "--binnings", "point"), "has no binning 'point'"),
        (("mnist", "--encoders", ""), "no '' among its encoders"),
        (("mnist", "--budget", "10"), "--budget '10' is not valid: use e.g. 90s, 10m or 2h"),
        (("mnist", "--recipe", "none"), "recipe 'none' is unknown"),
        (("mnist", "--epochs", "0"), "epochs is not valid"),
        (("mnist", "--device", "tpu"), "use cpu, cuda or auto"),
        (("mnist", "--workers", "2", "--ray", "a:1"), "use one of them"),
        (("mnist", "--encoders", "fixed_measured"), "give --psf FILE"),
        (("mnist", "--psf", "none.npz"), "none.npz is missing"),
        (("cifar10",), "data_batch_1.bin is missing"),
    ],
)
def test_what_cannot_be_run_is_one_line(
    call: Call,
    capsys: pytest.CaptureFixture[str],
    digit_folder: Path,
    tmp_path: Path,
    *,
    arguments: tuple[str, ...],
    reason: str,
) -> None:
    assert call(*arguments, "--data", digit_folder, "--work", tmp_path) == 1
    printed = capsys.readouterr()
    assert printed.err.startswith("error: ")
    assert reason in printed.err
    assert printed.err.count("\n") == 1
    assert not list(tmp_path.rglob("result.json"))


def test_a_report_needs_cells_and_a_place(
    report: Call, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert report("mnist", "--work", tmp_path / "none", "--out", tmp_path) == 1
    assert "none is not a folder" in capsys.readouterr().err
    assert report("mnist", "--work", tmp_path) == 1
    assert "give --out FOLDER or --figures FILE" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "place", "reason"),
    [
        ("--work", "file", "--work .*file cannot be written to"),
        ("--out", "file", "--out .*file cannot be written to"),
        ("--figures", "folder", "folder is not a record of figures"),
        ("--figures", "file", "file is not a record of figures"),
    ],
)
def test_places_are_tried_first(
    *,
    call: Call,
    report: Call,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    digit_folder: Path,
    tmp_path: Path,
    option: str,
    place: str,
    reason: str,
) -> None:
    def refuse(*arguments: Any, **more: Any) -> None:
        raise AssertionError

    monkeypatch.setattr(command, "run_cells", refuse)
    monkeypatch.setattr(command, "load_results", refuse)
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    places = {"--work": tmp_path / "work", option: tmp_path / place}
    options = [value for pair in places.items() for value in pair]
    assert call("mnist", "--data", digit_folder, *options) == 1
    assert re.search(reason, capsys.readouterr().err)
    if option != "--work":
        (tmp_path / "work").mkdir()
        assert report("mnist", *options) == 1
        assert re.search(reason, capsys.readouterr().err)


def test_options_reach_the_cells(
    call: Call,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    digit_folder: Path,
    tmp_path: Path,
) -> None:
    seen: dict[str, Any] = {}

    def run_cells(cells: Sequence[Cell], runner: Any, workers: Any) -> Iterator[Any]:
        seen.update(cells=cells, runner=runner)
        return iter(())

    def make_executor(*arguments: Any, **more: Any) -> None:
        seen.update(workers=arguments)

    monkeypatch.setattr(command, "run_cells", run_cells)
    monkeypatch.setattr(command, "make_executor", make_executor)
    options = ("--data", digit_folder, "--work", tmp_path)
    assert call("mnist", *options) == 0
    assert len(seen["cells"]) == 56
    assert {cell.settings.seed for cell in seen["cells"]} == {0}
    assert seen["workers"] == (None, None)
    assert not seen["runner"].until
    default = seen["cells"][0].settings.recipe

    psf = tmp_path / "a.npz"
    psf.touch()
    chosen = ("--seeds", 2, "--seed", 5, "--psf", psf, "--workers", 3, "--device", "cpu")
    assert call("mnist", *options, *chosen, "--budget", "1h", "--recipe", "paper") == 0
    cells = [cell.settings for cell in seen["cells"]]
    assert len(cells) == 2 * 64
    assert {cell.seed for cell in cells} == {5, 6}
    assert {cell.psf for cell in cells if cell.encoder == "fixed_measured"} == {psf}
    assert {cell.psf for cell in cells if cell.encoder != "fixed_measured"} == {None}
    assert seen["workers"] == (3, None)
    left = seen["runner"].until - time.time()
    assert 3500 < left <= 3600
    assert cells[0].recipe != default
    # Every cell has the recipe of its own situation.
    assert {cell.recipe.batch for cell in cells} == {32, 64, 100}

    assert call("mnist", *options, "--psf", psf, "--encoders", "lens") == 1
    assert "--psf is of fixed_measured" in capsys.readouterr().err
    lens = ("--psf", f"lens={psf}", "--encoders", "lens,learned")
    assert call("mnist", *options, *lens) == 0
    assert {cell.settings.psf for cell in seen["cells"] if cell.settings.encoder == "lens"} == {psf}
    assert {cell.settings.psf for cell in seen["cells"] if cell.settings.encoder == "learned"} == {
        None
    }
    assert call("mnist", *options, *lens, "--psf", f"lens={psf}") == 1
    assert "--psf is given twice for lens" in capsys.readouterr().err
    assert call("mnist", *options, "--psf", f"learned={psf}") == 1
    assert "encoder 'learned' takes no PSF" in capsys.readouterr().err

    assert call("mnist", *options, "--epochs", 3, "--ray", "host:1") == 0
    assert seen["cells"][0].settings.recipe == default.model_copy(update={"epochs": 3})
    assert seen["workers"] == (None, "host:1")


# --- running them


@pytest.mark.slow
def test_finished_cells_are_kept(
    *,
    call: Call,
    report: Call,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    digit_folder: Path,
    tmp_path: Path,
) -> None:
    work, figures = tmp_path / "work", tmp_path / "figures.json"
    options = ("--data", digit_folder, "--work", work, "--epochs", 2)
    chosen = ("--encoders", "learned,digital", "--classifiers", "LR", "--embeddings", "6x8,3x4")
    assert call("mnist", *options, *chosen, "--figures", figures, "--seeds", 2) == 0
    printed = capsys.readouterr().out
    results = list(load_results(work))
    assert len(results) == 2 * 6
    for result in results:
        line = next(x for x in printed.splitlines() if x.startswith(f"{result.cell.name} "))
        assert f"test {100 * result.test_accuracy:.2f} %" in line
        assert f"validation {100 * result.validation_accuracy:.2f} %" in line
        assert (result.cell.place.paper is None) == ("paper" not in line)
        matrix = torch.tensor(result.confusion)
        assert int(matrix.sum()) == 100
        assert int(matrix.trace()) / 100 == result.test_accuracy
        assert len(result.epochs) == 2
        assert result.inference_seconds > 0
        assert not (work / result.cell.name / "checkpoint").exists()
    # A mask that a device could show comes as a bundle.
    bundles = {path.parent.name for path in work.glob("*/pair.veilcam")}
    assert bundles == {
        f"mnist_LR_learned_{size}{seed}" for size in ("6x8", "3x4") for seed in ("", "_seed1")
    }
    bundle = read_bundle(work / "mnist_LR_learned_6x8" / "pair.veilcam")
    assert bundle.accuracy is not None
    by_name = {result.cell.name: result for result in results}
    assert bundle.accuracy.value == by_name["mnist_LR_learned_6x8"].test_accuracy

    record = json.loads(figures.read_text())
    assert len(record) == 6
    pair = (by_name["mnist_LR_digital_3x4"], by_name["mnist_LR_digital_3x4_seed1"])
    mean = sum(100 * result.test_accuracy for result in pair) / 2
    assert record["mnist_LR_digital_3x4"]["value"] == pytest.approx(mean, abs=0.005)
    assert record["mnist_LR_learned_3x4_point"]["command"].startswith("veilcam-train table mnist")

    # Nothing is run again, and the figures say still what made them.
    def refuse(*arguments: Any, **more: Any) -> None:
        raise AssertionError

    monkeypatch.setattr(run_module, "run_fit", refuse)
    figures.unlink()
    assert call("mnist", *options, "--figures", figures, *chosen, "--seeds", 2) == 0
    assert json.loads(figures.read_text()) == record
    figures.unlink()
    out = tmp_path / "report"
    assert report("mnist", "--work", work, "--figures", figures, "--out", out) == 0
    assert json.loads(figures.read_text()) == record
    assert "12 cells" in capsys.readouterr().out
    assert (out / "report.html").exists()
    # Other settings are not taken for these.
    assert call("mnist", "--data", digit_folder, "--work", work, "--epochs", 3, *chosen) == 1
    assert "was made with other settings" in capsys.readouterr().err
    (work / "mnist_LR_digital_3x4" / "result.json").write_text("{}")
    assert call("mnist", *options, *chosen) == 1
    assert "is not the result of a cell" in capsys.readouterr().err


KILLED = """
import os, signal
from veilcam_training.cli.main import main
from veilcam_training.trainer import loop

save = loop.save_checkpoint

def save_and_die(*arguments):
    save(*arguments)
    os.kill(os.getpid(), signal.SIGKILL)

loop.save_checkpoint = save_and_die
main()
"""


@pytest.mark.slow
def test_a_killed_table_ends_with_the_same_numbers(
    call: Call, digit_folder: Path, tmp_path: Path
) -> None:
    broken, whole = tmp_path / "broken", tmp_path / "whole"
    chosen = (*ONE, "--data", digit_folder, "--epochs", 3)
    arguments = ["table", "mnist", *map(str, chosen), "--work", str(broken)]
    checkpoint = broken / "mnist_LR_learned_6x8" / "checkpoint"
    killed = subprocess.run(
        [sys.executable, "-c", KILLED, *arguments],
        stdout=subprocess.DEVNULL,
        check=False,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    assert killed.returncode == -signal.SIGKILL
    # It was in the middle of the cell.
    assert not (checkpoint.parent / "result.json").exists()
    content = read_private(checkpoint)
    assert content is not None
    done = torch.load(io.BytesIO(content), weights_only=True)["state"]["history"]
    assert len(done) == 1

    assert call("mnist", *chosen, "--work", broken) == 0
    assert call("mnist", *chosen, "--work", whole) == 0
    assert numbers(broken) == numbers(whole)
    pairs = [
        read_bundle(work / checkpoint.parent.name / "pair.veilcam").pairs[0]
        for work in (broken, whole)
    ]
    assert (pairs[0].levels == pairs[1].levels).all()
    assert all(np.array_equal(pairs[0].weights[k], pairs[1].weights[k]) for k in pairs[1].weights)
    # And it was taken up, not begun again.
    epochs = next(load_results(broken)).epochs
    assert [epoch.loss for epoch in epochs][: len(done)] == [epoch["loss"] for epoch in done]


@pytest.mark.slow
def test_budget(
    call: Call,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    digit_folder: Path,
    tmp_path: Path,
) -> None:
    chosen = ("--encoders", "lens,digital", "--classifiers", "LR", "--embeddings", "6x8,3x4")
    options = ("--data", digit_folder, "--work", tmp_path, "--epochs", 1)
    # A clock on which every cell takes four minutes.
    clock = time.time()
    monkeypatch.setattr(
        time, "time", lambda: clock + 240 * len(list(tmp_path.glob("*/result.json")))
    )
    assert call("mnist", *options, *chosen, "--budget", "7m") == 0
    assert "2 of 4 cells are left: start again to go on" in capsys.readouterr().out
    assert len(numbers(tmp_path)) == 2
    assert call("mnist", *options, *chosen, "--budget", "0s") == 0
    assert "2 of 4 cells are left" in capsys.readouterr().out
    assert call("mnist", *options, *chosen) == 0
    assert "left" not in capsys.readouterr().out
    assert len(numbers(tmp_path)) == 4


@pytest.mark.slow
@pytest.mark.parametrize(
    ("table", "files", "part", "cells"),
    [
        ("cifar10", "cifar_files", ("--binnings", "area"), 1),
        ("celeba", "celeba_files", (), 4),
        ("faces", "faces_file", ("--binnings", "area"), 3),
        ("own", "drawn_files", ("--binnings", "area", "--classifiers", "LR"), 1),
    ],
)
def test_every_data_set_has_its_table(
    *,
    table: str,
    files: str,
    part: tuple[str, ...],
    cells: int,
    call: Call,
    request: pytest.FixtureRequest,
    tmp_path: Path,
) -> None:
    data, work, out = tmp_path / "data", tmp_path / "work", tmp_path / "report"
    data.mkdir()
    request.getfixturevalue(files)(data)
    options = ("--data", data, "--work", work, "--epochs", 1, "--out", out)
    chosen = ("--encoders", "learned", "--embeddings", "3x4", *part)
    assert call(table, *options, *chosen) == 0
    results = list(load_results(work))
    assert len(results) == cells
    assert {result.settings.data for result in results} == set(find_table(table).datasets)
    text = (out / "report.md").read_text()
    for result in results:
        assert f"`{result.cell.place.name}`" in text
        assert f"{100 * result.test_accuracy:.2f}" in text


@pytest.mark.slow
def test_robust_and_fashion(call: Call, digit_folder: Path, tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    options = ("--data", digit_folder, "--work", tmp_path / "work", "--epochs", 1)
    chosen = ("--encoders", "learned", "--binnings", "area", "--figures", figures)
    assert call("robust", *options, *chosen, "--changes", "none,rotate,perspective") == 0
    part = (*chosen, "--classifiers", "FC800", "--embeddings", "24x32")
    assert call("fashion", *options, *part) == 0
    names = {"mnist_FC800_learned_24x32"}
    for change in ("rotate", "perspective"):
        names |= {f"robust_{change}", f"robust_{change}_FC800_learned"}
    assert json.loads(figures.read_text()).keys() == names | {"fashion_fc800_learned_24x32"}


# --- what they are made of


def test_confusion() -> None:
    labels, predictions = torch.tensor([0, 0, 2, 2, 2]), torch.tensor([0, 1, 2, 2, 0])
    assert confusion(labels, predictions, 3).tolist() == [[1, 1, 0], [0, 0, 0], [1, 0, 2]]


def test_time_of_a_label() -> None:
    model = torch.nn.Sequential(torch.nn.Linear(12, 10), torch.nn.BatchNorm1d(10))
    model.train()
    state = {name: value.clone() for name, value in model.state_dict().items()}
    assert 0 < time_label(model, 12) < 1
    assert model.training
    assert all(torch.equal(state[name], value) for name, value in model.state_dict().items())


def test_stopwatch_counts_the_epochs_of_an_earlier_process(monkeypatch: pytest.MonkeyPatch) -> None:
    epochs = [Epoch(number, 1.0, 0.5, 0.5, 1.0, seconds=40.0) for number in range(5)]
    for device, kind, clock in (
        ("cpu", "processor", "process_time"),
        ("cuda", "elapsed", "monotonic"),
    ):
        now = iter([100.0, 103.0, 104.0])
        with monkeypatch.context() as patch:
            patch.setattr(time, clock, lambda now=now: next(now))
            watch = Stopwatch(torch.device(device))
            assert watch.read(epochs) == (5 * 40, "elapsed")
            for epoch in epochs[3:]:
                watch.epoch(epoch)
        assert watch.read(epochs) == (5 * 2, kind)


def test_stopwatch_counts_what_was_prepared_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten seconds before the first step, then four steps to an epoch and one second to a step."""
    for earlier in (0, 3):
        now = iter([100.0, 111.0, *range(114, 131, 4)])
        with monkeypatch.context() as patch:
            patch.setattr(time, "process_time", lambda now=now: next(now))
            watch = Stopwatch(torch.device("cpu"))
            epochs = [Epoch(number, 1.0, 0.5, 0.5, 1.0, seconds=9.0) for number in range(5)]
            for epoch in epochs[earlier:]:
                for step in range(4):
                    watch.step(epoch.number, step + 1, 4)
                watch.epoch(epoch)
        assert watch.read(epochs) == (10 + 5 * 4, "processor")


def test_stopwatch_of_one_step(monkeypatch: pytest.MonkeyPatch) -> None:
    now = iter([100.0, 111.0, 112.0])
    monkeypatch.setattr(time, "process_time", lambda: next(now))
    watch = Stopwatch(torch.device("cpu"))
    watch.step(0, 1, 1)
    watch.epoch(epoch := Epoch(0, 1.0, 0.5, 0.5, 1.0, seconds=9.0))
    assert watch.read([epoch]) == (12, "processor")
