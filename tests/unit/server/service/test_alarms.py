"""Tasks that nobody expected to fail: each goes on, and the state tells of it meanwhile."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from datetime import UTC, datetime
from functools import partial
from typing import TYPE_CHECKING, Any

import pytest
from structlog.testing import capture_logs
from tests.unit.server.service.waiting import until

from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.wire.events import Event, MaskChanged, StateChanged
from veilcam_client.wire.rotation import EveryCaptures
from veilcam_server.camera.camera import MaskedCamera
from veilcam_server.camera.engine import Condition
from veilcam_server.errors import SelfTestError, StorageError
from veilcam_server.service.queue import DeviceQueue
from veilcam_server.service.scheduler import Alarms, Scheduler
from veilcam_server.service.service import Service

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench

pytestmark = pytest.mark.anyio

SECRET = "63 17 4"


class Camera:
    """A camera that is as a test says."""

    state = Condition("ready")


class Told:
    """What was published, as events."""

    def __init__(self) -> None:
        self.events: list[Event] = []

    def __call__(self, make: Callable[..., Event]) -> None:
        self.events.append(make(id="", at=datetime.now(UTC)))

    @property
    def states(self) -> list[Condition]:
        return [
            Condition(event.state, event.detail, event.remedy)
            for event in self.events
            if isinstance(event, StateChanged)
        ]


DEFECT = Condition("degraded", "a defect in the self test: it is tried again", "report_defect")
FULL = Condition("degraded", "disk full", "check_disk")


def alarms(camera: Camera) -> tuple[Alarms, Told]:
    told = Told()
    return Alarms(camera, told), told  # type: ignore[arg-type]


async def test_camera_that_is_ready_is_degraded_while_a_task_fails() -> None:
    found, told = alarms(Camera())
    with capture_logs() as logs:
        for _ in range(2):
            found.sound("self test", RuntimeError(SECRET))
    assert found.state == DEFECT
    found.sound("change of masks", StorageError("disk full"))
    assert found.state == DEFECT
    found.clear("self test")
    assert found.state == FULL
    found.clear("self test")
    found.clear("change of masks")
    assert found.state == ("ready", None, None)
    assert told.states == [DEFECT, FULL, ("ready", None, None)]
    assert [entry["error"] for entry in logs] == ["RuntimeError"] * 2
    assert SECRET not in str(logs) + str(told.events)


async def test_state_of_the_camera_goes_before_alarms() -> None:
    camera = Camera()
    camera.state = Condition("safe", "no answer", "check_panel_wiring")
    found, told = alarms(camera)
    found.sound("self test", SelfTestError("no answer"))
    assert found.state == camera.state
    assert not told.events
    camera.state = Condition("ready")
    assert found.state == ("ready", None, None)


async def test_camera_that_says_it_is_ready_is_not_believed_while_a_task_fails() -> None:
    found, told = alarms(Camera())
    found.sound("change of masks", StorageError("disk full"))
    safe = Condition("safe", "no answer", "check_panel_wiring")
    found.pass_on(partial(StateChanged, **safe._asdict()))
    found.pass_on(partial(StateChanged, state="ready"))
    found.pass_on(partial(MaskChanged, epoch="a"))
    assert told.states == [FULL, safe, FULL]
    assert isinstance(told.events[-1], MaskChanged)


async def test_subscriber_of_events_may_fail(bench: Bench) -> None:
    service = bench.service(bench.camera())
    heard: list[str] = []
    broken = True

    def take(event: Event) -> None:
        if broken:
            raise RuntimeError(SECRET)

    events = service._events
    events._subscribers.insert(0, service._alarms.guarded("test", take))
    events.subscribe(lambda event: heard.append(event.kind))
    async with service.open():
        events.publish(partial(MaskChanged, epoch="a"))
        await until(lambda: service.status().state == "degraded")
        assert service.status().remedy == "report_defect"
        await until(lambda: len(heard) == 2)
        broken = False
        events.publish(partial(MaskChanged, epoch="b"))
        await until(lambda: service.status().state == "ready")
        await until(lambda: len(heard) == 4)
    # Whoever else listens hears all of it, in the order in which it happened.
    assert heard[:4] == ["mask", "state", "mask", "state"]


def scheduled(bench: Bench, camera: Any, **more: Any) -> tuple[Scheduler, Alarms, Told]:
    told = Told()
    alarms = Alarms(camera, told)
    queue = DeviceQueue(8, lambda _: None)
    return Scheduler(camera, queue, alarms, first_pause=0.002, **more), alarms, told


class Failing:
    """Raises some times, and then does what it was put in the place of."""

    def __init__(self, inner: Callable[..., Any], times: int = 3) -> None:
        self.inner, self.left = inner, times

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        if self.left > 0:
            self.left -= 1
            raise RuntimeError(SECRET)
        return self.inner(*arguments, **named)

    def __get__(self, instance: object, _: type) -> Callable[..., Any]:
        """As a method of a class."""
        return partial(self, instance)


def take_one(camera: MaskedCamera) -> None:
    """Have the mask count a capture, between two self tests."""
    with camera._lock:
        assert camera._panel.active is not None
        camera._panel.active.captures += 1


@pytest.mark.parametrize(
    ("name", "task"),
    [
        ("rotate_if_due", "change of masks"),
        ("await_next", "change of masks"),
        ("due_in", "change of masks"),
        ("test_if_due", "self test"),
        ("test_due_in", "self test"),
        ("healthy", "watchdog"),
    ],
)
async def test_task_that_meets_a_defect_goes_on(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, name: str, task: str
) -> None:
    camera = bench.camera(policy=EveryCaptures(captures=1), test_every=0.01)
    failing = Failing(getattr(camera, name))
    monkeypatch.setattr(camera, name, failing)
    told: list[str] = []
    scheduler, alarms, heard = scheduled(bench, camera, watchdog=0.01, tell=told.append)
    with capture_logs() as logs:
        async with scheduler.running():
            # Again and again: a self test between two of them begins to count anew.
            async def captures_until(done: Callable[[], bool]) -> None:
                while not done():
                    take_one(camera)
                    scheduler.wake()
                    await asyncio.sleep(0.002)

            await captures_until(lambda: failing.left == 0)
            shown, runs, fed = len(bench.epochs), bench.test.runs, len(told)
            await captures_until(lambda: len(bench.epochs) > shown)
            await until(lambda: bench.test.runs > runs and len(told) > fed)
            await until(lambda: alarms.state == ("ready", None, None))
    defects = [entry for entry in logs if entry["event"] == "defect"]
    assert {entry["during"] for entry in defects} == {task}
    degraded = ("degraded", f"a defect in the {task}: it is tried again", "report_defect")
    assert degraded in heard.states
    assert SECRET not in str(logs) + str(heard.events)
    camera.stop()


@pytest.mark.thorough
async def test_policy_that_wants_no_mask_any_more_ends_the_alarm(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = bench.camera(policy=EveryCaptures(captures=1))
    monkeypatch.setattr(camera, "rotate_if_due", Failing(camera.rotate_if_due, 10**9))
    told = Told()
    alarms = Alarms(camera, told)
    scheduler = Scheduler(camera, DeviceQueue(8, lambda _: None), alarms, first_pause=600.0)
    async with scheduler.running():
        camera.capture(release=False).done()
        camera._panel.uncover()  # the opaque frame behind which the answer left
        scheduler.wake()
        await until(lambda: alarms.state.state == "degraded")
        camera.policy = EveryCaptures(captures=100)
        scheduler.wake()
        await until(lambda: alarms.state.state == "ready")
    camera.stop()


async def test_threads_of_queue_preparation_and_inference_outlive_defects(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = bench.camera()
    service = bench.service(camera)
    key = EpochKey.generate(device="d7" * 32, bundle="b0" * 32)
    reader = type(bench.source.make(key, frozenset()).reader)
    async with service.open():
        for place, name in (
            (camera, "capture"),
            (bench.sensor, "capture"),
            (type(bench.source), "make"),
            (reader, "classify"),
        ):
            camera.await_next()
            with monkeypatch.context() as patch:
                failing = Failing(getattr(place, name), 1)
                patch.setattr(place, name, failing)
                if name == "make":
                    camera.preparation.serve(bench.source)
                    with pytest.raises(RuntimeError):
                        await service.rotate()
                else:
                    with pytest.raises(RuntimeError):
                        await service.classify(include_embedding=False)
                assert failing.left == 0
            await service.rotate()
            assert (await service.classify(include_embedding=False)).label in bench.bundle.labels
        assert isinstance(service, Service)


async def test_exception_where_nobody_waits_is_logged_without_its_text(bench: Bench) -> None:
    service = bench.service(bench.camera())
    with capture_logs() as logs:
        async with service.open():
            asyncio.get_running_loop().call_soon(Failing(lambda: None, 1))
            await asyncio.sleep(0)
            await service.classify(include_embedding=False)
    assert [entry["error"] for entry in logs if entry["event"] == "defect"] == ["RuntimeError"]
    assert SECRET not in str(logs)
