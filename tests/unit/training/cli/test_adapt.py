"""``veilcam-train adapt`` and ``export`` from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Window
from veilcam_training.bundle import Bundle, Pair, read_bundle, write_bundle
from veilcam_training.bundle.layers import Linear
from veilcam_training.cli.main import app
from veilcam_training.errors import TrainingError

runner = CliRunner()
LABELS = ("left", "right")


@pytest.fixture
def bundle(tmp_path: Path) -> Path:
    """Takes the brighter half for the label."""
    weights = np.zeros((2, 20), np.float32)
    weights[0, :10] = weights[1, 10:] = 0.05
    camera = Camera(window=Window(rows=9, columns=5))
    levels = np.random.default_rng(2).integers(0, 64, camera.mask_shape).astype(np.uint8)
    pair = Pair(levels, (Linear(inputs=20, outputs=2, bias=False),), {"0.weight": weights})
    path = tmp_path / "sides.veilcam"
    write_bundle(
        path,
        Bundle(
            task="sides",
            labels=LABELS,
            camera=camera,
            scene=Scene(),
            embedding=Embedding(4, 5),
            mode="pairs",
            pairs=(pair,),
        ),
    )
    return path


@pytest.fixture
def measurements(bundle: Path, tmp_path: Path) -> Path:
    """Of a camera that turns left and right around."""
    header = {
        "format": "veilcam-measurements",
        "version": 1,
        "device": "d7" * 32,
        "bundle": read_bundle(bundle).digest,
        "mode": "pairs",
        "labels": LABELS,
        "shape": [4, 5],
    }
    chance, lines = np.random.default_rng(3), [header]
    for number in range(24):
        values = chance.normal(size=20)
        values[10 * (1 - number % 2) :][:10] += 1
        lines.append({"label": LABELS[number % 2], "epoch": "e", "values": values.tolist()})
    path = tmp_path / "measurements.jsonl"
    path.write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    return path


def test_bundle_is_adapted_under_another_name(
    bundle: Path, measurements: Path, tmp_path: Path
) -> None:
    out, again = tmp_path / "adapted.veilcam", tmp_path / "again.veilcam"
    command = ["adapt", str(bundle), str(measurements), "--out"]
    result = runner.invoke(app, [*command, str(out)])
    assert result.exit_code == 0, result.output
    assert "classifier 0: weights fitted: last, held 0.1" in result.output
    assert "not signed" in result.output
    adapted = read_bundle(out)
    assert adapted.accuracy is not None
    assert f"{100 * adapted.accuracy.value:.1f} % are by classifiers" in result.output
    assert adapted.accuracy.value > 0.5
    assert runner.invoke(app, [*command, str(again)]).exit_code == 0
    assert again.read_bytes() == out.read_bytes()
    assert runner.invoke(app, [*command, str(again), "--seed", "5"]).exit_code == 0
    assert again.read_bytes() != out.read_bytes()


@pytest.mark.parametrize(
    ("out", "why"), [("sides.veilcam", "is the bundle itself"), ("a.txt", "ends in .veilcam")]
)
def test_bundle_itself_stays_as_it_is(bundle: Path, measurements: Path, out: str, why: str) -> None:
    before = bundle.read_bytes()
    command = ["adapt", str(bundle), str(measurements), "--out", str(bundle.parent / out)]
    result = runner.invoke(app, command)
    assert isinstance(result.exception, TrainingError)
    assert why in str(result.exception)
    assert bundle.read_bytes() == before


def test_bundle_is_exported(bundle: Path, tmp_path: Path) -> None:
    pytest.importorskip("onnx")
    result = runner.invoke(app, ["export", str(bundle), "--out", str(tmp_path / "out")])
    assert result.exit_code == 0, result.output
    for name in ("classifier-0.onnx", "classifier-0.safetensors", "model-card.md"):
        assert (tmp_path / "out" / name).exists()
        assert name in result.output
