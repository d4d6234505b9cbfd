"""What is repeated is done once: for everybody, for a minute, and after a restart."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from veilcam_server.errors import (
    ProblemError,
)
from veilcam_server.security import idempotency
from veilcam_server.security.admission import Admission, open_admission
from veilcam_server.security.idempotency import IdempotencyKeys
from veilcam_server.security.key_record import LIFETIME, KeyRecord
from veilcam_server.settings import Settings

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench, Running

pytestmark = pytest.mark.anyio

REQUEST, OTHER = b"r" * 32, b"o" * 32


class Desk:
    """Keys, a clock, and work that is counted."""

    def __init__(self, record: KeyRecord | None = None) -> None:
        self.clock = 0.0
        self.keys = IdempotencyKeys(record, now=lambda: self.clock)
        self.done = 0

    async def work(self) -> int:
        await asyncio.sleep(0)
        self.done += 1
        return self.done

    async def ask(self, key: str, caller: str = "a", request: bytes = REQUEST) -> int:
        return await self.keys.once(caller, key, request, self.work)


async def test_key_holds_for_a_minute_and_not_for_ever() -> None:
    desk = Desk()
    assert await desk.ask("k") == 1
    desk.clock = LIFETIME - 1
    assert await desk.ask("k") == 1
    with pytest.raises(ProblemError):
        await desk.ask("k", request=OTHER)
    desk.clock = LIFETIME + 1
    assert await desk.ask("k") == 2


async def test_repeated_key_after_many_others() -> None:
    desk = Desk()
    first = await desk.ask("k")
    for number in range(idempotency.KEPT - 1):
        await desk.ask(f"{number}")
    assert await desk.ask("k") == first
    await desk.ask("one more")
    for _ in range(2):
        with pytest.raises(ProblemError):
            await desk.ask("k")
    assert desk.done == idempotency.KEPT + 1


async def test_one_caller_pushes_out_no_other_s(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(idempotency, "CAPACITY", 4)
    monkeypatch.setattr(idempotency, "KEPT", 2)
    desk = Desk()
    first = await desk.ask("k", caller="b")
    desk.clock = 10.0
    for number in range(4):
        await desk.ask(f"{number}")
    with pytest.raises(ProblemError) as caught:
        await desk.ask("4")
    assert caught.value.retry_after == LIFETIME
    assert await desk.ask("3") == 5
    assert await desk.ask("k", caller="b") == first
    assert desk.done == 5
    desk.clock = 10.0 + LIFETIME + 1
    await desk.ask("4")


async def test_key_under_way_is_not_forgotten() -> None:
    desk = Desk()
    go_on = asyncio.Event()

    async def slow() -> int:
        await go_on.wait()
        return await desk.work()

    first = asyncio.create_task(desk.keys.once("a", "k", REQUEST, slow))
    await asyncio.sleep(0)
    desk.clock = 10 * LIFETIME
    again = asyncio.create_task(desk.keys.once("a", "k", REQUEST, slow))
    await asyncio.sleep(0)
    go_on.set()
    assert await first == await again == 1


async def test_request_done_before_a_restart_is_not_done_again(tmp_path: Path) -> None:
    before = Desk(KeyRecord(tmp_path))
    await before.ask("k")
    after = Desk(KeyRecord(tmp_path))
    with pytest.raises(ProblemError):
        await after.ask("k")
    with pytest.raises(ProblemError):
        await after.ask("k", request=OTHER)
    assert await after.ask("k", caller="b") == 1
    assert await after.ask("l") == 2
    after.clock = LIFETIME + 1
    assert await after.ask("k") == 3


async def test_record_is_on_the_disk_before_anybody_hears_of_it(tmp_path: Path) -> None:
    desk = Desk(KeyRecord(tmp_path))

    async def fail() -> int:
        raise OSError("not done")

    with pytest.raises(OSError, match="not done"):
        await desk.keys.once("a", "failed", REQUEST, fail)
    assert KeyRecord(tmp_path).read() == {}
    assert await desk.ask("failed") == 1
    await desk.ask("k")
    assert set(KeyRecord(tmp_path).read().values()) == {REQUEST}
    content = b"".join(path.read_bytes() for path in tmp_path.iterdir())
    assert b"k" not in content


async def test_full_disk_stops_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    desk = Desk(KeyRecord(tmp_path))
    monkeypatch.setattr(KeyRecord, "add", full)
    assert [await desk.ask(key) for key in ("k", "l", "k")] == [1, 2, 1]
    assert capsys.readouterr().out.count("will not survive a restart") == 1


async def test_restart_of_the_daemon(running: Running, bench: Bench, tmp_path: Path) -> None:
    settings = Settings(bundle=tmp_path / "a.veilcam", state_dir=bench.state_dir, auth="none")
    headers = {"Idempotency-Key": "k"}
    with open_admission(settings) as admission:
        async with running(admission=admission) as client:
            assert (await client.post("/v1/captures", headers=headers)).is_success
    with open_admission(settings) as admission:
        keys = admission.keys
    async with running(admission=Admission(keys=keys)) as client:
        refused = await client.post("/v1/captures", headers=headers)
        assert (refused.status_code, refused.json()["code"]) == (409, "answer_lost")
        assert not refused.json()["retryable"]
    assert bench.sensor.captures == 1
