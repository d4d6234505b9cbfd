"""The log over the API: every answer that leaves has its record, and no other."""

from __future__ import annotations

import errno
import os
from typing import TYPE_CHECKING, Any

import pytest

from veilcam_client import AsyncCamera
from veilcam_client.errors import ApiError
from veilcam_client.keys.commitments import answer_digest, logged_mask
from veilcam_client.keys.envelopes import open_key
from veilcam_client.keys.log import is_genuine, line_digest, line_of
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.captures import Capture, Classification, SealedEmbedding
from veilcam_client.wire.events import CaptureTaken, Classified, Event
from veilcam_client.wire.log import LogRecord

if TYPE_CHECKING:
    import httpx
    from tests.unit.server.conftest import Bench, Running

pytestmark = pytest.mark.anyio


def sdk(client: httpx.AsyncClient) -> AsyncCamera:
    return AsyncCamera("http://localhost", http_client=client, max_retries=0)


async def captures(camera: AsyncCamera) -> list[LogRecord]:
    records = (await camera.log.list()).records
    assert all(map(is_genuine, records))
    return [each for each in records if each.kind == "capture"]


@pytest.mark.parametrize("release", ["sealed", "raw"])
async def test_every_answer_has_its_record(running: Running, bench: Bench, release: Any) -> None:
    bench.release = release
    bench.receivers.add("archive", ReceiverKey.generate().public)
    async with running() as client:
        camera = sdk(client)
        answers: list[Capture | Classification] = [
            await camera.capture(),
            await camera.classify(include_embedding=True),
            await camera.classify(),
        ]
        said = await captures(camera)
    assert [each.facts["answer"] for each in said] == [answer_digest(answer) for answer in answers]
    for entry, answer in zip(said, answers, strict=True):
        facts = entry.facts
        assert (facts["epoch"], facts["number"]) == (answer.epoch, answer.number)
        assert entry.at == answer.taken_at
        assert (facts["tested_s"], facts["caller"]) == (60, "127.0.0.1")
        assert "calibration" not in facts


async def test_receiver_finds_the_mask_that_a_record_commits_to(
    running: Running, bench: Bench
) -> None:
    bench.release, key = "sealed", ReceiverKey.generate()
    bench.receivers.add("archive", key.public)
    masks = [pair.levels for pair in bench.bundle.pairs]
    shown: list[int | None] = []
    async with running() as client:
        camera = sdk(client)
        for _ in range(4):
            await camera.rotation.advance()
            answer = await camera.capture()
            shown.append(bench.pair_shown())
            assert isinstance(answer.embedding, SealedEmbedding)
            epoch = open_key(answer.embedding.envelope, key, device=bench.key.public)
            entry = (await captures(camera))[-1]
            assert logged_mask(entry, epoch, masks) == shown[-1]
            assert entry.facts["mask"] not in {line_digest(levels.tobytes()) for levels in masks}
    assert None not in shown


async def test_answer_that_failed_or_came_again_has_no_record_of_its_own(
    running: Running, bench: Bench
) -> None:
    bench.release = "none"
    async with running() as client:
        camera = sdk(client)
        with pytest.raises(ApiError):
            await camera.capture()
        for _ in range(2):
            again = {"Idempotency-Key": "once"}
            assert (await client.post("/v1/classifications", headers=again)).status_code == 200
        assert len(await captures(camera)) == 1


async def test_events_and_log_name_no_whole_id(bench: Bench) -> None:
    """The rest of the id is what keeps a label from being guessed from its record."""
    service = bench.service(bench.camera())
    told: list[Event] = []
    service._events.subscribe(told.append)
    async with service.open():
        answer = await service.classify(include_embedding=False)
        log = service.log.records(None, 9)
    named = [each.capture for each in told if isinstance(each, CaptureTaken | Classified)]
    assert named == 2 * [answer.id[:16]]
    assert len(answer.id) == 48
    for each in (*told, log):
        assert answer.id[16:] not in each.model_dump_json()


async def test_pages_follow_from_each_other(running: Running, bench: Bench) -> None:
    async with running() as client:
        camera = sdk(client)
        for _ in range(3):
            await camera.classify()
        first = await camera.log.list(limit=2)
        assert first.next == 1
        rest = await camera.log.list(after=first.next)
        newest = await camera.log.list(limit=1, newest=True)
    found = (*first.records, *rest.records)
    assert [each.position for each in found] == [0, 1, 2, 3]
    assert {each.device for each in found} == {bench.key.public}
    assert found[3].previous == line_digest(line_of(found[2]))
    assert newest.records == found[3:]


@pytest.mark.parametrize(
    "asked", ["limit=0", "limit=1001", "after=-1", "after=x", f"after={2**63}", "newest=x"]
)
async def test_question_that_cannot_be_asked_is_refused(running: Running, asked: str) -> None:
    async with running() as client:
        answer = await client.get(f"/v1/log?{asked}")
    assert (answer.status_code, answer.json()["code"]) == (422, "invalid_request")


async def test_full_disk_stops_no_answer(
    running: Running, bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    async with running() as client:
        camera = sdk(client)
        with monkeypatch.context() as full:
            full.setattr(os, "pwrite", refuse)
            await camera.classify()
            assert await captures(camera) == []
            told = await camera.diagnostics()
            assert told.log_missed == 1
            faults = told.faults
            assert [fault.code for fault in faults] == ["storage_failed"]
            assert faults[0].remedy == "check_disk"
        await camera.classify()
        kinds = [each.kind for each in (await camera.log.list()).records]
        assert kinds == ["start", "gap", "capture"]
