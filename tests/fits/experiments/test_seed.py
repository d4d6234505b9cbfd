"""Without a seed nobody else knows the masks; with one, or with --work, they come again."""

from __future__ import annotations

import stat
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from veilcam_training.bundle import Bundle, read_bundle
from veilcam_training.cli import fit as fit_command
from veilcam_training.cli import main as cli
from veilcam_training.config.files import load_settings
from veilcam_training.config.settings import FitSettings
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.fit import settle_seed
from veilcam_training.trainer.callbacks import FitProgress

SMALL = ("--embedding", "3x4", "--epochs", "2", "--batch", "90")
COMMANDS = {"fit": ("fit", *SMALL), "keyring": ("keyring", *SMALL, "--pairs", "2")}


class InterruptionError(Exception):
    pass


class Broken(FitProgress):
    """Breaks a fit off after its first epoch."""

    def step(self, epoch: int, done: int, steps: int) -> None:
        if epoch == 1:
            raise InterruptionError


Make = Callable[..., Bundle]


@pytest.fixture
def make(monkeypatch: pytest.MonkeyPatch, digit_folder: Path, tmp_path: Path) -> Make:
    """The bundle that ``veilcam-train`` writes."""

    def run(*arguments: object, name: str = "run") -> Bundle:
        folder = arguments[0] == "fit"
        out = tmp_path / (name if folder else "a.veilcam")
        command = ("veilcam-train", *arguments, "--data", digit_folder, "--out", out)
        monkeypatch.setattr(sys, "argv", [str(word) for word in command])
        with pytest.raises(SystemExit) as caught:
            cli.main()
        assert not caught.value.code
        return read_bundle(out / "model.veilcam" if folder else out)

    return run


def seeds(bundle: Bundle) -> list[int]:
    pairs: Any = bundle.provenance["pairs"]
    return [pair["seed"] for pair in pairs]


def same(one: Bundle, other: Bundle) -> bool:
    return all(
        (a.levels == b.levels).all()
        and all(np.array_equal(a.weights[name], b.weights[name]) for name in a.weights)
        for a, b in zip(one.pairs, other.pairs, strict=True)
    )


@pytest.mark.slow
def test_runs_without_a_seed_differ_in_masks(
    capsys: pytest.CaptureFixture[str], make: Make
) -> None:
    one, other = make(*COMMANDS["keyring"]), make(*COMMANDS["keyring"])
    for ours, theirs in zip(one.pairs, other.pairs, strict=True):
        assert (ours.levels != theirs.levels).mean() > 0.5
    printed = "".join(capsys.readouterr())
    assert printed
    assert not any(str(seed) in printed for seed in (*seeds(one), *seeds(other)))
    # With the seed, whoever knows it has the same masks.
    assert same(one, make(*COMMANDS["keyring"], "--seed", seeds(one)[0]))


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_run_without_a_seed_is_taken_up_with_its_own(
    monkeypatch: pytest.MonkeyPatch, make: Make, tmp_path: Path, name: str
) -> None:
    folder = name == "fit"
    work = tmp_path / "run" / "work" if folder else tmp_path / "work"
    command = COMMANDS[name] if folder else (*COMMANDS[name], "--work", work)
    with monkeypatch.context() as patch:
        for module in (cli, fit_command):
            patch.setattr(module, "FitProgress", Broken)
        with pytest.raises(InterruptionError):
            make(*command)
    (checkpoint,) = work.glob("*.checkpoint")
    assert stat.S_IMODE((work / "seed").stat().st_mode) == 0o600
    kept = (work / "seed").read_bytes()
    # A checkpoint of another seed is refused.
    resumed = make(*command, *(("--resume",) if folder else ()))
    assert (work / "seed").read_bytes() == kept
    assert checkpoint.exists()
    assert same(resumed, make(*COMMANDS[name], "--seed", seeds(resumed)[0], name="other"))


def test_seed_that_was_given_is_kept(tmp_path: Path) -> None:
    config, work = tmp_path / "a.toml", tmp_path / "work"
    config.write_text("seed = 0")
    for settings in (
        load_settings(config, {}),
        load_settings(None, {"seed": 0}),
        FitSettings(seed=0),
    ):
        assert settle_seed(settings, work) is settings
    assert not work.exists()
    drawn = [settle_seed(load_settings(None, {}), None) for _ in range(3)]
    assert len({settings.seed for settings in drawn}) == 3
    assert all(0 <= settings.seed < 2**63 for settings in drawn)


def test_damaged_seed_is_refused(tmp_path: Path) -> None:
    # Another folder has another seed, which is kept.
    one, again, other = (settle_seed(FitSettings(), tmp_path / name).seed for name in "aab")
    assert one == again
    assert one != other
    path = tmp_path / "a" / "seed"
    whole = path.read_bytes()
    for damaged in (b"", whole[:-1], whole[:-1] + b"x", b"7"):
        path.write_bytes(damaged)
        with pytest.raises(TrainingError, match=r"seed cannot be read .* remove it to start again"):
            settle_seed(FitSettings(), path.parent)
