"""What several tests of the API send."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from veilcam_client.wire.tokens import Scope
from veilcam_server.security.tokens import TokenStore
from veilcam_training.bundle import Bundle, write_bundle


@pytest.fixture
def upload(bundle: Bundle, tmp_path: Path) -> bytes:
    """A bundle that the camera can use, and has not got yet."""
    path = tmp_path / "other.veilcam"
    write_bundle(path, dataclasses.replace(bundle, task="other"))
    return path.read_bytes()


@pytest.fixture
def store(tmp_path: Path) -> TokenStore:
    return TokenStore(tmp_path / "tokens")


def bearer(store: TokenStore, *scopes: Scope) -> dict[str, str]:
    return {"Authorization": f"Bearer {store.create('one', scopes, None).secret}"}
