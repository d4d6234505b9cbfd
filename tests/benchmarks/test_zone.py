"""The measurement of how soon a changed time zone is seen."""

from __future__ import annotations

from pathlib import Path

import pytest
from benchmarks.people.zone import seen_after


@pytest.mark.thorough
def test_zone_that_changes_to_and_fro_is_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TZ", "UTC")
    assert len(seen_after(tmp_path, 2)) == 2
