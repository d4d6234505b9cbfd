"""Settings that hold for every test."""

from __future__ import annotations

import os

# Two OpenMP pools fighting over two cores run 10 to 80 times slower: set before torch is imported.
os.environ["OMP_NUM_THREADS"] = "1"

import pytest
import torch
from hypothesis import settings

torch.set_num_threads(1)
settings.register_profile("short", max_examples=10)
settings.register_profile("long", max_examples=1000)


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let tests be asked for their long form."""
    parser.addoption("--long", action="store_true", help="tests marked long in their long form")


def pytest_configure(config: pytest.Config) -> None:
    """Choose how many cases are made up, before tests are decorated with it."""
    settings.load_profile("long" if config.getoption("--long") else "short")


@pytest.fixture
def long_form(request: pytest.FixtureRequest) -> bool:
    """Whether a test marked long was asked for its long form."""
    return bool(request.config.getoption("--long"))
