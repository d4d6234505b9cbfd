"""``veilcam-train fit --fresh`` and ``frame`` end to end, and what they say to bad input."""

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
embedding = "3x4"
tolerance = 1e-4
rank = 20
epochs = 2
fresh = {masks = 4, misalignment = {panels = 2}}
"""
"""What a fit spends its time on, made small: nothing that a command says depends on it."""


@pytest.mark.slow
def test_command_writes_a_bundle(digit_folder: Path, tmp_path: Path) -> None:
    run, small = tmp_path / "run", tmp_path / "small.toml"
    out = run / "model.veilcam"
    small.write_text(SMALL)
    command = ["fit", "--fresh", "--data", str(digit_folder), "--out", str(run)]
    chosen = ["--config", str(small), "--epochs", "1", "--seed", "2"]
    result = CliRunner().invoke(app, [*command, *chosen])
    assert result.exit_code == 0, result.output
    assert "on 100 unseen masks" in result.output
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
    config, logs = tmp_path / "a.toml", tmp_path / "logs"
    config.write_text(SMALL)
    run = tmp_path / "run"
    out, work = run / "model.veilcam", run / "work"
    command = ["fit", "--data", str(digit_folder), "--out", str(run)]
    command += ["--config", str(config), "--device", "cpu", "--batch", "80"]
    result = CliRunner().invoke(app, [*command, "--tensorboard", str(logs)])
    assert result.exit_code == 0, result.output
    made: Any = read_bundle(out).provenance["settings"]
    assert (made["rank"], made["classifier"], made["batch"]) == (20, "Scene2", 80)
    assert made["fresh"]["misalignment"]["panels"] == 2
    # Nobody else knows the seed, and it is taken up with the rest.
    kept = {path.name for path in work.iterdir()}
    assert kept == {"fit.checkpoint", "seed", "statistics.checkpoint"}
    curves = event_accumulator.EventAccumulator(str(logs))
    curves.Reload()
    assert [point.step for point in curves.Scalars("accuracy/validation")] == [1, 2]
    first = read_bundle(out)
    result = CliRunner().invoke(app, [*command, "--resume"])
    assert result.exit_code == 0, result.output
    again: Any = read_bundle(out).provenance["settings"]
    assert again["seed"] == made["seed"] != 0
    assert read_bundle(out).accuracy == first.accuracy
    error = CliRunner().invoke(app, [*command, "--resume", "--device", "tpu"]).exception
    assert isinstance(error, TrainingError)
    assert "use cpu, cuda or auto" in str(error)
