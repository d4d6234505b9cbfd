"""A clock that is set forward or back by a year, while the daemon runs and between two lives."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

import pytest
from tests.unit.server.service.waiting import until

from veilcam_client.wire.rotation import EverySeconds

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench, Running

pytestmark = pytest.mark.anyio

YEAR = timedelta(days=365)


class WallClock(datetime):
    """The clock on the wall, which somebody sets."""

    offset = timedelta()

    @classmethod
    def now(cls, tz: Any = None) -> datetime:  # type: ignore[override]
        """As it is set."""
        return datetime.now(tz) + cls.offset


@pytest.fixture
def wall(monkeypatch: pytest.MonkeyPatch) -> type[WallClock]:
    monkeypatch.setattr(WallClock, "offset", timedelta())
    for module in ("service.events", "service.service", "camera.shutter", "security.log"):
        monkeypatch.setattr(f"veilcam_server.{module}.datetime", WallClock)
    return WallClock


@pytest.mark.parametrize("jump", [YEAR, -YEAR])
async def test_everything_goes_on_whatever_the_clock_says(
    bench: Bench, running: Running, wall: type[WallClock], jump: timedelta
) -> None:
    key = {"Idempotency-Key": "once"}
    async with running(policy=EverySeconds(seconds=0.1)) as client:
        service = client._transport.app.state.service  # type: ignore[attr-defined]
        stream = service.events("")  # all of them
        first = (await client.post("/v1/captures", headers=key)).json()
        lease = (await client.post("/v1/lease", json={"owner": "a", "seconds": 600})).json()
        held = {"Veilcam-Lease": lease["secret"]}
        wall.offset = jump

        # Answers, leases and masks are kept by a clock that nobody sets.
        again = (await client.post("/v1/captures", headers={**key, **held})).json()
        assert again["id"] == first["id"]
        left = (await client.get("/v1/lease")).json()
        assert left["held"]
        assert 500 < left["expires_in_s"] <= 600
        shown = len(bench.epochs)
        await until(lambda: len(bench.epochs) >= shown + 3)
        assert len(set(bench.epochs)) == len(bench.epochs)
        taken = (await client.post("/v1/captures", headers=held)).json()
        away = datetime.fromisoformat(taken["taken_at"]) - datetime.now(UTC)
        assert abs(away - jump) < timedelta(hours=1)
        assert service.status().uptime_s < 3600

        # Events stay in their order, by their ids.
        numbers: list[int] = []
        while not numbers or numbers[-1] + 1 < service._events.log._next:
            event = await anext(stream)
            if event is not None and event.kind != "gap":
                numbers.append(int(event.id.partition("-")[2]))
        assert numbers == list(range(len(numbers)))
        wall.offset = timedelta()
        assert (await client.get("/v1/status")).json()["state"] == "ready"
