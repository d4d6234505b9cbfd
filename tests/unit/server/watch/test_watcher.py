"""The watch on clocks of its own: when it looks, gives way, rests, and what it tells."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, TypeVar

import pytest
from tests.unit.server.watch.conftest import Look

from veilcam_client.wire.events import Event, Gone, Seen, WatchChanged
from veilcam_client.wire.watch import (
    MOST_SIGHTINGS,
    OnRequest,
    QuietHours,
    Watching,
    WatchOff,
    WatchPolicy,
)
from veilcam_server.camera.engine import Condition
from veilcam_server.devices.errors import DisplayError, SensorError
from veilcam_server.errors import ProblemError, StorageError, UndecidedError, UnsteadyLightError
from veilcam_server.masks.source import Evidence
from veilcam_server.settings import Settings
from veilcam_server.system import clock as clock_of_machine
from veilcam_server.system.clock import MachineClock
from veilcam_server.watch.policy import WatchStore, resting
from veilcam_server.watch.watcher import TICK, Watched, Watcher, WatchSetup, open_watch

pytestmark = pytest.mark.anyio
ResultT = TypeVar("ResultT")

TWICE = Watching(rate_hz=2.0)
NIGHT = QuietHours(begin="22:00", end="07:00")
EVENING = datetime(2026, 6, 1, 21, 59, 50, tzinfo=UTC)


class Camera:
    """Notes what its panel is told."""

    def __init__(self) -> None:
        self.state = Condition("ready")
        self.told = list[str]()
        self.faults = list[ProblemError]()

    def rest(self, reason: str) -> None:
        self.told.append(reason)
        self.state = Condition("off", reason)
        if self.faults:
            raise self.faults.pop()

    def wake(self) -> None:
        self.told.append("wake")
        self.state = Condition("ready")
        if self.faults:
            self.state = Condition("degraded", "too dark")
            raise self.faults.pop()


@dataclass
class Bench:
    """A watch, its clocks, and everything around it within reach."""

    folder: Path
    look: Look
    policy: WatchPolicy = TWICE
    sees: str | None = None
    time: float = 100.0
    wall: datetime = EVENING
    busy: bool = False
    leased: bool = False
    synchronised: bool = True
    fault: Exception | None = None
    during: Callable[[], None] = lambda: None
    free: asyncio.Event = field(default_factory=asyncio.Event)
    """A capture ends once it is set."""
    camera: Camera = field(default_factory=Camera)
    beat: bool = False
    events: list[Event] = field(default_factory=list)
    states: list[tuple[float, Any]] = field(default_factory=list)
    times: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        async def take() -> Evidence:
            self.times.append(self.time)
            await self.free.wait()
            self.during()
            if self.fault is not None:
                raise self.fault
            return self.look(self.sees)

        async def on_device(work: Callable[[], ResultT], *, counted: bool = True) -> ResultT:
            return work()

        self.free.set()
        self.folder.mkdir(exist_ok=True)
        clock = MachineClock(kernel=lambda: self.synchronised)
        self.watcher = Watcher(
            WatchSetup(
                self.policy,
                WatchStore(self.folder, OnRequest()),
                clock,
                rests=resting(self.policy, self.wall, sure=clock.sure()),
                beat=self.beat,
            ),
            Watched(
                self.camera,  # type: ignore[arg-type]
                on_device,
                look=take,
                busy=lambda: self.busy,
                publish=lambda make: self.events.append(make(id="", at=EVENING)),
                tell=lambda state: self.states.append((self.time, state)),
            ),
            clock=lambda: self.time,
            now=lambda: self.wall,
        )
        self.watcher.leased = lambda: self.leased

    async def pass_time(self, seconds: float) -> None:
        """Do whatever is due, as the scheduler does, while so much time passes."""
        end = self.time + seconds
        while True:
            if self.watcher.rest_due_in() <= 0:
                await self.watcher.rest()
            if self.watcher.beat_due_in() <= 0:
                await self.watcher.beat()
            if self.watcher.look_due_in() <= 0:
                try:
                    await self.watcher.look()
                except ProblemError:
                    self.wait(1.0)
            due = min(
                self.watcher.rest_due_in(),
                self.watcher.look_due_in(),
                self.watcher.beat_due_in(),
            )
            if self.time + due > end:
                self.wait(end - self.time)
                return
            self.wait(due)

    def wait(self, seconds: float) -> None:
        self.time += seconds
        self.wall += timedelta(seconds=seconds)

    def told(self, *kinds: type[Any]) -> list[Any]:
        return [event for event in self.events if isinstance(event, kinds)]

    @property
    def activities(self) -> list[str]:
        return [event.activity for event in self.told(WatchChanged)]


@pytest.fixture
def make(tmp_path: Path, look: Look) -> Callable[..., Bench]:
    return lambda **given: Bench(tmp_path / "state", look, **given)


async def test_watcher_looks_as_often_as_it_is_told(make: Callable[..., Bench]) -> None:
    bench = make()
    await bench.pass_time(10.0)
    assert bench.times == [100 + 0.5 * number for number in range(21)]
    state = bench.watcher.state()
    assert (state.activity, state.looks, state.policy) == ("looking", 21, TWICE)
    assert state.belief is not None
    assert (state.belief.label, state.belief.duration_s, state.belief.looks) == (None, 10.0, 21)
    assert bench.events == []


async def test_sights_are_told_with_times_of_the_clock_on_the_wall(
    make: Callable[..., Bench],
) -> None:
    bench = make()
    await bench.pass_time(2.0)
    bench.sees = "a"
    await bench.pass_time(5.0)
    [seen] = bench.events
    assert isinstance(seen, Seen)
    assert (seen.label, seen.duration_s) == ("a", 0.5)
    belief, [there] = bench.watcher.state().belief, bench.watcher.state().history
    assert belief is not None
    assert (belief.label, belief.duration_s) == ("a", 4.5)
    assert (there.label, there.gone_at, there.duration_s) == ("a", None, 4.5)
    bench.sees = None
    await bench.pass_time(3.0)
    gone = bench.events[-1]
    assert isinstance(gone, Gone)
    assert (gone.label, gone.duration_s, gone.reason) == ("a", 5.0, "left")
    [past] = bench.watcher.state().history
    assert past.gone_at is not None
    assert (past.gone_at - past.seen_at).total_seconds() == pytest.approx(5.0, abs=0.1)
    assert past.duration_s == 5.0


async def test_watcher_remembers_so_many_sights_and_labels_alone(
    make: Callable[..., Bench],
) -> None:
    bench = make()
    for number in range(MOST_SIGHTINGS + 3):
        bench.sees = "abc"[number % 3]
        await bench.pass_time(1.5)
        bench.sees = None
        await bench.pass_time(1.5)
    state = bench.watcher.state()
    assert len(state.history) == MOST_SIGHTINGS
    assert set(state.history[0].model_dump()) == {
        *("label", "confidence", "seen_at", "gone_at", "duration_s"),
    }


async def test_caller_s_capture_goes_first(make: Callable[..., Bench]) -> None:
    bench = make(sees="a")
    await bench.pass_time(2.0)
    looks, bench.busy = len(bench.times), True
    await bench.pass_time(2.9)
    assert len(bench.times) == looks
    # A short while is not worth telling of, and what is seen stays.
    assert bench.events == bench.told(Seen)
    bench.busy = False
    await bench.pass_time(0.1)
    assert len(bench.times) == looks + 1
    bench.busy = True
    await bench.pass_time(4.0)
    assert bench.activities == ["waiting"]
    assert bench.watcher.state().detail == "others take captures all the time"


async def test_watcher_waits_while_somebody_holds_the_camera(make: Callable[..., Bench]) -> None:
    bench = make(sees="a")
    await bench.pass_time(2.0)
    looks, bench.leased = len(bench.times), True
    await bench.pass_time(60.0)
    assert len(bench.times) == looks
    [gone] = bench.told(Gone)
    assert (gone.label, gone.reason, gone.confidence, gone.duration_s) == (
        *("a", "not_looking", None),
        2.0,
    )
    assert bench.watcher.state().belief is None
    bench.leased = False
    await bench.pass_time(2.0)
    assert bench.activities == ["leased", "looking"]
    assert [event.label for event in bench.told(Seen)] == ["a", "a"]


@pytest.mark.parametrize("state", ["starting", "self-test", "calibrating", "degraded", "safe"])
async def test_camera_that_is_not_ready_is_not_asked(
    make: Callable[..., Bench], state: Any
) -> None:
    bench = make(sees="a")
    await bench.pass_time(2.0)
    looks, bench.camera.state = len(bench.times), Condition(state, "something is wrong")
    await bench.pass_time(10.0)
    assert len(bench.times) == looks
    assert bench.activities == ["waiting"]
    assert bench.watcher.state().detail == "something is wrong"
    assert bench.told(Gone)[0].reason == "not_looking"


async def test_short_self_test_changes_nothing(make: Callable[..., Bench]) -> None:
    bench = make(sees="a")
    await bench.pass_time(2.0)
    bench.camera.state = Condition("self-test")
    await bench.pass_time(1.5)
    bench.camera.state = Condition("ready")
    await bench.pass_time(2.0)
    assert bench.events == bench.told(Seen)
    assert len(bench.events) == 1


async def test_captures_that_fail_are_told_of_as_missing_and_raised(
    make: Callable[..., Bench],
) -> None:
    bench = make(sees="a")
    await bench.pass_time(2.0)
    bench.fault = SensorError("no frame came")
    with pytest.raises(SensorError):
        await bench.watcher.look()
    assert bench.watcher.look_due_in() == 0  # the scheduler makes the pause, which grows
    await bench.pass_time(10.0)
    assert bench.activities == ["waiting"]
    assert bench.watcher.state().detail == "no frame came"
    bench.fault = None
    await bench.pass_time(2.0)
    assert bench.activities == ["waiting", "looking"]


async def test_quiet_hours_make_the_panel_opaque(make: Callable[..., Bench]) -> None:
    bench = make(policy=Watching(rate_hz=2.0, quiet=NIGHT), sees="a")
    await bench.pass_time(9.0)
    assert bench.camera.told == []
    looks = len(bench.times)
    await bench.pass_time(1.0 + TICK)
    reason = "the camera does not look between 22:00 and 07:00"
    assert bench.camera.told == [reason]
    assert bench.told(Gone)[0].reason == "not_looking"
    await bench.pass_time(9 * 3600 - 2 * TICK)
    assert looks <= len(bench.times) <= looks + 2
    assert (bench.watcher.state().activity, bench.watcher.state().detail) == ("quiet", reason)
    assert bench.watcher.look_due_in() == math.inf
    await bench.pass_time(2 * TICK + 2.0)
    assert bench.camera.told == [reason, "wake"]
    assert bench.activities == ["quiet", "looking"]
    assert [event.label for event in bench.told(Seen)] == ["a", "a"]


async def test_quiet_hours_wait_for_a_clock_that_is_synchronised(
    make: Callable[..., Bench],
) -> None:
    bench = make(policy=Watching(rate_hz=2.0, quiet=NIGHT), synchronised=False)
    bench.wall -= timedelta(hours=6)
    await bench.pass_time(5.0)
    state = bench.watcher.state()
    assert (state.activity, state.looks) == ("quiet", 0)
    assert state.detail is not None
    assert state.detail.startswith("the clock is not synchronised yet")
    assert "set-ntp true" in state.detail
    assert "--trust-clock" in state.detail
    assert state.clock is not None
    assert not state.clock.synchronised
    # Without quiet hours there is no clock to wait for.
    await bench.watcher.set_policy(TWICE)
    assert bench.watcher.state().activity == "looking"
    await bench.watcher.set_policy(OnRequest(quiet=NIGHT))
    assert bench.watcher.state().activity == "quiet"
    bench.synchronised = True
    await bench.pass_time(TICK)
    assert bench.watcher.state().activity == "on_request"
    # Once it was right, a network that is gone for a day makes nobody blind.
    bench.synchronised = False
    await bench.pass_time(60.0)
    assert bench.watcher.state().activity == "on_request"


@pytest.mark.parametrize(
    ("given", "rests"),
    [
        ({"quiet_hours": "3-3:01"}, True),
        ({"quiet_hours": "3-3:01", "trust_clock": True}, False),
        ({"quiet_hours": "3-3:01", "device": "simulated"}, False),
        ({}, False),
    ],
)
async def test_start_with_quiet_hours_is_opaque_until_the_clock_is_right(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, given: dict[str, Any], *, rests: bool
) -> None:
    monkeypatch.setattr(clock_of_machine, "kernel_synchronised", lambda: False)
    monkeypatch.setattr(MachineClock, "now", lambda _: EVENING)
    settings = Settings(**{"bundle": Path("a.veilcam"), "state_dir": tmp_path, **given})
    setup = open_watch(settings, None, lambda _: None)
    assert (setup.rests is not None) == rests


async def test_without_quiet_hours_nothing_wakes_the_daemon(make: Callable[..., Bench]) -> None:
    for policy in (OnRequest(), WatchOff()):
        bench = make(policy=policy)
        assert (bench.watcher.rest_due_in(), bench.watcher.look_due_in()) == (math.inf, math.inf)
    assert make(policy=OnRequest(quiet=NIGHT)).watcher.rest_due_in() == TICK


async def test_quiet_hours_hold_for_who_asks_too(make: Callable[..., Bench]) -> None:
    bench = make(policy=OnRequest(quiet=NIGHT))
    await bench.pass_time(10.0 + TICK)
    assert len(bench.camera.told) == 1
    assert bench.times == []
    assert bench.activities == ["quiet"]


async def test_off_is_opaque_before_it_is_answered(make: Callable[..., Bench]) -> None:
    bench = make(sees="a")
    await bench.pass_time(2.0)
    state = await bench.watcher.set_policy(WatchOff())
    assert bench.camera.told == ["the camera is switched off"]
    assert (state.activity, state.belief) == ("off", None)
    assert [type(event) for event in bench.events] == [Seen, Gone, WatchChanged]
    looks = len(bench.times)
    await bench.pass_time(3600.0)
    assert len(bench.times) == looks
    assert len(bench.camera.told) == 1
    await bench.watcher.set_policy(TWICE)
    assert bench.camera.told[1:] == ["wake"]
    await bench.pass_time(1.0)
    assert len(bench.times) == looks + 3
    assert WatchStore(bench.folder, OnRequest()).at_start() == TWICE


async def test_look_under_way_when_it_is_switched_off_is_not_told(
    make: Callable[..., Bench],
) -> None:
    bench = make(sees=None)
    await bench.pass_time(1.0)
    bench.sees = "a"
    bench.wait(0.5)
    await bench.watcher.look()
    bench.free.clear()
    look = asyncio.create_task(bench.watcher.look())
    await bench.watcher.set_policy(WatchOff())
    bench.free.set()
    await look
    assert bench.told(Seen) == []
    assert bench.watcher.state().belief is None
    assert bench.watcher.state().looks == 4


async def test_look_under_way_when_quiet_hours_begin_is_not_told(
    make: Callable[..., Bench],
) -> None:
    bench = make(policy=Watching(rate_hz=2.0, quiet=NIGHT))
    await bench.pass_time(1.0)
    bench.sees = "a"
    bench.wait(0.5)
    await bench.watcher.look()
    bench.during = lambda: bench.wait(60.0)
    await bench.watcher.look()
    assert bench.told(Seen) == []
    assert bench.watcher.state().looks == 4


async def test_on_request_it_does_not_look_by_itself(make: Callable[..., Bench]) -> None:
    bench = make(policy=OnRequest())
    await bench.pass_time(3600.0)
    assert (bench.times, bench.camera.told, bench.events) == ([], [], [])
    state = bench.watcher.state()
    assert (state.activity, state.belief, state.history) == ("on_request", None, ())


async def test_daemon_that_starts_off_stays_off_and_can_be_switched_on(
    make: Callable[..., Bench],
) -> None:
    bench = make(policy=WatchOff())
    await bench.pass_time(60.0)
    assert bench.camera.told == []  # it was opaque from the start
    assert bench.watcher.state().activity == "off"
    await bench.watcher.set_policy(OnRequest())
    assert bench.camera.told == ["wake"]


async def test_quiet_hours_that_end_before_it_runs_end(make: Callable[..., Bench]) -> None:
    bench = make(policy=OnRequest(quiet=NIGHT), wall=EVENING + timedelta(hours=3))
    bench.wait(8 * 3600.0)
    await bench.pass_time(1.0)
    assert bench.camera.told == ["wake"]


async def test_panel_that_does_not_become_opaque_is_told_and_stays_wanted(
    make: Callable[..., Bench],
) -> None:
    bench = make()
    bench.camera.faults.append(DisplayError("its cable is off"))
    with pytest.raises(DisplayError):
        await bench.watcher.set_policy(WatchOff())
    assert bench.watcher.policy == WatchOff()
    assert bench.watcher.state().activity == "off"
    assert WatchStore(bench.folder, OnRequest()).at_start() == WatchOff()
    assert bench.watcher.look_due_in() == math.inf


async def test_room_that_is_too_dark_to_begin_is_no_reason_to_refuse(
    make: Callable[..., Bench],
) -> None:
    bench = make(policy=WatchOff())
    bench.camera.faults.append(UndecidedError("too dark"))
    state = await bench.watcher.set_policy(TWICE)
    assert state.policy == TWICE
    await bench.pass_time(10.0)
    assert bench.watcher.state().activity == "waiting"
    assert bench.watcher.state().detail == "too dark"


async def test_policy_that_cannot_be_kept_does_not_hold(make: Callable[..., Bench]) -> None:
    bench = make()
    bench.folder.rmdir()
    with pytest.raises(StorageError):
        await bench.watcher.set_policy(OnRequest())
    assert bench.watcher.policy == TWICE
    assert bench.camera.told == []
    assert bench.events == []


async def test_full_disk_keeps_nobody_from_switching_it_off(make: Callable[..., Bench]) -> None:
    bench = make()
    bench.folder.rmdir()
    with pytest.raises(StorageError, match="off until a restart"):
        await bench.watcher.set_policy(WatchOff())
    assert bench.watcher.state().activity == "off"
    assert bench.camera.told == ["the camera is switched off"]


async def test_policy_is_told_of_once_and_only_if_it_changes(make: Callable[..., Bench]) -> None:
    bench = make()
    await bench.watcher.set_policy(TWICE)
    assert bench.events == []
    await bench.watcher.set_policy(Watching(rate_hz=1.0))
    [event] = bench.told(WatchChanged)
    assert (event.policy.rate_hz, event.activity) == (1.0, "looking")


async def test_looks_that_take_long_do_not_pile_up(make: Callable[..., Bench]) -> None:
    bench = make()
    bench.during = lambda: bench.wait(1.7)
    await bench.pass_time(6.0)
    assert [now - 100 for now in bench.times] == pytest.approx([0, 1.7, 3.4, 5.1])


async def test_state_is_told_at_fixed_times_whatever_is_seen(make: Callable[..., Bench]) -> None:
    bench = make(beat=True)
    told = list[tuple[str | None, str | None]]()
    for sees in (None, "a", "b", None):
        bench.sees = sees
        await bench.pass_time(3.0)
        belief, sighting = bench.states[-1][1].belief, bench.states[-1][1].sighting
        told.append((belief and belief.label, sighting and sighting.label))
    times = [time for time, _ in bench.states if time % 0.5 == 0]
    assert sorted(set(times)) == [100 + 0.5 * number for number in range(25)]
    assert bench.told(Seen, Gone) == []
    assert [state.id for _, state in bench.states] == [""] * len(bench.states)
    assert told == [(None, None), ("a", "a"), ("b", "b"), (None, None)]
    bench.states.clear()
    await bench.watcher.set_policy(OnRequest())
    await bench.pass_time(5.0)
    # The last one says that the camera looks no longer.
    assert [state.belief for _, state in bench.states] == [None]


async def test_state_of_a_look_is_told_at_the_next_tick(make: Callable[..., Bench]) -> None:
    bench = make(beat=True, sees="a")
    await bench.pass_time(0.4)
    assert [state.belief for _, state in bench.states] == [None]
    await bench.pass_time(0.1)
    (_, state) = bench.states[-1]
    assert (state.belief.label, state.belief.looks) == ("a", 1)


async def test_look_at_changing_light_is_missed_and_raises_no_alarm(
    make: Callable[..., Bench],
) -> None:
    bench = make(sees="a")
    await bench.pass_time(2.0)
    bench.fault = UnsteadyLightError("the light changed: try again")
    await bench.pass_time(4.0)
    assert bench.times == [100 + 0.5 * number for number in range(13)]
    assert bench.activities == ["waiting"]
    bench.fault = None
    await bench.pass_time(1.0)
    assert bench.activities == ["waiting", "looking"]
