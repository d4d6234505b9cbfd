"""Fixtures of the training's unit tests, for tests that fit."""

from __future__ import annotations

import sys
from collections.abc import Callable

import pytest
from tests.unit.training.conftest import *  # noqa: F403

from veilcam_optics.simulation.check import Check
from veilcam_training.cli import main as cli
from veilcam_training.experiments import fit

Call = Callable[..., str]


@pytest.fixture(autouse=True)
def transfer_check(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the check of a transfer, of seconds for each mask: `test_fit.py` tests it alone."""
    found = Check(1e-4, 5e-5, 2e-4, 0.9, 16)
    monkeypatch.setattr(fit, "check", lambda *_, **__: found)


@pytest.fixture
def call(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Call:
    """Calls ``veilcam-train``, sees it end with ``code``, and returns what it says or complains."""

    def run(*arguments: object, code: int = 0) -> str:
        monkeypatch.setattr(sys, "argv", ["veilcam-train", *map(str, arguments)])
        monkeypatch.setenv("COLUMNS", "200")
        with pytest.raises(SystemExit) as caught:
            cli.main()
        printed = capsys.readouterr()
        assert int(caught.value.code or 0) == code, printed.err
        return printed.err if code else printed.out

    return run
