"""The demonstration, end to end on a tiny bundle."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from veilcam_server.cli.main import app
from veilcam_server.demo.daemon import running
from veilcam_server.errors import StartError

runner = CliRunner()


@pytest.mark.thorough
def test_demo_runs(bundle_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    given = ["--bundle", str(bundle_file), "--captures", "12", "--every", "2", "--out", str(out)]
    result = runner.invoke(app, ["demo", "--wrong-classifier", *given])
    assert result.exit_code == 0, result.output
    last = result.stdout.splitlines()[-1]
    found = re.fullmatch(r"accuracy=(\d\.\d{3}) captures=12 masks=([123])", last)
    assert found
    assert "experiment wrong-classifier" in result.stdout
    assert "receiver " in result.stdout
    assert (out / "report.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.thorough
def test_demo_runs_with_fresh_masks(fresh_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    given = ["--bundle", str(fresh_file), "--captures", "6", "--out", str(out)]
    result = runner.invoke(app, ["demo", "--fresh", *given])
    assert result.exit_code == 0, result.output
    # One mask a capture, none of them twice.
    assert result.stdout.splitlines()[-1].endswith("captures=6 masks=6")
    assert "fresh masks, a new one every 1 captures" in result.stdout
    assert (out / "report.png").read_bytes().startswith(b"\x89PNG")


def test_fresh_demo_refuses_pairs(bundle_file: Path) -> None:
    result = runner.invoke(app, ["demo", "--fresh", "--bundle", str(bundle_file)])
    assert result.exit_code == 1
    assert "holds pairs: give a bundle of mode 'fresh'" in result.stderr


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--bundle", "nothing.veilcam"], "nothing.veilcam: there is no such file"),
        (["--digits", "nothing.npz"], "there is no digit file nothing.npz"),
        (["--captures", "5001"], "holds 5000 digits"),
    ],
)
def test_missing_input_is_named(bundle_file: Path, options: list[str], message: str) -> None:
    result = runner.invoke(app, ["demo", "--bundle", str(bundle_file), *options])
    assert result.exit_code == 1
    assert message in result.stderr
    assert result.stderr.count("\n") == 1


@pytest.mark.thorough
def test_daemon_that_does_not_start_tells_why(tmp_path: Path, bundle_file: Path) -> None:
    with (
        pytest.raises(StartError, match="there is no scene file"),
        running(bundle_file, tmp_path / "nothing.npy", tmp_path),
    ):
        pytest.fail("it must not start")
