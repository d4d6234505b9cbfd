"""Fixtures of the training's unit tests, for tests that fit."""

from __future__ import annotations

import pytest
from tests.unit.training.conftest import *  # noqa: F403

from veilcam_optics.plan.check import Check
from veilcam_training.experiments import fit


@pytest.fixture(autouse=True)
def transfer_check(monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the check of a transfer, of seconds for each mask: `test_fit.py` tests it alone."""
    found = Check(1e-4, 5e-5, 2e-4, 0.9, 16)
    monkeypatch.setattr(fit, "check", lambda *_, **__: found)
