"""Requests that are repeated with their key, in one run of the daemon and in the next."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from veilcam_client.wire.base import EXAMPLE_TIME, RUN_HEADER, UNKNOWN_RUN
from veilcam_client.wire.captures import Classification, Embedding
from veilcam_server.errors import ProblemError
from veilcam_server.security import idempotency
from veilcam_server.security.idempotency import KEPT, LIFETIME, MEASUREMENTS, IdempotencyKeys

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench, Running

pytestmark = pytest.mark.anyio

REQUEST, OTHER = b"r" * 32, b"o" * 32


class Desk:
    """Keys, a clock, and work that is counted."""

    def __init__(self) -> None:
        self.clock = 0.0
        self.keys = IdempotencyKeys(now=lambda: self.clock)
        self.done = 0

    async def work(self) -> int:
        await asyncio.sleep(0)
        self.done += 1
        return self.done

    async def ask(self, key: str, caller: str = "a", request: bytes = REQUEST) -> int:
        return await self.keys.once(caller, key, request, self.work)

    async def refusal(self, key: str, request: bytes = REQUEST) -> str:
        with pytest.raises(ProblemError) as caught:
            await self.ask(key, request=request)
        return caught.value.code


async def test_key_holds_after_its_answer_is_forgotten() -> None:
    desk = Desk()
    assert await desk.ask("k") == 1
    desk.clock = LIFETIME - 1
    assert await desk.ask("k") == 1
    assert await desk.refusal("k", OTHER) == "idempotency_key_reused"
    desk.clock = 1000 * LIFETIME
    assert await desk.refusal("k") == "answer_lost"
    assert desk.done == 1


async def test_answer_is_kept_through_many_later_ones() -> None:
    desk = Desk()
    first = await desk.ask("k")
    for number in range(KEPT - 1):
        await desk.ask(f"{number}")
    assert await desk.ask("k") == first
    await desk.ask("one more")
    await desk.ask("and one")
    for _ in range(2):
        assert await desk.refusal("k") == "answer_lost"
    assert desk.done == KEPT + 2


async def test_answer_with_an_open_embedding_is_kept_through_few() -> None:
    keys, answers = IdempotencyKeys(), dict[str, Classification]()
    open_embedding = Embedding.from_array(np.ones((2, 3), np.float32))

    async def ask(key: str, embedding: Embedding | None = open_embedding) -> Classification:
        async def work() -> Classification:
            told: dict[str, Any] = {"epoch": "e", "number": 0, "taken_at": EXAMPLE_TIME}
            return Classification(id=key, label="7", embedding=embedding, **told)

        return await keys.once("a", key, REQUEST, work)

    for number in range(MEASUREMENTS + 1):
        answers[f"{number}"] = await ask(f"{number}")
        await ask(f"label {number}", None)
    with pytest.raises(ProblemError) as caught:
        await ask("0")
    assert caught.value.code == "answer_lost"
    for key in ("1", f"{MEASUREMENTS}"):
        assert await ask(key) is answers[key]
    assert (await ask("label 0", None)).label == "7"


async def test_keys_of_one_caller_push_out_no_other_s(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(idempotency, "CAPACITY", 4)
    desk = Desk()
    first = await desk.ask("k", caller="b")
    for number in range(5):
        await desk.ask(f"{number}")
    assert await desk.ask("k", caller="b") == first
    assert await desk.ask("4") == await desk.ask("1") + 3
    assert desk.done == 6
    assert await desk.ask("0") == 7


async def test_callers_that_are_remembered_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(idempotency, "CALLERS", 2)
    desk = Desk()
    for caller in "abab":
        await desk.ask("k", caller)
    assert desk.done == 2
    await desk.ask("k", "c")
    assert await desk.ask("k", "b") == 2
    assert await desk.ask("k", "a") == 4


async def test_key_under_way_is_not_forgotten(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(idempotency, "CAPACITY", 1)
    desk = Desk()
    go_on = asyncio.Event()

    async def slow() -> int:
        await go_on.wait()
        return await desk.work()

    first = asyncio.create_task(desk.keys.once("a", "k", REQUEST, slow))
    await asyncio.sleep(0)
    desk.clock = 10 * LIFETIME
    await desk.ask("other")
    again = asyncio.create_task(desk.keys.once("a", "k", REQUEST, slow))
    await asyncio.sleep(0)
    go_on.set()
    assert await first == await again == 2


async def test_failure_is_not_kept() -> None:
    desk = Desk()

    async def fail() -> int:
        raise OSError("not done")

    for _ in range(2):
        with pytest.raises(OSError, match="not done"):
            await desk.keys.once("a", "k", REQUEST, fail)
    assert await desk.ask("k") == 1


async def test_key_of_another_run_is_refused_before_anything_is_done(
    running: Running, bench: Bench
) -> None:
    async with running() as client:
        run = (await client.get("/v1/status")).headers[RUN_HEADER]
        ask = {"Idempotency-Key": "k", RUN_HEADER: "0" * 32}
        for path in ("/v1/captures", "/v1/classifications", "/v1/rotation/advance"):
            refused = await client.post(path, headers=ask)
            assert (refused.status_code, refused.json()["code"]) == (409, "answer_lost")
            assert not refused.json()["retryable"]
            assert refused.headers[RUN_HEADER] == run
        assert bench.sensor.captures == 0
        assert len(bench.epochs) == 1
        first = await client.post("/v1/captures", headers={**ask, RUN_HEADER: run})
        again = await client.post("/v1/captures", headers={"Idempotency-Key": "k"})
        assert first.json() == again.json()
        refused = await client.post("/v1/captures", headers=ask)
        assert refused.status_code == 409
    assert bench.sensor.captures == 1


async def test_key_of_an_unknown_run_is_answered_where_it_came_before(
    running: Running, bench: Bench
) -> None:
    async with running() as client:
        first = await client.post("/v1/captures", headers={"Idempotency-Key": "k"})
        ask = {"Idempotency-Key": "k", RUN_HEADER: UNKNOWN_RUN}
        assert (await client.post("/v1/captures", headers=ask)).json() == first.json()
        refused = await client.post("/v1/captures", headers={**ask, "Idempotency-Key": "l"})
        assert (refused.status_code, refused.json()["code"]) == (409, "answer_lost")
    assert bench.sensor.captures == 1


async def test_every_start_has_another_run() -> None:
    assert len({IdempotencyKeys().run for _ in range(9)}) == 9
