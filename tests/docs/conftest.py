"""Way of the pages' code to a simulated camera."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import pytest

from veilcam_server.testing import FakeCamera

Lead: TypeAlias = Callable[[FakeCamera], None]


@pytest.fixture
def lead_to(monkeypatch: pytest.MonkeyPatch) -> Lead:
    return lambda fake: monkeypatch.setenv("VEILCAM_URL", fake.url)
