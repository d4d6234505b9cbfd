"""A finished cell says where its numbers come from, and so does its bundle."""

from __future__ import annotations

import hashlib
import platform
import sys
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

import pytest
import torch

from veilcam_training.bundle import read_bundle
from veilcam_training.cli import main as cli
from veilcam_training.experiments.records import commit
from veilcam_training.experiments.results import BUNDLE, cell_folder, load_results


def test_a_cell_and_its_bundle_say_where_they_come_from(
    monkeypatch: pytest.MonkeyPatch, digit_folder: Path, tmp_path: Path
) -> None:
    options = f"--data {digit_folder} --work {tmp_path} --epochs 1 --seed 3"
    part = "--encoders learned --binnings area --classifiers LR --embeddings 3x4"
    command = f"veilcam-train table mnist {options} {part}"
    monkeypatch.setattr(sys, "argv", command.split())
    before = datetime.now(UTC).replace(microsecond=0)
    with pytest.raises(SystemExit):
        cli.main()
    after = datetime.now(UTC)

    result = next(load_results(tmp_path))
    bundle = read_bundle(cell_folder(tmp_path, result.cell) / BUNDLE)
    settings = result.settings.model_dump(mode="json")
    assert result.provenance["settings"] == settings
    assert settings["seed"] == 3
    assert bundle.provenance["settings"] == {k: v for k, v in settings.items() if k != "seed"}
    assert bundle.provenance["pairs"] == [
        {
            "seed": 3,
            "test_accuracy": result.test_accuracy,
            "validation_accuracy": result.validation_accuracy,
            "epoch": result.best_epoch + 1,
        }
    ]
    for record in (result.provenance, bundle.provenance):
        assert record["data_sha256"] == {
            path.name: hashlib.sha256(path.read_bytes()).hexdigest()
            for path in digit_folder.iterdir()
        }
        assert record["versions"] == {
            "veilcam": version("veilcam"),
            "torch": torch.__version__,
            "python": platform.python_version(),
        }
        assert record["commit"] == commit()
        assert before <= datetime.fromisoformat(str(record["date"])) <= after
        assert record["command"] == command
