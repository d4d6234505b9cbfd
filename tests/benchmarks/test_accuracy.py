"""Accuracy chart: errors, fronts, the transfer job, and the command."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch
import typer
from benchmarks.accuracy import __main__ as command
from benchmarks.accuracy.measure import (
    Job,
    Point,
    Prepared,
    Setting,
    measure,
    pareto_front,
    relative_error,
)
from benchmarks.accuracy.transfer_job import TransferJob
from torch import Tensor
from typer.testing import CliRunner


@pytest.fixture(scope="module")
def transfer() -> tuple[Job, Tensor]:
    """The quick job of transfers with its truth, which takes longer than all that is held to it."""
    job = TransferJob(quick=True).job()
    return job, job.reference()


def point(seconds: float, error: float, method: str = "a") -> Point:
    return Point(
        method=method,
        dials={"dtype": "float32"},
        source="veilcam",
        supported=True,
        error=error,
        seconds=seconds,
        fastest_seconds=seconds,
        prepare_seconds=1.0,
        runs=3,
    )


def setting(value: Tensor, **more: object) -> Setting:
    return Setting("a", {"n": 1}, lambda: Prepared(lambda: value), **more)  # type: ignore[arg-type]


def test_relative_error_with_a_free_factor_forgives_scale_and_phase_alone() -> None:
    truth = torch.tensor([1.0 + 1j, 2.0, -1j], dtype=torch.complex128)
    turned = truth * 3j
    assert relative_error(turned, truth, free_factor=True) < 1e-12
    assert relative_error(turned, truth) > 1
    turned[0] += 1
    assert relative_error(turned, truth, free_factor=True) > 0.05
    assert relative_error(torch.zeros(3), truth, free_factor=True) == pytest.approx(1)


def test_relative_error_that_does_not_exist_is_refused() -> None:
    with pytest.raises(ValueError, match="shape"):
        relative_error(torch.ones(2), torch.ones(3))
    with pytest.raises(ValueError, match="zero everywhere"):
        relative_error(torch.ones(2), torch.zeros(2))


def test_pareto_front_holds_what_nothing_beats() -> None:
    points = [point(1, 0.5), point(2, 0.5), point(2, 0.1), point(3, 0.2), point(4, 0.01)]
    assert [(p.seconds, p.error) for p in pareto_front(points)] == [(1, 0.5), (2, 0.1), (4, 0.01)]
    assert pareto_front([]) == []


@pytest.mark.slow
def test_transfer_job_ranks_its_methods(transfer: tuple[Job, Tensor]) -> None:
    """The operator beats every field by ten times in error; finer sampling helps the field."""
    job, truth = transfer
    chosen = {s.label: s for s in job.settings}
    labels = (
        "transfer operator (reach 3,1, step 1.55 um, dtype float32)",
        "factored field (oversampling 1, dtype float32)",
        "factored field (oversampling 2, dtype float32)",
        "angular spectrum (oversampling 1, padding reach, dtype float32)",
    )
    best, coarse, fine, grid = (
        measure(chosen[label], truth, least=1, budget=1e-9).error for label in labels
    )
    assert best < 1e-3
    assert coarse > 1.5 * fine > 10 * best
    assert 10 * best < grid < 5e-2


@pytest.mark.thorough
def test_algorithm_of_the_paper_is_one_of_the_methods(transfer: tuple[Job, Tensor]) -> None:
    """It skips pixels between its samples, and knows the PSF on the sensor alone."""
    job, truth = transfer
    errors = {
        s.dials["resampling"]: measure(s, truth, least=1, budget=1e-9).error
        for s in job.settings
        if s.method == "Algorithm 1" and s.dials["dtype"] == "float32"
    }
    assert 4 * errors["area"] < errors["bilinear"] < 0.5


@pytest.mark.thorough
def test_quick_run_writes_table_json_and_charts(tmp_path: Path) -> None:
    app, out = typer.Typer(), tmp_path / "results"
    app.command()(command.main)
    ran = CliRunner().invoke(app, ["--quick", "--job", "field", "--out", str(out)])
    assert ran.exit_code == 0, ran.output
    assert "Free field" in ran.stdout
    names = {file.name for file in out.iterdir()}
    assert names == {"accuracy.json", "accuracy.png", "accuracy-field.png"}
    points = json.loads((out / "accuracy.json").read_text())["jobs"]["field"]["points"]
    exact = [
        each["error"]
        for each in points
        if each["method"] == "angular spectrum"
        and each["dials"]["padding"] == "full"
        and each["dials"]["dtype"] == "float64"
    ]
    assert exact[0] > 5 * exact[1] > 10 * exact[2]
