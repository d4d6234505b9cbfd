"""The campaign of forgeries: none is taken, and each kind finds the door that it tries open."""

from __future__ import annotations

from typing import Any

import pytest
from benchmarks.privacy.forgeries import Campaign, forgeries

from veilcam_client.keys import blocks, envelopes


def test_forgeries_are_refused() -> None:
    assert forgeries(350, seed=2) == 0


def _open_door(monkeypatch: pytest.MonkeyPatch, door: str) -> None:
    def nothing(*_: Any) -> bytes:
        return b""

    if door == "associated data":
        monkeypatch.setattr(blocks, "_associated_data", nothing)
    elif door == "signature":
        monkeypatch.setattr(envelopes, "_message", nothing)
        monkeypatch.setattr(envelopes, "_info", nothing)
        monkeypatch.setattr(blocks, "_associated_data", nothing)
    else:
        monkeypatch.setattr(blocks.Opener, "_remember", nothing)


@pytest.mark.parametrize(
    ("door", "kind"),
    [
        ("associated data", "cross-form"),
        ("associated data", "transplanted"),
        ("associated data", "flipped"),
        ("signature", "truncated"),
        ("memory", "replayed"),
        ("memory", "reordered"),
        ("memory", "cross-device"),
    ],
)
def test_forgeries_find_a_door_left_open(
    monkeypatch: pytest.MonkeyPatch, door: str, kind: str
) -> None:
    _open_door(monkeypatch, door)
    campaign = Campaign(seed=3)
    assert any(campaign.taken(kind) for _ in range(300))
