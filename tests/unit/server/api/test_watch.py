"""The watch over the API: who may switch it, who is told what, and that nothing else leaves."""

from __future__ import annotations

import asyncio
import dataclasses
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from veilcam_client.async_camera import AsyncCamera
from veilcam_client.errors import VeilcamError
from veilcam_client.http.resumption import Resumption
from veilcam_client.wire.base import EXAMPLE_TIME
from veilcam_client.wire.events import Event, Gone, Seen
from veilcam_client.wire.rotation import EveryCaptures
from veilcam_client.wire.watch import OnRequest, QuietHours, Watch, Watching, WatchOff
from veilcam_server.api.routes.events import _told
from veilcam_server.errors import NotReadyError
from veilcam_server.security.admission import Admission
from veilcam_server.security.tokens import Caller, TokenStore
from veilcam_server.service.service import Service

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Awaitable
    from pathlib import Path

    import httpx
    from tests.unit.server.conftest import Bench, Running

    from veilcam_client.wire.tokens import Scope

pytestmark = pytest.mark.anyio

OFTEN = Watching(rate_hz=10.0)
ALWAYS = QuietHours(begin="00:00", end="23:59")


async def code(asked: Awaitable[object]) -> str | None:
    """Code of the problem that a request ends in."""
    with pytest.raises(VeilcamError) as caught:
        await asked
    return getattr(caught.value, "code", None)


def sdk(client: httpx.AsyncClient, token: str | None = None) -> AsyncCamera:
    return AsyncCamera("http://localhost", http_client=client, token=token)


async def until_seen(camera: AsyncCamera) -> Watch:
    """Wait until something is there."""
    while not (found := await camera.watch.get()).history:
        await asyncio.sleep(0.02)
    return found


async def until_quiet(stream: AsyncIterator[Event | None]) -> AsyncIterator[Event]:
    async for event in stream:
        if event is None:
            return
        yield event


async def test_off_is_opaque_for_everybody(running: Running, bench: Bench) -> None:
    async with running() as client:
        camera = sdk(client)
        assert (await camera.watch.get()).activity == "on_request"
        found = await camera.watch.set(WatchOff())
        assert (found.activity, found.policy) == ("off", WatchOff())
        assert not bench.display.shown[-1].any()
        assert (await camera.status()).state == "off"
        captures = bench.sensor.captures
        for asked in (camera.capture, camera.classify, camera.rotation.advance):
            assert await code(asked()) == "not_looking"
        assert bench.sensor.captures == captures
        assert bench.pair_shown() is None
        assert (await camera.watch.set(OnRequest())).activity == "on_request"
        assert bench.pair_shown() is not None
        assert (await camera.classify()).label in "0123456789"
        states = [past.state for past in (await camera.diagnostics()).states]
        assert [state for state in states if state != "self-test"] == ["ready", "off", "ready"]
        assert not (await camera.diagnostics()).faults


async def test_watch_looks_by_itself_and_releases_a_label_alone(
    running: Running, bench: Bench
) -> None:
    bench = dataclasses.replace(bench, watch=OFTEN, raw_budget=1)
    bench.sensor.measurement = 10 * np.ones_like(bench.sensor.measurement)
    spent = []
    async with running(on=bench, policy=EveryCaptures(captures=1)) as client:
        camera = sdk(client)
        before, found = await camera.log.list(), await until_seen(camera)
        spent.append((await camera.status()).captures)
        after = await camera.log.list()
        # The one embedding that may leave behind the mask is there still.
        assert (await camera.capture()).embedding.form == "raw"
    assert found.activity == "looking"
    assert found.history[0].label in "0123456789"
    assert found.looks >= 1
    assert spent == [0]
    assert after == before


async def test_sight_is_a_change_of_states_and_no_event(running: Running, bench: Bench) -> None:
    bench = dataclasses.replace(bench, watch=OFTEN)
    bench.sensor.measurement = np.zeros_like(bench.sensor.measurement)
    service = None
    async with running(on=bench) as client:
        service = client._transport.app.state.service  # type: ignore[attr-defined]
        assert isinstance(service, Service)
        published, heard = list[Event](), list[Event]()
        service._events.subscribe(published.append)

        async def listen() -> None:
            changes = Resumption(sdk(client)._transport.options, None, reconnect=True)
            async for event in service.events(None):
                heard.extend(changes.heard(event) if event is not None else ())

        listening = asyncio.create_task(listen())
        while (await sdk(client).watch.get()).looks < 3:
            await asyncio.sleep(0.02)
        bench.sensor.measurement = 10 * np.ones_like(bench.sensor.measurement)
        found = await until_seen(sdk(client))
        bench.sensor.measurement = np.zeros_like(bench.sensor.measurement)
        while not any(isinstance(event, Gone) for event in heard):
            await asyncio.sleep(0.02)
        public = [event async for event in until_quiet(service.events("", labels=False))]
    await listening
    assert not {"seen", "gone", "belief"} & {event.kind for event in published}
    assert not {"seen", "gone", "belief"} & {event.kind for event in public}
    assert [int(event.id.rpartition("-")[2]) for event in public[1:]] == list(
        range(len(public) - 1)
    )
    kinds = [event.kind for event in heard if event.kind not in ("mask", "state")]
    assert kinds == ["seen", "gone"]
    seen = next(event for event in heard if isinstance(event, Seen))
    gone = next(event for event in heard if isinstance(event, Gone))
    assert seen.label == gone.label == found.history[0].label
    assert gone.reason == "left"


async def test_lease_of_another_stops_it_and_refuses_to_change_it(
    running: Running, bench: Bench
) -> None:
    async with running() as client:
        service = client._transport.app.state.service  # type: ignore[attr-defined]
        assert not service.watcher.leased()
        holder = sdk(client)
        await holder.lease.take(seconds=60)
        assert service.watcher.leased()
        assert await code(sdk(client).watch.set(WatchOff())) == "leased"
        assert (await sdk(client).watch.get()).activity == "on_request"
        assert (await holder.watch.set(WatchOff())).activity == "off"


async def test_while_the_camera_is_measured_it_cannot_be_switched(
    running: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with running() as client:
        service = client._transport.app.state.service  # type: ignore[attr-defined]

        def measured() -> None:
            raise NotReadyError("the camera is being calibrated")

        monkeypatch.setattr(service.calibration, "require_idle", measured)
        assert await code(sdk(client).watch.set(WatchOff())) == "not_ready"
        assert (await sdk(client).watch.get()).policy == OnRequest()


@pytest.mark.parametrize(
    ("scopes", "full", "label", "digits"),
    [
        (("read:status",), True, False, None),
        (("read:status", "read:scores"), True, False, None),
        (("read:status", "classify"), True, True, None),
        (("read:status", "classify", "read:scores"), False, True, 1),
        (("read:status", "classify", "read:scores"), True, True, 17),
    ],
)
async def test_sight_is_told_by_scope(  # noqa: PLR0917 - fixtures and a table
    running: Running,
    bench: Bench,
    tmp_path: Path,
    scopes: tuple[Scope, ...],
    full: bool,
    label: bool,
    digits: int | None,
) -> None:
    bench = dataclasses.replace(bench, watch=OFTEN)
    bench.sensor.measurement = 10 * np.ones_like(bench.sensor.measurement)
    store = TokenStore(tmp_path / "tokens")
    every = store.create("all", ("read:status", "classify", "read:scores"), None)
    some = store.create("some", scopes, None)
    async with running(on=bench, admission=Admission(store, full_scores=full)) as client:
        whole = await until_seen(sdk(client, every.secret))
        found = await sdk(client, some.secret).watch.get()
        assert await code(sdk(client, some.secret).watch.set(WatchOff())) == "forbidden"
    assert whole.belief is not None
    assert whole.history
    assert (found.belief is not None, bool(found.history)) == (label, label)
    caller = Caller("some", "some", frozenset(scopes), full_scores=full)
    known: dict[str, Any] = {"id": "0-0", "at": EXAMPLE_TIME, "label": "a", "duration_s": 1.0}
    events = (
        Seen(confidence=0.987654321, **known),
        Gone(confidence=0.987654321, reason="left", **known),
        Gone(confidence=None, reason="not_looking", **known),
    )
    heard: list[Any] = [_told(event, caller) for event in events if label]
    assert all(each.confidence is None for each in heard[2:])
    told = [
        each.confidence for each in (found.belief, *found.history, *heard[:2]) if each is not None
    ]
    if digits is None:
        assert told == [None] * len(told)
    else:
        assert all(each is not None and round(each, digits) == each for each in told)
        assert digits > 1 or set(told) <= {0.6, 0.7, 0.8, 0.9, 1.0}
