"""Work-precision: what is measured, how points are compared, and the command that writes it."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest
import torch
from torch import Tensor
from typer.testing import CliRunner

from veilcam_optics.accuracy import (
    Job,
    Point,
    Prepared,
    Setting,
    measure,
    pareto_front,
    relative_error,
)
from veilcam_optics.accuracy.chart import draw
from veilcam_optics.accuracy.field_job import FieldJob
from veilcam_optics.accuracy.psf_job import PsfJob
from veilcam_optics.accuracy.report import Result, duration, table, write_json
from veilcam_optics.accuracy.transfer_job import PLAN, TOLERANCES, TransferJob
from veilcam_optics.cli import accuracy as command
from veilcam_optics.cli.main import app
from veilcam_optics.errors import OpticsError


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


def test_relative_error_is_the_l2_distance() -> None:
    truth = torch.tensor([3.0, 4.0])
    assert relative_error(truth + torch.tensor([0.0, 0.5]), truth) == pytest.approx(0.1)
    assert relative_error(truth * 2, truth) == pytest.approx(1)


def test_a_free_factor_forgives_scale_and_phase_and_nothing_else() -> None:
    truth = torch.tensor([1.0 + 1j, 2.0, -1j], dtype=torch.complex128)
    turned = truth * 3j
    assert relative_error(turned, truth, free_factor=True) < 1e-12
    assert relative_error(turned, truth) > 1
    turned[0] += 1
    assert relative_error(turned, truth, free_factor=True) > 0.05
    assert relative_error(torch.zeros(3), truth, free_factor=True) == pytest.approx(1)


def test_errors_that_do_not_exist_are_refused() -> None:
    with pytest.raises(ValueError, match="shape"):
        relative_error(torch.ones(2), torch.ones(3))
    with pytest.raises(ValueError, match="zero everywhere"):
        relative_error(torch.ones(2), torch.zeros(2))


def test_the_front_holds_what_nothing_beats() -> None:
    points = [point(1, 0.5), point(2, 0.5), point(2, 0.1), point(3, 0.2), point(4, 0.01)]
    assert [(p.seconds, p.error) for p in pareto_front(points)] == [(1, 0.5), (2, 0.1), (4, 0.01)]
    assert pareto_front([]) == []


def test_measure_times_the_run_and_compares_the_result() -> None:
    calls = []

    def run() -> None:
        calls.append(1)
        time.sleep(0.002)

    def prepare() -> Prepared:
        return Prepared(run, lambda: torch.tensor([1.1]))

    found = measure(Setting("m", {"d": 2}, prepare), torch.tensor([1.0]), least=4, budget=1e-9)
    assert found.error == pytest.approx(0.1)
    assert found.runs == 4
    assert len(calls) == 5, "one more to warm up"
    assert found.seconds >= found.fastest_seconds >= 0.002
    assert found.label == "m (d 2)"


def test_a_setting_with_a_truth_of_its_own() -> None:
    value = torch.tensor([2.0])
    own = setting(value, reference=lambda: torch.tensor([1.0]))
    assert measure(own, value, least=1, budget=1e-9).error == pytest.approx(1)
    assert measure(setting(value), value, least=1, budget=1e-9).error == 0


def test_measure_refuses_nonsense() -> None:
    with pytest.raises(OpticsError, match="least = 0"):
        measure(setting(torch.ones(1)), torch.ones(1), least=0)
    with pytest.raises(OpticsError, match="budget"):
        measure(setting(torch.ones(1)), torch.ones(1), budget=0)
    with pytest.raises(TypeError, match="not a tensor"):
        measure(Setting("m", {}, lambda: Prepared(lambda: 3)), torch.ones(1))


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


@pytest.mark.slow
def test_the_papers_algorithm_is_one_of_the_methods(transfer: tuple[Job, Tensor]) -> None:
    """It skips pixels between its samples, and knows the PSF on the sensor alone."""
    job, truth = transfer
    errors = {
        s.dials["resampling"]: measure(s, truth, least=1, budget=1e-9).error
        for s in job.settings
        if s.method == "Algorithm 1" and s.dials["dtype"] == "float32"
    }
    assert 4 * errors["area"] < errors["bilinear"] < 0.5


@pytest.mark.slow
def test_psf_job_methods_agree() -> None:
    psf = PsfJob(quick=True)
    job = psf.job()
    truth = job.reference()
    assert truth.shape == (3, 380, 507)
    chosen = {s.label: s for s in job.settings}
    errors = [
        measure(chosen[label], truth, least=1, budget=1e-9).error
        for label in (
            "transfer operator (reach 6,1, dtype float64)",
            "factored field (oversampling 4, dtype float32)",
            "angular spectrum (oversampling 1, padding reach, dtype float32)",
        )
    ]
    assert errors[0] < 1e-2 < errors[1] < 5e-2 < errors[2] < 0.2
    assert any("fresnel impulse" in method for method in job.skipped), "undersampled at 4 mm"


@pytest.mark.slow
def test_field_job_has_an_exact_truth() -> None:
    """The exact method converges to it; the paraxial one stops at its own error."""
    job = FieldJob(quick=True).job()
    truth = job.reference()
    chosen = {s.label: s for s in job.settings}
    exact = [
        measure(
            chosen[f"angular spectrum (oversampling {n}, padding full, dtype float64)"],
            truth,
            least=1,
            budget=1e-9,
        ).error
        for n in (1, 3, 5)
    ]
    paraxial = measure(chosen["factored field (dtype float64)"], truth, least=1, budget=1e-9).error
    assert exact[0] > 5 * exact[1] > 10 * exact[2]
    assert exact[2] < paraxial < 1e-2


def test_quick_has_fewer_settings() -> None:
    for job in (TransferJob, PsfJob, FieldJob):
        assert len(job(quick=True).job().settings) < len(job(quick=False).job().settings)


@pytest.mark.slow
def test_plans_join_the_job_and_keep_their_word(transfer: tuple[Job, Tensor]) -> None:
    job, truth = transfer
    plans = [setting for setting in job.settings if setting.method == PLAN]
    points = [measure(s, truth, least=1, budget=1e-9) for s in plans]
    assert [point.dials["tolerance"] for point in points] == [f"{t:.0e}" for t in TOLERANCES]
    for found, tolerance in zip(points[:3], TOLERANCES[:3], strict=True):
        assert found.error < 2 * tolerance


def test_durations_are_readable() -> None:
    assert [duration(s) for s in (2.5, 0.0123, 4.56e-5)] == ["2.5 s", "12.3 ms", "45.6 us"]


def test_reports(tmp_path: Path) -> None:
    points = [point(1e-3, 1e-2), point(2e-3, 1e-3, "b"), point(3e-3, 0.5, "c")]
    result = Result("transfer", "A job", points, {"x": "too large"})
    assert table(result).row_count == 3
    write_json(tmp_path / "a.json", [result], quick=True)
    written = json.loads((tmp_path / "a.json").read_text())
    assert written["jobs"]["transfer"]["points"][1]["error"] == 1e-3
    assert written["jobs"]["transfer"]["front"] == ["a (dtype float32)", "b (dtype float32)"]
    assert written["jobs"]["transfer"]["skipped"] == {"x": "too large"}
    assert written["threads"] == 1
    draw(tmp_path / "a.png", [result, result])
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_command_writes_table_json_and_charts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Small(FieldJob):
        def job(self):  # type: ignore[no-untyped-def]
            job = super().job()
            return type(job)(job.name, job.title, job.reference, job.settings[:2])

    monkeypatch.setattr(command, "FieldJob", Small)
    out = tmp_path / "results"
    ran = CliRunner().invoke(
        app, ["accuracy", "--quick", "--job", "field", "--out", str(out)], catch_exceptions=False
    )
    assert ran.exit_code == 0
    assert "Free field" in ran.stdout
    names = {file.name for file in out.iterdir()}
    assert names == {"accuracy.json", "accuracy.png", "accuracy-field.png"}
    assert len(json.loads((out / "accuracy.json").read_text())["jobs"]["field"]["points"]) == 2
