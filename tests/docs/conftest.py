"""Way of the pages' code to a camera in this process."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import pytest

from veilcam_client.http.options import Options
from veilcam_server.testing import FakeCamera

Lead: TypeAlias = Callable[[FakeCamera], None]


@pytest.fixture
def lead_to(monkeypatch: pytest.MonkeyPatch) -> Lead:
    monkeypatch.delenv("VEILCAM_URL", raising=False)

    def lead(fake: FakeCamera) -> None:
        def instead(name: str, make: Callable[[], Any]) -> None:
            def client(options: Options) -> Any:
                assert options.base == "http://127.0.0.1:8787"
                return make()

            monkeypatch.setattr(f"veilcam_client.http.{name}", client)

        instead("transport.own_client", fake.http_client)
        instead("async_transport.async_own_client", fake.async_http_client)

    return lead
