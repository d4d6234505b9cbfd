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

from veilcam_optics.camera.geometry import Camera
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_training.bundle import read_bundle
from veilcam_training.cli import main as cli
from veilcam_training.cli.bundle import light_line
from veilcam_training.config.recipes import Recipe
from veilcam_training.config.settings import Settings
from veilcam_training.data import Source
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.fit import run_fit
from veilcam_training.experiments.keyring import as_bundle
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
    assert bundle.provenance["settings"]["recipe"]["epochs"] == 6  # type: ignore[index, call-overload]
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
    out = tmp_path / "a.veilcam"
    printed = call("fit", "--data", digit_folder, *FIT, "--threads", 1, "--out", out)
    assert "FC20" in printed
    assert f"wrote {out}" in printed.replace("\n", "")
    bundle = read_bundle(out)
    assert bundle.task == "mnist"
    assert bundle.light is not None
    assert bundle.transfer_error is not None
    assert light_line(bundle.light, bundle.transfer_error) in " ".join(printed.split())
    assert torch.get_num_threads() == 1


def test_file_logs_and_other_options(call: Call, digit_folder: Path, tmp_path: Path) -> None:
    config, logs = tmp_path / "a.toml", tmp_path / "logs"
    config.write_text(
        'embedding = "3x4"\nencoder = "lens"\nchange = "rotate"\n[recipe]\nepochs = 2\n'
    )
    table = tmp_path / "epochs.csv"
    table.write_text("epoch,training_loss\n1,9\n2,9\n3,9\n")  # of a run before this one
    options = ("--config", config, "--embedding", "6x8", "--tensorboard", logs, "--device", "cpu")
    printed = call("fit", "--data", digit_folder, *options, "--csv", table)
    assert "lens" in printed
    assert "6x8" in printed
    assert "light:" not in printed
    curves = event_accumulator.EventAccumulator(str(logs))
    curves.Reload()
    assert len(curves.Scalars("accuracy/validation")) == 2
    assert [point.step for point in curves.Scalars("loss/training")] == [1, 2]
    rows = list(csv.DictReader(table.read_text().splitlines()))
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
        (("--encoder", "digital", "--out", "a.veilcam"), "no mask that a panel can show"),
        (("--binning", "point", "--out", "a.veilcam"), "use binning 'area', or leave out --out"),
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
    said = call("fit", "--data", digit_folder, *arguments, code=1)
    assert said.startswith("error: ")
    assert reason in said
    assert said.count("\n") == 1
    assert not list(tmp_path.glob("*.veilcam"))


def test_keyring_for_a_binning_of_no_device(call: Call, digit_folder: Path, tmp_path: Path) -> None:
    config, out, work = tmp_path / "a.toml", tmp_path / "a.veilcam", tmp_path / "work"
    config.write_text('binning = "point"')
    command = ("keyring", "--data", digit_folder, *FIT, "--config", config, "--out", out)
    assert "a device averages over its pixels: use binning 'area'" in call(
        *command, "--seed", 1, "--work", work, code=1
    )
    assert not work.exists()  # nothing was fitted
    assert not out.exists()


def test_no_bundle_of_a_binning_that_no_device_makes(source: Source) -> None:
    recipe = Recipe(epochs=1, batch=300)
    settings = Settings(embedding="3x4", binning="point", recipe=recipe)
    outcome = run_fit(settings, source, Camera())
    with pytest.raises(TrainingError, match="use binning 'area'"):
        as_bundle([outcome], source, Camera())


@pytest.mark.thorough
@pytest.mark.parametrize("name", [("fit",), ("keyring", "--pairs", 1)])
def test_work_has_checkpoints(
    monkeypatch: pytest.MonkeyPatch,
    call: Call,
    digit_folder: Path,
    tmp_path: Path,
    name: tuple[object, ...],
) -> None:
    work, out = tmp_path / "work", tmp_path / "a.veilcam"
    options = ("--data", digit_folder, *FIT, "--epochs", 1, "--seed", 1, "--out", out)
    call(*name, *options)
    assert list(tmp_path.iterdir()) == [out]
    call(*name, *options, "--work", work)
    assert {path.suffix for path in work.iterdir()} == {".checkpoint"}

    def begun(*_: object, **__: object) -> None:
        raise AssertionError

    monkeypatch.setattr(fitting, "_run_epoch", begun)  # what is in it is taken up
    call(*name, *options, "--work", work)


@pytest.mark.parametrize("name", ["fit", "keyring", "fit-fresh"])
def test_threads(
    monkeypatch: pytest.MonkeyPatch, call: Call, digit_folder: Path, tmp_path: Path, name: str
) -> None:
    seen: list[int] = []
    monkeypatch.setattr(torch, "set_num_threads", seen.append)
    # Refused, but only after the threads are set.
    command = (name, "--data", digit_folder, "--out", tmp_path / "a.zip")
    call(*command, "--threads", 3, code=1)
    assert seen == [3]
    seen.clear()
    call(*command, code=1)
    assert seen == ([1] if name == "fit-fresh" else [])


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
