"""Capabilities of the processor: which are run, what torch says of them, and which are green."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import torch
import typer
from benchmarks import capabilities
from benchmarks.capabilities import HEADER, Run, run
from tests.benchmarks.conftest import figures_of
from tests.conftest import pytest_report_header
from typer.testing import CliRunner

BEST = torch.backends.cpu.get_cpu_capability()


def environment(folder: Path, script: str) -> str:
    (folder / "bin").mkdir()
    (folder / ".installed").touch()
    program = folder / "bin" / "pytest"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    return f"VENV={folder}"


@pytest.mark.parametrize(
    ("target", "level"), [("suite-SSE", "default"), ("suite-AVX2", "avx2"), ("pytest", "")]
)
def test_suite_runs_with_the_variables_of_the_makefile_and_its_header_names_the_capability(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    target: str,
    level: str,
) -> None:
    assert (found := HEADER.match(pytest_report_header()))
    assert found[1] == BEST
    monkeypatch.delenv("ATEN_CPU_CAPABILITY", raising=False)
    script = 'echo "torch: ${ATEN_CPU_CAPABILITY:-BEST}, threads: 1"; echo "asked: $*"'
    done = run(target, environment(tmp_path, script))
    assert done == Run(target, level or "BEST", passed=True)
    assert re.search(
        r"asked: -n \d --dist worksteal -m (not thorough and )?not system and not page\n",
        capfd.readouterr().out,
    )


def test_suite_that_fails_or_does_not_begin_is_not_green(tmp_path: Path) -> None:
    variable = environment(tmp_path, 'echo "torch: AVX2, threads: 1"; exit 1')
    assert run("suite-AVX2", variable) == Run("suite-AVX2", "AVX2", passed=False)
    (tmp_path / "bin" / "pytest").write_text("#!/bin/sh\nexit 4\n")
    assert run("suite-AVX2", variable) == Run("suite-AVX2", None, passed=False)


@pytest.mark.parametrize(("failing", "count"), [(None, 2), ("suite-SSE", 1), ("test", 1)])
def test_count_of_green_capabilities_is_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: str | None, count: int
) -> None:
    monkeypatch.setattr(torch.backends.cpu, "get_cpu_capability", lambda: "AVX2")
    told = {"suite-SSE": "DEFAULT", "test": "AVX2"}
    costs = {"wall_s": 600.0, "user_cpu_s": 700.0}
    monkeypatch.setattr(
        capabilities, "run", lambda target: Run(target, told[target], target != failing, **costs)
    )
    app, record = typer.Typer(), tmp_path / "house.json"
    app.command()(capabilities.main)
    done = CliRunner().invoke(app, ["--figures", str(record)])
    assert done.exit_code == (failing is not None)
    assert "not shown here: AVX512" in done.output
    figures = figures_of(record)
    assert figures.pop("capabilities_green") == count
    # What fails has no cost.
    cost = {"make_test_wall_s": 600.0, "make_test_user_cpu_s": 700.0}
    assert figures == ({} if failing == "test" else cost)
