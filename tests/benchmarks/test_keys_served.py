"""Proofs against a real daemon, made short: what is planted, what stays, and what it costs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from benchmarks.privacy.keys import served
from benchmarks.privacy.keys.costs import preparation_times, read_sealed, sealing_times
from benchmarks.privacy.keys.past import Findings, past_of
from tests.benchmarks.conftest import figures_of
from tests.unit.server.conftest import make_fresh_bundle

from veilcam_server.demo_data import load_digits
from veilcam_training.bundle import write_bundle
from veilcam_training.data import Images


@pytest.fixture
def bundle_file(tmp_path: Path) -> Path:
    path = tmp_path / "fresh.veilcam"
    write_bundle(path, make_fresh_bundle())
    return path


@pytest.mark.thorough
@pytest.mark.parametrize("form", ["sealed", "white"])
def test_planted_scenes_become_figures(bundle_file: Path, tmp_path: Path, form: str) -> None:
    figures, work = tmp_path / "figures.json", tmp_path / "work"
    served.answers(work, form, count=20, bundle=bundle_file, epochs=1, figures=figures)
    found = figures_of(figures)
    end = {"sealed": "", "white": "_white"}[form]
    assert found[f"clear_part_differences{end}"] == 0
    # 20 against 20: a standard error of .09.
    assert abs(found[f"clear_part_auc{end}"] - 0.5) < 0.35
    assert ("rest_white_presence_auc" in found) == (form == "white")
    (record,) = work.iterdir()
    assert len(record.read_text().splitlines()) == 40


@pytest.mark.thorough
def test_planted_digits_become_figures(bundle_file: Path, tmp_path: Path) -> None:
    figures, work = tmp_path / "figures.json", tmp_path / "work"
    served.digits(work, count=24, bundle=bundle_file, epochs=1, figures=figures)
    assert "rest_white_digit_advantage_upper" in figures_of(figures)


@pytest.mark.slow
def test_past_of_a_daemon_that_is_taken_is_closed(bundle_file: Path, tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    # It raises where not even the epoch that goes on is found.
    served.past(captures=6, step=16, bundle=bundle_file, figures=figures)
    found = figures_of(figures)
    assert found["past_opened"] == 0
    assert found["past_levels_found"] == found["past_rotation_found"] == 0


def test_past_is_no_proof_if_the_epoch_that_goes_on_is_missed() -> None:
    nothing: set[int] = set()
    found = {"key": nothing, "sealing": {2}, "mask": {1, 2}}
    past = past_of(Findings({0, 2}, found), 2)
    assert past == Findings({0}, {"key": nothing, "sealing": nothing, "mask": {1}})
    for opened, sealing in (({0}, {2}), ({2}, nothing)):
        with pytest.raises(RuntimeError, match="proves nothing"):
            past_of(Findings(opened, {"sealing": sealing}), 2)


@pytest.mark.slow
def test_times_are_of_what_they_say(tmp_path: Path) -> None:
    bundle = make_fresh_bundle()
    sealing = sealing_times(bundle, np.ones(bundle.embedding.shape, np.float32), 2)
    assert sealing.keys() == {"envelope", "seal", "open", "open_first"}
    assert all(took > 0 for took in sealing.values())
    preparing = preparation_times(bundle, tmp_path, 2)
    assert preparing.keys() == {"mask", "none", "sealed", "white"}


@pytest.mark.slow
def test_holder_of_a_receivers_key_reads_what_the_daemon_reads() -> None:
    digits = load_digits()
    images = Images(
        torch.from_numpy(digits.images[:12]), torch.from_numpy(digits.labels[:12]).long()
    )
    found = list(read_sealed(make_fresh_bundle(), images, seed=1))
    assert [each.holder for each in found] == [each.daemon for each in found]
    assert [each.truth for each in found] == [str(label) for label in digits.labels[:12]]
