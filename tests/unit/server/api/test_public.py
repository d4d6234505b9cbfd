"""What everybody may ask: whether the daemon is well and ready."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest
from tests.unit.server.logs import events, open_log

from veilcam_server.api.routes.public import PATHS
from veilcam_server.devices import DisplayError
from veilcam_server.security.admission import Admission
from veilcam_server.security.limits import ConcurrencyLimit, RateLimit
from veilcam_server.security.tokens import TokenStore

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import httpx
    from tests.unit.server.conftest import Bench, Running

pytestmark = pytest.mark.anyio


@pytest.fixture
def admission(tmp_path: Path) -> Iterator[Admission]:
    """Wants tokens, and lets each caller ask nothing at all."""
    store = TokenStore(tmp_path / "tokens")
    log = open_log(tmp_path)
    yield Admission(
        store,
        log=log,
        rate=RateLimit(1e-9, 1),
        concurrency=ConcurrencyLimit(0),
    )
    log.close()


async def words(client: httpx.AsyncClient) -> list[tuple[int, str]]:
    answers = [await client.get(path) for path in ("/healthz", "/readyz")]
    return [(answer.status_code, answer.text) for answer in answers]


YES, NO = (200, "yes"), (503, "no")


async def test_health_is_told_as_yes_or_no_and_nothing_else(
    running: Running, admission: Admission, tmp_path: Path
) -> None:
    assert admission.tokens is not None
    async with running(admission=admission) as client:
        # A monitor has no token, and takes nothing from who has one, however often it asks.
        for headers in ({}, {"Authorization": "Bearer nonsense"}):
            client.headers.update(headers)
            for _ in range(20):
                assert await words(client) == [YES, YES]
        answer = await client.get("/healthz")
        assert answer.headers["content-type"] == "text/plain; charset=utf-8"
        assert (await client.get("/v1/status")).status_code == 401
        for path in PATHS:
            for method in ("POST", "PUT", "DELETE", "OPTIONS"):
                assert (await client.request(method, path)).status_code in (401, 429)
            assert (await client.get(path, headers={"Host": "page.example"})).status_code == 421
            assert (await client.get(path, headers={"Origin": "http://a.b"})).status_code == 403
        assert (await client.get("/healthz/")).status_code in (401, 429)
    assert events(tmp_path, "request") == []


async def test_no_while_no_capture_is_taken(
    running: Running, bench: Bench, tmp_path: Path, display_fault: DisplayError
) -> None:
    log = open_log(tmp_path)
    async with running(admission=Admission(log=log)) as client:
        assert await words(client) == [YES, YES]
        bench.display.faults = [display_fault, display_fault]
        await client.post("/v1/rotation/advance")
        assert (await client.get("/v1/status")).json()["state"] == "safe"
        assert await words(client) == [YES, NO]
        await client.post("/v1/rotation/advance")
        assert await words(client) == [YES, YES]
    log.close()
    # To be told 'no' is to be answered: the log is not filled by it.
    assert events(tmp_path, "refused") == []


async def test_no_while_the_device_does_not_answer(
    running: Running, bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    from veilcam_server.camera.camera import MaskedCamera

    async with running() as client:
        monkeypatch.setattr(MaskedCamera, "healthy", lambda _: False)
        assert await words(client) == [NO, YES]
