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

collect_ignore = [] if importlib.util.find_spec("torch") else ["optics", "training", "server"]
"""Folders whose tests compute with torch."""

REFUSED = (
    (subprocess.Popen, "__init__"),
    (multiprocessing.process.BaseProcess, "start"),
    (os, "fork"),
)
"""Calls that start a process."""
LOADED = (
    ("veilcam_server.daemon", "build_service"),
    ("veilcam_training.experiments.fit", "fit"),
)
"""Functions that start a daemon or a fit, where their module is loaded at all."""
FAKE = "veilcam_server.testing.fake_camera"
"""Module of the camera for tests, which is a whole daemon."""


def refuse(name: str) -> Callable[..., NoReturn]:
    """Return a function that refuses to be called."""

    def refused(*_: object, **__: object) -> NoReturn:
        pytest.fail(f"a unit test called {name}: put it under tests/app or tests/fits")

    return refused


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    for owner, name in REFUSED:
        monkeypatch.setattr(owner, name, refuse(name))
    for module, name in LOADED:
        if module in sys.modules:
            refused, original = refuse(f"{module}.{name}"), getattr(sys.modules[module], name)
            # Also where a test or the camera for tests imported it by its name.
            for each in (sys.modules[module], request.module, sys.modules.get(FAKE)):
                if getattr(each, name, None) is original:
                    monkeypatch.setattr(each, name, refused)
