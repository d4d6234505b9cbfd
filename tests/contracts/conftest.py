"""Settings that hold for the stability suite."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch


@pytest.fixture(autouse=True)
def every_warning_every_time() -> Iterator[None]:
    """Torch gives some warnings once per process: only the first test could fail by them."""
    before = torch.is_warn_always_enabled()
    torch.set_warn_always(True)
    yield
    torch.set_warn_always(before)
