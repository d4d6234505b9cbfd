"""What is done although nobody asks, and the watchdog that is fed only while the device answers."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import pytest
from structlog.testing import capture_logs
from tests.unit.server.devices.clock import Clock
from tests.unit.server.service.waiting import until

from veilcam_server.devices import Device
from veilcam_server.devices.errors import SensorHungError
from veilcam_server.devices.reopening import Health, stamped
from veilcam_server.errors import NotReadyError, UndecidedError
from veilcam_server.service.queue import DeviceQueue
from veilcam_server.service.scheduler import Alarms, Scheduler

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench, Running


def scheduler(bench: Bench, camera: Any, **more: Any) -> Scheduler:
    queue = DeviceQueue(8, lambda _: None)
    alarms = Alarms(camera, lambda _: None)
    return Scheduler(camera, queue, alarms, **{"first_pause": 0.002, **more})


@pytest.mark.anyio
async def test_panel_is_tested_now_and_then(bench: Bench) -> None:
    camera = bench.camera(test_every=0.01)
    async with scheduler(bench, camera).running():
        await until(lambda: bench.test.runs >= 4)
    camera.stop()
    assert bench.sensor.captures == 0


@pytest.mark.anyio
async def test_added_task_is_done_when_due_and_an_event_tells_to_look_again(
    bench: Bench,
) -> None:
    camera = bench.camera()
    due, done = [0.0, 0.0, 3600.0], list[float]()

    async def work() -> None:
        done.append(due.pop(0))

    made = scheduler(bench, camera)
    made.add("watch", lambda: due[0], work)
    async with made.running():
        await until(lambda: len(done) == 2)
        due[0] = 0.0
        due.append(3600.0)
        made.wake()
        await until(lambda: len(done) == 3)
    assert due == [3600.0]
    camera.stop()


@pytest.mark.anyio
async def test_test_that_failed_is_tried_until_it_passes(bench: Bench) -> None:
    camera = bench.camera()
    bench.test.faults = [UndecidedError("it is too dark")] * 4
    bench.display.resets += 1
    with pytest.raises(NotReadyError):
        camera.capture(release=False).done()
    async with scheduler(bench, camera).running():
        await until(lambda: camera.state[0] == "ready")
    assert bench.test.runs == 6
    camera.stop()


@pytest.mark.anyio
async def test_pauses_grow_from_one_failure_to_the_next(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = bench.camera()
    bench.test.faults = [UndecidedError("it is too dark")] * 9
    bench.display.resets += 1
    pauses: list[float] = []

    async def note(_: Scheduler, task: object, seconds: float) -> None:
        pauses.append(seconds)
        await asyncio.sleep(0)

    monkeypatch.setattr(Scheduler, "_rest", note)
    async with scheduler(bench, camera, first_pause=1.0).running():
        await until(lambda: bench.test.runs == 11 and camera.state[0] == "ready")
    assert pauses == [1, 2, 4, 8, 16, 32, 60, 60, 60]
    camera.stop()


@pytest.mark.anyio
async def test_watchdog_is_fed_while_the_device_answers(bench: Bench) -> None:
    camera = bench.camera()
    told: list[str] = []
    go_on, hanging = threading.Event(), threading.Event()

    def hang() -> None:
        hanging.set()
        go_on.wait(200)

    bench.sensor.before = hang
    camera._health._longest = 0.02
    with capture_logs() as logs:
        async with scheduler(bench, camera, watchdog=0.004, tell=told.append).running():
            await until(lambda: len(told) >= 3)
            capturing = asyncio.create_task(asyncio.to_thread(camera.capture, release=False))
            await asyncio.to_thread(hanging.wait, 20)
            await until(lambda: not camera.healthy())
            fed = len(told)
            await asyncio.sleep(0.05)
            assert len(told) == fed
            go_on.set()
            await capturing
            await until(lambda: len(told) > fed)
    assert set(told) == {"WATCHDOG=1"}
    # Once when it goes down.
    assert [entry["event"] for entry in logs].count(
        "panel, camera or processor too slow: the watchdog is not fed any more"
    ) == 1
    camera.stop()


@pytest.mark.anyio
async def test_without_a_watchdog_nobody_is_told(bench: Bench) -> None:
    camera = bench.camera()
    told: list[str] = []
    async with scheduler(bench, camera, tell=told.append).running():
        await asyncio.sleep(0.02)
    assert not told
    camera.stop()


def test_calls_of_the_device_are_stamped(bench: Bench) -> None:
    clock = Clock()
    health = Health(5.0, clock)
    device = stamped(Device(bench.display, bench.sensor, simulated=True), health)
    seen: list[bool] = []

    def slow(*_: object) -> Any:
        clock.sleep(4)
        seen.append(health.healthy())
        clock.sleep(2)
        seen.append(health.healthy())
        raise RuntimeError

    asked: list[tuple[object, str, Callable[[], object]]] = [
        (bench.display, "show", lambda: device.display.show(bench.bundle.pairs[0].levels)),
        (bench.display, "blank", device.display.blank),
        (bench.display, "close", device.display.close),
        (bench.sensor, "capture", lambda: device.sensor.capture(0.0, 1.0)),
        (bench.sensor, "close", device.sensor.close),
    ]
    for part, name, ask in asked:
        setattr(part, name, slow)
        with pytest.raises(RuntimeError):
            ask()
        assert seen[-2:] == [True, False]
        # What ended, well or badly, hangs no more.
        assert health.healthy()
    assert device.display.name == "fake panel"
    assert device.sensor.name == "fake sensor"
    assert device.display.resets == 1
    assert device.sensor.full_scale == 1.0


@pytest.mark.slow
@pytest.mark.anyio
async def test_failed_test_is_no_fault_of_its_own_in_the_events(
    bench: Bench, running: Running
) -> None:
    """The state tells of it, once; a dark night would fill every log."""
    async with running() as client:
        bench.test.faults = [UndecidedError("it is too dark")] * 2
        bench.display.resets += 1
        answer = await client.post("/v1/captures")
        assert answer.status_code == 503
        problem = answer.json()
        assert (problem["code"], problem["retryable"]) == ("not_ready", True)
        assert "too dark" in problem["detail"]
        status = (await client.get("/v1/status")).json()
        assert (status["state"], status["detail"]) == ("degraded", "it is too dark")
        begun = time.monotonic()
        while (await client.get("/v1/status")).json()["state"] != "ready":
            assert time.monotonic() - begun < 60
            await asyncio.sleep(0.02)
        assert (await client.post("/v1/captures")).status_code == 200
        service = client._transport.app.state.service  # type: ignore[attr-defined]
        kinds = [event.kind for event in service._events.log._events]
    # What was asked for failed; what was tried again in the background only says when it is back.
    assert kinds.count("fault") == 1
    assert kinds.count("state") == 3


def test_sensor_that_is_not_let_go_is_the_watchdogs_business(bench: Bench) -> None:
    camera = bench.camera()

    def hang() -> None:
        raise SensorHungError("the camera hangs while it is closed")

    bench.sensor.before = hang
    with pytest.raises(SensorHungError):
        camera.capture(release=False).done()
    assert not camera.healthy()
    bench.sensor.before = lambda: None
    camera.capture(release=False).done()
    assert camera.healthy()
