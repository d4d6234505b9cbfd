"""A bundle says where it comes from."""

from __future__ import annotations

import hashlib
import platform
import sys
from datetime import UTC, datetime
from importlib.machinery import ModuleSpec
from importlib.metadata import version
from pathlib import Path

import pytest
import torch
from tests.fits.conftest import Call

from veilcam_training.bundle import read_bundle
from veilcam_training.experiments.records import commit, own_command


def test_bundle_says_where_it_comes_from(call: Call, digit_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "run"
    options = f"--data {digit_folder} --out {out} --epochs 1 --seed 3 --embedding 3x4"
    before = datetime.now(UTC).replace(microsecond=0)
    call("fit", *options.split())
    after = datetime.now(UTC)
    record = read_bundle(out / "model.veilcam").provenance
    settings = record["settings"]
    assert isinstance(settings, dict)
    assert settings["embedding"] == "3x4"
    assert "seed" not in settings  # each pair has its own
    pairs = record["pairs"]
    assert isinstance(pairs, list)
    (pair,) = pairs
    assert isinstance(pair, dict)
    assert pair.keys() == {"seed", "test_accuracy", "validation_accuracy", "epoch"}
    assert (pair["seed"], pair["epoch"]) == (3, 1)
    assert record["data_sha256"] == {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in digit_folder.iterdir()
    }
    assert record["versions"] == {
        "veilcam": version("veilcam"),
        "torch": torch.__version__,
        "python": platform.python_version(),
    }
    assert record["commit"] == commit()
    assert before <= datetime.fromisoformat(str(record["date"])) <= after
    assert record["command"] == f"veilcam-train fit {options}"


def test_own_command_is_as_one_types_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    main = sys.modules["__main__"]
    monkeypatch.setattr(main, "__spec__", None)
    monkeypatch.setattr(sys, "argv", ["/long/way/veilcam-train", "fit", "--data", "d"])
    assert own_command() == ["veilcam-train", "fit", "--data", "d"]
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [str(tmp_path / "benchmarks" / "a.py"), "-x"])
    assert own_command() == ["python", "benchmarks/a.py", "-x"]
    # A worker has the module's file, and no spec.
    monkeypatch.setattr(sys, "argv", [str(tmp_path / "benchmarks" / "a" / "__main__.py"), "-x"])
    assert own_command() == ["python", "-m", "benchmarks.a", "-x"]
    for module in ("benchmarks.a", "benchmarks.a.__main__"):
        monkeypatch.setattr(main, "__spec__", ModuleSpec(module, None))
        assert own_command() == ["python", "-m", "benchmarks.a", "-x"]
