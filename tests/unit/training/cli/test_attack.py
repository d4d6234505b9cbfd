"""``veilcam-train attack report``: files, the bundle that carries the card, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from tests.unit.training.attacks.card.conftest import TINY, make_images, make_pairs
from typer.testing import CliRunner

from veilcam_training.bundle import PrivacyCard, read_bundle, sign_bundle, write_bundle
from veilcam_training.cli import attack
from veilcam_training.cli.main import app
from veilcam_training.data.sample import shipped_digits
from veilcam_training.errors import TrainingError


@pytest.fixture
def bundle(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "a.veilcam"
    write_bundle(path, make_pairs())
    monkeypatch.setattr(attack, "QUICK", replace(TINY, own=20, seen=20, epochs=1))
    monkeypatch.setattr(attack, "shipped_digits", make_images)
    return path


def run(*arguments: str | Path) -> str:
    with torch.random.fork_rng():
        result = CliRunner().invoke(app, ["attack", "report", *map(str, arguments)])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.slow
def test_card_is_written_and_travels(bundle: Path, tmp_path: Path) -> None:
    out = tmp_path / "card"
    said = run(bundle, "--quick", "--out", out, "--write", "--seed", "3")
    card = PrivacyCard.model_validate_json((out / "card.json").read_text())
    assert (card.mode, card.form, card.quick, card.seed) == ("pairs3", "raw", True, 3)
    assert "<title>Privacy card" in (out / "card.html").read_text()
    assert "NOT CLAIMED: pairs3, raw, quick" in said
    assert read_bundle(bundle).card == card
    # A second time nothing is attacked again: the card is of the same bundle, with its card.
    assert "T9" in run(bundle, "--quick", "--out", out, "--resume", "--seed", "3")
    again = json.loads((out / "card.json").read_text())
    assert again["rows"] == json.loads(card.model_dump_json())["rows"]


def test_options_that_do_not_go_together_are_refused(bundle: Path, tmp_path: Path) -> None:
    for options, reason in (
        (["--resume"], "give --out"),
        (["--write", "--mode", "random"], "leave out --mode"),
        (["--form", "flat"], "form 'flat' is not valid"),
    ):
        with pytest.raises(TrainingError, match=reason):
            run(bundle, "--quick", *options)
    sign_bundle(bundle, 1, Ed25519PrivateKey.from_private_bytes(bytes(range(32))))
    with pytest.raises(TrainingError, match="is signed"):
        run(bundle, "--quick", "--write")


def test_digits_come_along() -> None:
    images = shipped_digits()
    assert images.pixels.shape == (5000, 28, 28)
    assert torch.unique(images.labels).tolist() == list(range(10))
