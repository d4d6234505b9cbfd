"""Digits that come along, and the command that holds one up."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from veilcam_server.cli.main import app
from veilcam_server.demo_data import DIGITS, load_digits
from veilcam_server.errors import StartError

runner = CliRunner()


def test_show_holds_a_digit_up(tmp_path: Path) -> None:
    scene = tmp_path / "deep" / "scene.npy"
    result = runner.invoke(app, ["show", "--scene", str(scene), "--digit", "7"])
    assert result.exit_code == 0
    index = int(re.findall(r"held-out digit (\d+)", result.stdout)[0])
    digits = load_digits()
    assert digits.labels[index] == 7
    assert np.array_equal(np.load(scene), digits.images[index])
    runner.invoke(app, ["show", "--scene", str(scene), "--index", "3"])
    assert np.array_equal(np.load(scene), digits.images[3])
    result = runner.invoke(app, ["show", "--scene", str(scene), "--index", "5000"])
    assert result.exit_code == 1
    assert "there are 5000 digits" in result.stderr


def test_bad_digit_files_are_refused(tmp_path: Path) -> None:
    copy = tmp_path / "digits.npz"
    with pytest.raises(StartError, match="there is no digit file"):
        load_digits(copy)
    shutil.copy(DIGITS, copy)
    copy.write_bytes(copy.read_bytes()[:5000])
    with pytest.raises(StartError, match="truncated or damaged"):
        load_digits(copy)
    np.savez(copy, images=np.zeros((2, 28, 28)), labels=np.zeros(2, np.uint8))
    with pytest.raises(StartError, match="uint8"):
        load_digits(copy)


def test_sample_is_whole() -> None:
    digits = load_digits()
    assert digits.images.shape == (5000, 28, 28)
    counts = np.bincount(digits.labels, minlength=10)
    assert np.min(counts) > 400
    assert counts.sum() == 5000
