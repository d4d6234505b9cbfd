"""Receivers over the API: who may pair them, from when on it holds, and what stands in the log."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from tests.unit.server.api.conftest import bearer
from tests.unit.server.logs import events, open_log

from veilcam_client import AsyncCamera
from veilcam_client.errors import ApiError, SealedError
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.rotation import EveryCaptures, RotationOff
from veilcam_client.wire.sealing import PairedReceiver, Receivers
from veilcam_client.wire.tokens import Scope
from veilcam_server.sealing.receivers import ReceiverStore
from veilcam_server.security.admission import Admission
from veilcam_server.security.tokens import TokenStore

if TYPE_CHECKING:
    import httpx
    from tests.unit.server.conftest import Bench, Running

pytestmark = pytest.mark.anyio

KEY = ReceiverKey.generate()
QUESTION = {"label": "archive", "key": str(KEY.public)}
PATH = "/v1/receivers"


def code(answer: httpx.Response) -> tuple[int, str]:
    return answer.status_code, answer.json()["code"]


async def test_receivers_are_paired_listed_and_removed(running: Running, bench: Bench) -> None:
    async with running() as client:
        nobody = Receivers.model_validate_json((await client.get(PATH)).content)
        assert nobody == Receivers(device=bench.key.public, receivers=())
        answer = await client.post(PATH, json=QUESTION)
        assert answer.status_code == 201
        made = PairedReceiver.model_validate_json(answer.content)
        assert (made.id, made.label) == (KEY.public.id, "archive")
        listed = Receivers.model_validate_json((await client.get(PATH)).content)
        status = (await client.get("/v1/status")).json()
        assert listed.receivers == (made,)
        assert [each["id"] for each in status["receivers"]] == [made.id]
        assert status["device"]["key"] == listed.device
        # On the disk before it was acknowledged.
        assert ReceiverStore(bench.state_dir).paired == (made,)
        removed = await client.delete(f"{PATH}/{made.id}")
        assert (removed.status_code, removed.content) == (204, b"")
        assert (await client.get(PATH)).json()["receivers"] == []
        assert code(await client.delete(f"{PATH}/{made.id}")) == (404, "not_found")


async def test_key_that_cannot_be_paired_is_refused(
    running: Running, bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with running() as client:
        for wrong in ("veilcam-receiver:AAAA", "veilcam-receiver:===="):
            answer = await client.post(PATH, json={**QUESTION, "key": wrong})
            assert code(answer) == (422, "invalid_request")
        for wrong in ("", "another", f"{KEY.public} "):
            answer = await client.post(PATH, json={**QUESTION, "key": wrong})
            assert code(answer) == (422, "invalid_request")
        assert code(await client.delete(f"{PATH}/archive")) == (422, "invalid_request")
        once = {"Idempotency-Key": "one"}
        first = await client.post(PATH, json=QUESTION, headers=once)
        again = await client.post(PATH, json=QUESTION, headers=once)
        assert (again.status_code, again.content) == (201, first.content)
        assert code(await client.post(PATH, json=QUESTION)) == (409, "conflict")
        for number in range(7):
            bench.receivers.add(str(number), ReceiverKey.generate().public)
        other = {"label": "ninth", "key": str(ReceiverKey.generate().public)}
        assert code(await client.post(PATH, json=other)) == (409, "conflict")

        def full(*_: object) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(os, "fsync", full)
        answer = await client.delete(f"{PATH}/{KEY.public.id}")
        assert code(answer) == (503, "storage_failed")
        assert len(bench.receivers.keys) == 8


async def test_pairing_holds_from_the_next_epoch_on(running: Running, fresh_bench: Bench) -> None:
    bench = fresh_bench
    bench.release = "sealed"
    async with (
        running(on=bench, policy=EveryCaptures(captures=3)) as client,
        AsyncCamera("http://localhost", http_client=client, key=KEY, max_retries=0) as sdk,
    ):
        with pytest.raises(ApiError, match="pair one with 'veilcam receiver add'") as caught:
            await sdk.capture()
        assert (caught.value.status, caught.value.code) == (403, "embedding_withheld")
        assert (await sdk.classify()).label in bench.bundle.labels
        await sdk.receivers.add("archive", KEY.public)
        first, second = await sdk.capture(), await sdk.capture()
        assert np.array_equal(np.asarray(first), bench.sensor.measurement)
        assert first.notes is not None
        assert second.epoch == first.epoch
        await sdk.receivers.remove(KEY.public.id)
        await sdk.receivers.add("another", ReceiverKey.generate().public)
        # The mask that is shown has one capture left, which is a label's: for what is sealed, the
        # next epoch begins.
        assert (await sdk.classify()).epoch == first.epoch
        await sdk.rotation.set(RotationOff())
        with pytest.raises(SealedError, match="not sealed to receiver"):
            await sdk.capture()


async def test_sealed_embedding_is_no_array(running: Running, fresh_bench: Bench) -> None:
    fresh_bench.release = "sealed"
    fresh_bench.receivers.add("archive", KEY.public)
    async with running(on=fresh_bench) as client:
        answer = await client.post("/v1/captures", headers={"Accept": "application/x-npy"})
        assert code(answer) == (406, "not_acceptable")
        assert "embeddings leave sealed, which are no arrays" in answer.json()["detail"]
        assert fresh_bench.sensor.captures == 0


async def test_scopes_and_the_log(
    running: Running, bench: Bench, store: TokenStore, tmp_path: Path
) -> None:
    log = open_log(tmp_path)
    reader = bearer(store, "read:status", "admin:tokens")
    admin = bearer(store, "admin:receivers")
    async with running(admission=Admission(store, log=log)) as client:
        assert (await client.get(PATH, headers=reader)).status_code == 200
        for given in (
            await client.post(PATH, json=QUESTION, headers=reader),
            await client.delete(f"{PATH}/{KEY.public.id}", headers=reader),
            await client.get(PATH, headers=admin),
        ):
            assert code(given) == (403, "forbidden")
        assert not bench.receivers.keys
        await client.post(PATH, json=QUESTION, headers=admin)
        await client.delete(f"{PATH}/{KEY.public.id}", headers=admin)
    log.close()
    done = [entry for entry in events(tmp_path, "request") if entry.get("code") is None]
    assert [entry["action"] for entry in done] == [
        f"POST {PATH}",
        f"DELETE {PATH}/{KEY.public.id}",
    ]
    assert (done[0]["receiver"], done[0]["named"]) == (KEY.public.id, "archive")


@pytest.mark.parametrize(
    ("scopes", "full", "told"),
    [
        (("classify",), True, "nothing"),
        (("classify", "read:scores"), False, "tenths"),
        (("classify", "read:scores"), True, "all"),
    ],
)
async def test_scores_are_told_by_scope_and_setting(
    running: Running,
    bench: Bench,
    store: TokenStore,
    *,
    scopes: tuple[Scope, ...],
    full: bool,
    told: str,
) -> None:
    bench.sensor.measurement = 0.1 * np.random.default_rng(0).random((4, 5), np.float32)
    headers = bearer(store, *scopes)
    async with running(admission=Admission(store, full_scores=full)) as client:
        found: dict[str, Any] = (await client.post("/v1/classifications", headers=headers)).json()
    assert found["label"] in bench.bundle.labels
    if told == "nothing":
        assert (found["confidence"], found["scores"]) == (None, None)
        return
    values = [found["confidence"], *found["scores"].values()]
    assert all(value == round(value, 1) for value in values) is (told == "tenths")
    assert found["confidence"] == max(found["scores"].values())
    assert set(found["scores"]) == set(bench.bundle.labels)


async def test_answer_has_one_size_and_the_same_fields_whatever_is_seen(
    running: Running, fresh_bench: Bench
) -> None:
    fresh_bench.release = "sealed"
    fresh_bench.receivers.add("archive", KEY.public)
    scenes = (np.zeros((4, 5), np.float32), np.full((4, 5), 1e3, np.float32))
    sizes, fields = set(), set()
    async with running(on=fresh_bench, policy=EveryCaptures(captures=1)) as client:
        for scene in (*scenes, *scenes):
            fresh_bench.sensor.measurement = scene
            answer = await client.post("/v1/captures")
            found = answer.json()
            fields.add(frozenset(name for name, value in found.items() if value is not None))
            sizes.add(len(json.dumps(found)))
    assert len(sizes) == 1
    assert fields == {frozenset(("id", "epoch", "number", "taken_at", "embedding"))}


async def test_stored_masks_that_are_spent_release_nothing_more(
    running: Running, bench: Bench
) -> None:
    bench.raw_budget = 2
    budget = 2 * len(bench.bundle.pairs)
    async with running() as client:
        answers = [await client.post("/v1/captures") for _ in range(budget + 2)]
        assert [answer.status_code for answer in answers] == [200] * budget + [409] * 2
        assert answers[-1].json()["code"] == "masks_spent"
        epochs = [answer.json()["epoch"] for answer in answers[:budget]]
        assert max(map(epochs.count, epochs)) == 2
        # A label alone costs nothing.
        assert (await client.post("/v1/classifications", json={})).status_code == 200
        assert (await client.get("/v1/status")).json()["raw_budget"] == 2
    # Nor does a restart give any back.
    async with running() as client:
        assert (await client.post("/v1/captures")).json()["code"] == "masks_spent"
