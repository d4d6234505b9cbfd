"""``veilcam-train fit-fresh`` and ``frame`` end to end, and what they say to bad input."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from tensorboard.backend.event_processing import (  # type: ignore[import-untyped]
    event_accumulator,
)
from typer.testing import CliRunner

from veilcam_optics.camera.geometry import Embedding
from veilcam_optics.decoding import read_frame
from veilcam_training.bundle import read_bundle
from veilcam_training.cli.main import app
from veilcam_training.errors import TrainingError

SMALL = """classifier = "Scene2"
masks = 4
misalignment = {panels = 2}
recipe = {tolerance = 1e-4, rank = 20, epochs = 2}
"""
"""What a fit spends its time on, made small: nothing that a command says depends on it."""


@pytest.mark.slow
def test_command_writes_a_bundle(digit_folder: Path, tmp_path: Path) -> None:
    out, small = tmp_path / "fresh.veilcam", tmp_path / "small.toml"
    small.write_text(SMALL)
    command = ["fit-fresh", "--data", str(digit_folder), "--out", str(out)]
    chosen = ["--task", "mnist_3x4", "--config", str(small), "--epochs", "1", "--seed", "2"]
    result = CliRunner().invoke(app, [*command, *chosen, "--masks", "5"])
    assert result.exit_code == 0, result.output
    assert "on 5 unseen masks" in result.output
    bundle = read_bundle(out)
    assert bundle.light is not None
    told = f"planned to 1.0e-04, predicted error {bundle.light.error:.1e} (NOT reached"
    assert told in " ".join(result.output.split())
    assert bundle.fresh is not None
    assert bundle.provenance["settings"]["seed"] == 2  # type: ignore[index,call-overload]
    assert bundle.embedding == Embedding(3, 4)
    frame = tmp_path / "frame.safetensors"
    result = CliRunner().invoke(app, ["frame", str(out), str(frame)])
    assert result.exit_code == 0, result.output
    assert f"wrote {frame}" in result.output.replace("\n", "")
    assert read_frame(frame).embedding == bundle.embedding
    for refused, reason in (
        ([*command[:4], str(tmp_path / "fresh.zip")], "use a name that ends in .veilcam"),
        ([*command, "--epochs", "0"], "epochs is not valid: Input should be greater"),
        ([*command, "--seed", "-1"], "seed is not valid: Input should be greater"),
        (["frame", str(out), str(tmp_path / "a.zip")], "a name that ends in .safetensors"),
        (["frame", str(out), str(out / "a.safetensors")], f"make the folder {out} first"),
    ):
        error = CliRunner().invoke(app, refused).exception
        assert isinstance(error, TrainingError)
        assert reason in str(error)


@pytest.mark.thorough
def test_file_device_logs_and_work(digit_folder: Path, tmp_path: Path) -> None:
    config, logs, work = tmp_path / "a.toml", tmp_path / "logs", tmp_path / "work"
    config.write_text(f'task = "mnist_3x4"\n{SMALL}')
    out = tmp_path / "fresh.veilcam"
    command = ["fit-fresh", "--data", str(digit_folder), "--out", str(out), "--masks", "5"]
    command += ["--config", str(config), "--device", "cpu", "--work", str(work), "--batch", "80"]
    result = CliRunner().invoke(app, [*command, "--tensorboard", str(logs)])
    assert result.exit_code == 0, result.output
    made: Any = read_bundle(out).provenance["settings"]
    recipe = made["recipe"]
    assert (recipe["rank"], made["classifier"], recipe["batch"]) == (20, "Scene2", 80)
    assert made["misalignment"]["panels"] == 2
    # Nobody else knows the seed, and it is taken up with the rest.
    kept = {path.name for path in work.iterdir()}
    assert kept == {"fit.checkpoint", "seed", "statistics.checkpoint"}
    curves = event_accumulator.EventAccumulator(str(logs))
    curves.Reload()
    assert [point.step for point in curves.Scalars("accuracy/validation")] == [1, 2]
    first = read_bundle(out)
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    again: Any = read_bundle(out).provenance["settings"]
    assert again["seed"] == made["seed"] != 0
    assert read_bundle(out).accuracy == first.accuracy
    error = CliRunner().invoke(app, [*command, "--device", "tpu"]).exception
    assert isinstance(error, TrainingError)
    assert "use cpu, cuda or auto" in str(error)
