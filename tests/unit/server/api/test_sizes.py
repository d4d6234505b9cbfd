"""Sizes of answers: one for each route, whatever is seen and whatever fails."""

from __future__ import annotations

import dataclasses
import io
from datetime import UTC, datetime
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.captures import NPY_MEDIA_TYPE
from veilcam_client.wire.events import Fault, StateChanged
from veilcam_client.wire.rotation import EveryCaptures
from veilcam_client.wire.watch import Watching
from veilcam_server.api.sizes import CAPTURES, CLASSIFICATIONS, DIAGNOSTICS, PATHS, STATUS, WATCH
from veilcam_server.devices import SensorError
from veilcam_server.errors import UnsteadyLightError
from veilcam_server.masks.pairs import load_pairs
from veilcam_server.security.admission import Admission
from veilcam_server.security.tokens import TokenStore

if TYPE_CHECKING:
    from pathlib import Path

    import httpx
    from tests.unit.server.conftest import Bench, Running

    from veilcam_server.service.service import Service

pytestmark = pytest.mark.anyio

METHODS = {CAPTURES: "POST", CLASSIFICATIONS: "POST"}
NAMES = ("n", "a much longer name of a class", 'a "quoted" one', "näm\u00e9 \U0001f600", "x")


def size(answer: httpx.Response) -> tuple[int, int]:
    """Sizes of the head and of the body, as a listener reads them."""
    lines = [f"{name.decode()}: {value.decode()}\r\n" for name, value in answer.headers.raw]
    assert int(answer.headers["content-length"]) == len(answer.content)
    assert not {"etag", "content-encoding"} & set(answer.headers)
    assert answer.headers["cache-control"] == "no-store, no-transform"
    return len(answer.reason_phrase) + sum(map(len, lines)), len(answer.content)


async def ask(client: httpx.AsyncClient, path: str, **given: Any) -> httpx.Response:
    return await client.request(METHODS.get(path, "GET"), path, **given)


def service_of(client: httpx.AsyncClient) -> Service:
    service: Service = client._transport.app.state.service  # type: ignore[attr-defined]
    return service


@pytest.fixture
def named(bench: Bench) -> Bench:
    """A bench whose labels differ in length."""
    labels = (*NAMES, *bench.bundle.labels[len(NAMES) :])
    bundle = dataclasses.replace(bench.bundle, labels=labels)
    return dataclasses.replace(bench, bundle=bundle, source=load_pairs(bundle))


@pytest.mark.parametrize("release", ["none", "sealed", "raw"])
async def test_sizes_do_not_follow_labels_scores_and_failures(
    running: Running, named: Bench, release: Any
) -> None:
    bench = dataclasses.replace(named, release=release)
    bench.receivers.add("archive", ReceiverKey.generate().public)
    random = np.random.default_rng(0)
    labels, found = set(), set()
    async with running(on=bench, policy=EveryCaptures(captures=1)) as client:
        for _ in range(30):
            bench.sensor.measurement = random.normal(size=(4, 5)).astype(np.float32)
            answer = await ask(client, CLASSIFICATIONS)
            labels.add(answer.json()["label"])
            found.add((CLASSIFICATIONS, size(answer)))
            found.add((CAPTURES, size(await ask(client, CAPTURES))))
        for error in (SensorError("no frame"), UnsteadyLightError("the light changed: try again")):
            bench.sensor.fault = error
            for path in (CLASSIFICATIONS, CAPTURES):
                answer = await ask(client, path)
                assert answer.status_code in (403, 503)
                found.add((path, size(answer)))
        bench.sensor.fault = None
        assert (await client.put(WATCH, json={"mode": "off"})).status_code == 200
        for path in (CLASSIFICATIONS, CAPTURES):
            found.add((path, size(await ask(client, path))))
    assert len(labels) > 3
    assert len(found) == 2


async def test_sizes_with_an_embedding_are_one_too(running: Running, bench: Bench) -> None:
    found = set()
    async with running() as client:
        for power in (0.0, 1e-30, 1.0, 1e30):
            bench.sensor.measurement = np.full((4, 5), power / 3, np.float32)
            asked = {"json": {"include_embedding": True}}
            found.add(size(await ask(client, CLASSIFICATIONS, **asked)))
        arrays = await client.post(CAPTURES, headers={"Accept": NPY_MEDIA_TYPE})
        bench.sensor.fault = SensorError("no frame")
        found.add(size(await ask(client, CLASSIFICATIONS, json={"include_embedding": True})))
        found.add(size(await ask(client, CAPTURES)))
    assert np.load(io.BytesIO(arrays.content)).shape == (4, 5)
    assert len(found) == 1


async def test_sizes_do_not_follow_the_history(
    running: Running, named: Bench, tmp_path: Path
) -> None:
    store = TokenStore(tmp_path / "tokens")
    named.sensor.measurement = 10 * np.ones((4, 5), np.float32)
    tokens = [
        store.create("one", scopes, None).secret
        for scopes in (("read:status",), ("read:status", "classify", "read:scores"))
    ]
    found, histories = set(), set()
    watch = dataclasses.replace(named, watch=Watching(rate_hz=10.0))
    async with running(on=watch, admission=Admission(tokens=store)) as client:
        service = service_of(client)
        for turn in range(12):
            detail = turn * "a reason "
            service._events.publish(
                lambda detail=detail, **given: Fault(code="sensor_failed", detail=detail, **given)
            )
            service._events.publish(
                lambda detail=detail, **given: StateChanged(
                    state="degraded", detail=detail, remedy="check_panel_wiring", **given
                )
            )
            named.sensor.measurement = (-1) ** turn * named.sensor.measurement
            for token in tokens:
                for path in (WATCH, STATUS, DIAGNOSTICS):
                    answer = await ask(client, path, headers={"Authorization": f"Bearer {token}"})
                    found.add((path, size(answer)))
                    histories.add(len(answer.json().get("history", ())))
            await service.watcher.look()
        for path in (WATCH, STATUS, DIAGNOSTICS):
            found.add((path, size(await ask(client, path))))
    assert len(histories) > 1
    assert len(found) == 3


async def test_sizes_hold_the_longest_answers(running: Running, named: Bench) -> None:
    """As long as reasons have at most 224 characters; a longer one is not cut."""
    found = set()
    async with running(on=named) as client:
        service = service_of(client)
        for length in (1, 224):
            detail = length * "r"
            for _ in range(40):
                service.history.add(
                    Fault(id="", at=datetime.now(UTC), code="sensor_failed", detail=detail)
                )
                service.history.enter(
                    StateChanged(id="", at=datetime.now(UTC), state="degraded", detail=detail)
                )
            found.add(size(await ask(client, DIAGNOSTICS)))
        assert len(found) == 1
        service.history.last_faults[-1] = service.history.last_faults[-1].model_copy(
            update={"detail": 100_000 * "r"}
        )
        answer = await ask(client, DIAGNOSTICS)
    assert len(answer.json()["faults"][-1]["detail"]) == 100_000
    assert size(answer)[1] % found.pop()[1] == 0


async def test_sizes_of_refusals_and_heads_are_those_of_answers(running: Running) -> None:
    async with running() as client:
        for path in PATHS:
            lengths = {
                answer.headers["content-length"]
                for answer in (
                    await ask(client, path),
                    await client.request("PATCH", path),
                    await ask(client, path, headers={"Host": "elsewhere.example"}),
                )
            }
            if path not in METHODS:
                head = await client.head(path)
                assert head.content == b""
                lengths.add(head.headers["content-length"])
            assert len(lengths) == 1
