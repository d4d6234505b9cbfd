"""Settings that hold for every test."""

from __future__ import annotations

import functools
import importlib.util
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

# Two OpenMP pools fighting over two cores run 10 to 80 times slower: set before torch is imported.
os.environ["OMP_NUM_THREADS"] = os.environ.get("VEILCAM_TEST_THREADS", "1")

import typer.testing
from hypothesis import settings

THREADS = int(os.environ["OMP_NUM_THREADS"])
TORCH = importlib.util.find_spec("torch") is not None
"""Client and bridge need none: with another Python their tests run without it."""
if TORCH:
    import torch

    torch.set_num_threads(THREADS)
# A command is made of its functions once, not for each test that calls it.
typer.testing._get_command = functools.cache(typer.testing._get_command)  # type: ignore[attr-defined]
# The same cases in every run, as long as a machine takes for them; the long form draws new ones.
settings.register_profile("short", max_examples=10, deadline=None, derandomize=True)
settings.register_profile("long", max_examples=1000, deadline=None)

NUMERICAL = (
    "contracts",
    "unit/optics",
    "app/optics",
    *(
        f"unit/training/{room}"
        for room in ("attacks", "encoders", "export", "models", "trainer", "transforms")
    ),
    *(f"unit/training/bundle/test_{name}.py" for name in ("fresh", "network")),
    *(f"unit/training/data/test_{name}.py" for name in ("drawn", "measurements")),
    "app/training",
    *(f"fits/{room}" for room in ("encoders", "models", "trainer")),
    "fits/data/test_sources.py",
    *(f"fits/experiments/test_{name}.py" for name in ("fit", "fresh")),
    *(f"benchmarks/test_{name}_attack.py" for name in ("convex", "generator")),
    "unit/server/calibration",
    "app/server/calibration",
    "unit/server/devices/simulated",
)
"""Folders and files of tests that compute; single files elsewhere bear the mark themselves. What
parses, refuses, keeps files or talks HTTP is the same on every processor."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--long", action="store_true", help="tests marked long in their long form")


def pytest_configure(config: pytest.Config) -> None:
    """Choose how many cases are made up, before tests are decorated with it."""
    settings.load_profile("long" if config.getoption("--long") else "short")


def pytest_report_header() -> str:
    """What results depend on beside the source; `benchmarks.capabilities` reads it."""
    if not TORCH:
        return f"torch: none, threads: {THREADS}"
    return f"torch: {torch.backends.cpu.get_cpu_capability()}, threads: {THREADS}"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what ``make test-processors`` runs on several kinds of instructions."""
    folders = [Path(__file__).parent / folder for folder in NUMERICAL]
    for item in items:
        if any(item.path.is_relative_to(folder) for folder in folders):
            item.add_marker("numerical")


@pytest.fixture
def long_form(request: pytest.FixtureRequest) -> bool:
    return bool(request.config.getoption("--long"))


@pytest.fixture(autouse=True)
def global_state_of_torch() -> Iterator[None]:
    """What is drawn without a generator is the same in every run, whatever ran before.

    The number of threads is put back, which a command sets for its whole process.
    """
    if TORCH:
        torch.manual_seed(0)
    yield
    if TORCH:
        torch.set_num_threads(THREADS)
