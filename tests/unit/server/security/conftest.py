"""What tests of callers and of durable files have in common."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from veilcam_client.wire.tokens import Scope
from veilcam_server.security.tokens import TokenStore


@pytest.fixture
def store(tmp_path: Path) -> TokenStore:
    return TokenStore(tmp_path / "state")


def bearer(store: TokenStore, *scopes: Scope) -> dict[str, str]:
    return {"Authorization": f"Bearer {store.create('test', scopes, None).secret}"}


@pytest.fixture
def flushed(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the files and folders that are flushed to the disk, in this order."""
    names: list[str] = []
    fsync = os.fsync

    def noted(descriptor: int) -> None:
        names.append(Path(os.readlink(f"/proc/self/fd/{descriptor}")).name)
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", noted)
    return names


class Clock:
    """Time that a test sets."""

    def __init__(self) -> None:
        self.now = 1e9

    def __call__(self) -> float:
        return self.now
