"""``veilcam-train`` end to end on small files, and what it says to bad input."""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import pytest
import torch
from tensorboard.backend.event_processing import (  # type: ignore[import-untyped]
    event_accumulator,
)
from tests.fits.conftest import Call

from veilcam_optics.camera.masks import to_weights
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_training.bundle import read_bundle
from veilcam_training.cli import main as cli
from veilcam_training.cli.bundle import light_line
from veilcam_training.cli.fit import parse_budget, run_folder
from veilcam_training.data import Source
from veilcam_training.models.network import build_classifier
from veilcam_training.seeding import stream
from veilcam_training.trainer import loop as fitting

FIT = ("--embedding", "6x8", "--classifier", "FC20", "--epochs", "6", "--batch", "30")


@pytest.mark.thorough
def test_keyring_end_to_end(call: Call, source: Source, digit_folder: Path, tmp_path: Path) -> None:
    out, work = tmp_path / "k.veilcam", tmp_path / "work"
    command = ("keyring", "--data", digit_folder, *FIT, "--pairs", 2, "--out", out, "--seed", 7)
    printed = call(*command, "--work", work)
    assert "2 pairs, mean accuracy" in printed
    assert len(list(work.iterdir())) == 2
    bundle = read_bundle(out)
    assert bundle.accuracy is not None
    assert bundle.accuracy.value > 0.8
    assert bundle.provenance["settings"]["epochs"] == 6  # type: ignore[index, call-overload]
    seeds = {pair["seed"] for pair in bundle.provenance["pairs"]}  # type: ignore[union-attr, index, call-overload]
    assert len(seeds) == 2
    assert all(pair.transfer_error is not None for pair in bundle.pairs)
    # A terminal breaks lines where it likes.
    told = " ".join(printed.split())
    assert light_line(bundle.light, bundle.transfer_error) in told
    assert 7 in seeds
    # Each pair works behind its own mask and not behind the other's.
    test, share = source.test(), {}
    operator = TransferOperator(bundle.camera, bundle.scene, bundle.embedding)
    for i, mask in enumerate(bundle.pairs):
        weights = torch.from_numpy(to_weights(mask.levels, bundle.camera.panel))
        binning = shot_noise(operator.embed(test.scenes(), weights), 40, stream(0, "noise"))
        for j, pair in enumerate(bundle.pairs):
            logits = build_classifier(pair.layers, pair.weights)(binning.flatten(1))
            share[i, j] = float((logits.argmax(1) == test.labels).float().mean())
    assert min(share[0, 0], share[1, 1]) > 0.8
    assert max(share[0, 1], share[1, 0]) < 0.6
    # Started again, it is done at once and writes the same masks.
    call(*command, "--work", work)
    again = read_bundle(out)
    assert all((a.levels == b.levels).all() for a, b in zip(bundle.pairs, again.pairs, strict=True))


@pytest.mark.thorough
def test_fit_prints_and_writes(call: Call, digit_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    printed = call("fit", "--data", digit_folder, *FIT, "--threads", 1, "--out", out)
    assert "FC20 learned 6x8: epoch 6 of 6  validation" in printed
    assert f"wrote {out}/report.html" in printed.replace("\n", "")
    assert {path.name for path in out.iterdir()} == {
        *("model.veilcam", "history.csv", "accuracy.png", "confusion.png", "worst.png"),
        *("report.html", "work"),
    }
    bundle = read_bundle(out / "model.veilcam")
    assert bundle.task == "mnist"
    assert bundle.light is not None
    assert bundle.transfer_error is not None
    assert light_line(bundle.light, bundle.transfer_error) in " ".join(printed.split())
    assert torch.get_num_threads() == 1


def test_file_logs_and_other_options(call: Call, digit_folder: Path, tmp_path: Path) -> None:
    config, logs = tmp_path / "a.toml", tmp_path / "logs"
    config.write_text('embedding = "3x4"\nencoder = "lens"\nchange = "rotate"\nepochs = 2\n')
    options = ("--config", config, "--embedding", "6x8", "--tensorboard", logs, "--device", "cpu")
    printed = call("fit", "--data", digit_folder, *options, "--out", tmp_path / "run")
    assert "lens" in printed
    assert "6x8" in printed
    assert "light:" not in printed
    assert "no bundle: a device cannot show this camera" in printed
    curves = event_accumulator.EventAccumulator(str(logs))
    curves.Reload()
    assert len(curves.Scalars("accuracy/validation")) == 2
    assert [point.step for point in curves.Scalars("loss/training")] == [1, 2]
    rows = list(csv.DictReader((tmp_path / "run" / "history.csv").read_text().splitlines()))
    assert [row["epoch"] for row in rows] == ["1", "2"]
    for column, curve in (
        ("training_loss", "loss/training"),
        ("validation_loss", "loss/validation"),
        ("training_accuracy", "accuracy/training"),
        ("validation_accuracy", "accuracy/validation"),
        ("seconds", "seconds"),
    ):
        points = [point.value for point in curves.Scalars(curve)]
        # TensorBoard keeps float32.
        assert [float(row[column]) for row in rows] == pytest.approx(points, rel=1e-6)


def test_download_says_what_it_can_fetch(call: Call, tmp_path: Path) -> None:
    assert "use one of mnist, fashion, cifar10" in call(
        "download", "celeba-gender", "--data", tmp_path, code=1
    )


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("--data", "/none"), "not a folder"),
        (("--dataset", "imagenet"), "data set 'imagenet' is unknown: use one of mnist"),
        (("--classifier", "FC0"), "classifier 'FC0' is unknown: use one of LR, FC<width>"),
        (("--encoder", "eye"), "encoder 'eye' is unknown"),
        (("--embedding", "24"), "embedding '24' is not valid: use ROWSxCOLUMNS"),
        (("--embedding", "0x4"), "embedding '0x4' is not valid"),
        (("--recipe", "none"), "recipe 'none' is unknown"),
        (("--epochs", "0"), "epochs is not valid"),
        (("--seed", "-1"), "seed is not valid"),
        (("--device", "tpu"), "use cpu, cuda or auto"),
        (("--binning", "line"), "binning is not valid"),
        (("--change", "twist"), "change is not valid"),
        (("--psf", "a.npz"), "leave out --psf"),
        (("--encoder", "fixed_measured"), "give --psf FILE"),
        (("--encoder", "fixed_measured", "--psf", "a.npz"), "a.npz is missing"),
        (("--config", "none.toml"), "none.toml is missing"),
        (("--out", "a.veilcam"), "--out a.veilcam is not valid: give a folder"),
        (("--out", "."), "--out . holds files: go on with --resume, or use another folder"),
        (("--out", "new", "--resume"), "new holds no fit to go on with: leave out --resume"),
        (("--resume",), "runs/digits-24x32 holds no fit to go on with"),
        (("--budget", "3"), "--budget 3 is not valid: use e.g. 90s, 3m or 1h"),
        (("--budget", "0s"), "--budget 0s is not valid"),
        (("--budget", "3m", "--epochs", "2"), "a budget chooses the epochs, so use one of them"),
        (("--budget", "3m"), "a budget is for a Scene classifier"),
        (("--fresh", "--encoder", "lens"), "fresh masks have no encoder: leave it out"),
    ],
)
def test_bad_input_is_one_line_that_says_what_to_do(
    monkeypatch: pytest.MonkeyPatch,
    call: Call,
    digit_folder: Path,
    tmp_path: Path,
    *,
    arguments: tuple[str, ...],
    reason: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "digits").symlink_to(digit_folder)
    said = call("fit", "--data", "digits", *arguments, code=1)
    assert said.startswith("error: ")
    assert reason in said
    assert said.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["digits"]


def test_keyring_for_a_binning_of_no_device(call: Call, digit_folder: Path, tmp_path: Path) -> None:
    config, out, work = tmp_path / "a.toml", tmp_path / "a.veilcam", tmp_path / "work"
    config.write_text('binning = "point"')
    command = ("keyring", "--data", digit_folder, *FIT, "--config", config, "--out", out)
    assert "a device averages over its pixels: use binning 'area'" in call(
        *command, "--seed", 1, "--work", work, code=1
    )
    assert not work.exists()  # nothing was fitted
    assert not out.exists()


@pytest.mark.thorough
@pytest.mark.parametrize("name", ["fit", "keyring"])
def test_broken_off_run_is_taken_up(
    monkeypatch: pytest.MonkeyPatch, call: Call, digit_folder: Path, tmp_path: Path, name: str
) -> None:
    out, work = tmp_path / "run", tmp_path / "work"
    options: tuple[object, ...] = ("--data", digit_folder, *FIT, "--epochs", 1, "--out", out)
    again: tuple[str, ...] = ("--resume",)
    if name == "keyring":
        options = (*options[:-1], tmp_path / "a.veilcam", "--pairs", 1, "--work", work)
        again = ()
    call(name, *options)
    kept = work if name == "keyring" else out / "work"
    assert {path.name for path in kept.iterdir()} > {"seed"}

    def begun(*_: object, **__: object) -> None:
        raise AssertionError

    monkeypatch.setattr(fitting, "_run_epoch", begun)  # what is in it is taken up
    call(name, *options, *again)


def test_run_has_a_folder_of_its_own(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    first, second = Path("runs/shapes"), Path("runs/shapes-2")
    for folder in (first, second):
        assert run_folder(None, "shapes", resume=False) == folder
        (folder / "work").mkdir(parents=True)
    assert run_folder(None, "shapes", resume=True) == second
    assert run_folder(first, "other", resume=True) == first


def test_budget_is_a_number_with_a_unit() -> None:
    assert [parse_budget(text) for text in ("90s", "3m", "1.5h")] == [90, 180, 5400]


@pytest.mark.parametrize("name", ["fit", "keyring"])
def test_threads(
    monkeypatch: pytest.MonkeyPatch, call: Call, digit_folder: Path, tmp_path: Path, name: str
) -> None:
    seen: list[int] = []
    monkeypatch.setattr(torch, "set_num_threads", seen.append)
    # Refused, but only after the threads are set.
    command = (name, "--data", digit_folder, "--out", tmp_path / "none" / "a.veilcam")
    call(*command, "--threads", 3, code=1)
    assert seen == [3]
    seen.clear()
    call(*command, code=1)
    assert seen == []


def test_worker_threads(
    monkeypatch: pytest.MonkeyPatch, digit_folder: Path, tmp_path: Path
) -> None:
    class StopError(Exception):
        pass

    def make_executor(*_: object, threads: int | None, **__: object) -> None:
        assert threads == 3
        raise StopError

    monkeypatch.setattr(torch, "set_num_threads", lambda _: None)
    monkeypatch.setattr(cli, "make_executor", make_executor)
    out = tmp_path / "a.veilcam"
    command = ("keyring", "--data", digit_folder, "--out", out, "--workers", 2, "--threads", 3)
    monkeypatch.setattr(sys, "argv", ["veilcam-train", *map(str, command)])
    with pytest.raises(StopError):
        cli.main()


def test_misspelt_option(call: Call) -> None:
    assert "--epoch" in call("fit", "--data", ".", "--epoch", "3", code=2)
