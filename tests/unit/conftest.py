"""Guard of the unit tests: they start no process and no daemon, and fit nothing."""

from __future__ import annotations

import importlib.util
import multiprocessing.process
import os
import subprocess
import sys
from collections.abc import Callable
from typing import NoReturn

import pytest

COMPUTING = ["optics", "training", "server", "client/test_decoding.py"]
collect_ignore = [] if importlib.util.find_spec("torch") else COMPUTING
"""Tests that compute with torch."""

REFUSED = (
    (subprocess.Popen, "__init__"),
    (multiprocessing.process.BaseProcess, "start"),
    (os, "fork"),
)
"""Calls that start a process."""
LOADED = (
    ("veilcam_server.daemon", "build_service"),
    ("veilcam_training.trainer.loop", "fit"),
)
"""Functions that start a daemon or a fit, where their module is loaded at all."""


def refuse(name: str) -> Callable[..., NoReturn]:
    """Return a function that refuses to be called."""

    def refused(*_: object, **__: object) -> NoReturn:
        pytest.fail(f"a unit test called {name}: put it under tests/app or tests/fits")

    return refused


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    for owner, name in REFUSED:
        monkeypatch.setattr(owner, name, refuse(name))
    ours = [sys.modules[name] for name in sorted(sys.modules) if name.startswith("veilcam_")]
    for module, name in LOADED:
        if module in sys.modules:
            refused, original = refuse(f"{module}.{name}"), getattr(sys.modules[module], name)
            # Also where a test or another module imported it by its name.
            for each in (*ours, request.module):
                if vars(each).get(name) is original:
                    monkeypatch.setattr(each, name, refused)
