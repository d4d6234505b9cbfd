"""Epochs made ready in the background: no needless wait, no mask reused beyond the policy."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Iterator
from typing import TYPE_CHECKING

import pytest

from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.wire.rotation import EveryCaptures, EverySeconds, RotationPolicy
from veilcam_server.camera import epochs as preparation_module
from veilcam_server.camera.camera import MaskedCamera
from veilcam_server.devices import DisplayError
from veilcam_server.errors import NotReadyError
from veilcam_server.masks.source import Mask, MaskSource

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench, Running


class Gated:
    """A source whose next mask is ready when a test says so."""

    def __init__(self, source: MaskSource) -> None:
        self._source = source
        self.gate = threading.Event()
        self.gate.set()
        self.keys: list[bytes] = []
        self.drawn: list[EpochKey] = []
        self.avoided: list[frozenset[str]] = []
        self.threads: set[str] = set()
        self.fault: Exception | None = None

    @property
    def renewable(self) -> bool:
        return self._source.renewable

    @property
    def bundle(self) -> str:
        return self._source.bundle

    @property
    def marks(self) -> frozenset[str]:
        return self._source.marks

    def make(self, key: EpochKey, avoid: frozenset[str]) -> Mask:
        assert self.gate.wait(200)
        self.keys.append(bytes(key.reveal()))
        self.drawn.append(key)
        self.avoided.append(avoid)
        self.threads.add(threading.current_thread().name)
        if self.fault is not None:
            raise self.fault
        return self._source.make(key, avoid)


@pytest.fixture
def gated(bench: Bench) -> Iterator[Gated]:
    source = Gated(bench.source)
    bench.source = source
    yield source
    source.gate.set()


def settled(camera: MaskedCamera) -> MaskedCamera:
    """Wait for the preparation under way."""
    deadline = time.monotonic() + 200
    while camera.preparation.under_way:
        assert time.monotonic() < deadline
        time.sleep(0.001)
    return camera


def held(bench: Bench, gated: Gated, policy: RotationPolicy) -> MaskedCamera:
    """A camera whose first mask is due and whose second is not ready."""
    camera = settled(bench.camera())
    gated.gate.clear()
    camera.rotate()
    camera.policy = policy
    camera.capture(release=False)
    return camera


def test_next_epoch_is_made_ready_while_this_one_is_in_use(bench: Bench, gated: Gated) -> None:
    camera = settled(bench.camera(policy=EveryCaptures(captures=1)))
    assert camera.preparation.ready
    assert (camera.preparation.count, len(gated.keys)) == (2, 2)
    assert camera.preparation.took > 0
    gated.gate.clear()  # nothing of what follows may need another one
    camera.capture(release=False)
    camera.capture(release=False)
    assert camera.present == (bench.epochs[1], 1)
    assert (camera.lateness.late, camera.lateness.reused) == (0, 0)


def test_before_the_first_none_took_any_time(bench: Bench) -> None:
    with contextlib.closing(bench.preparation()) as preparation:
        assert (preparation.count, preparation.took) == (0, 0.0)


def test_nothing_is_prepared_after_the_end(bench: Bench) -> None:
    preparation = bench.preparation()
    preparation.close()
    preparation.close()
    with pytest.raises(RuntimeError, match="after shutdown"):
        preparation.begin()


def test_prepared_epoch_tells_nobody_its_mask(bench: Bench) -> None:
    with contextlib.closing(bench.preparation()) as preparation:
        prepared = preparation.take()
    assert prepared.name in repr(prepared)
    assert "mask" not in repr(prepared)


def test_dump_of_threads_names_the_one_that_prepares(bench: Bench, gated: Gated) -> None:
    settled(bench.camera())
    assert gated.threads == {"preparation_0"}


def test_late_and_told_to_wait(bench: Bench, gated: Gated) -> None:
    camera = held(bench, gated, EveryCaptures(captures=1))
    taken: list[str] = []
    waiting = threading.Thread(target=lambda: taken.append(camera.capture(release=False).epoch))
    waiting.start()
    while not camera.lateness.late:
        time.sleep(0.001)
    waiting.join(0.05)
    assert waiting.is_alive()
    assert not taken
    gated.gate.set()
    waiting.join(200)
    assert taken == [bench.epochs[2]]
    assert (camera.lateness.late, camera.lateness.reused) == (1, 0)


def test_late_and_told_to_reuse_but_no_more_often_than_that(bench: Bench, gated: Gated) -> None:
    camera = held(bench, gated, EveryCaptures(captures=1, reuse=2))
    assert [camera.capture(release=False).epoch for _ in range(2)] == [bench.epochs[1]] * 2
    assert (camera.lateness.late, camera.lateness.reused) == (1, 2)
    taken: list[str] = []
    waiting = threading.Thread(target=lambda: taken.append(camera.capture(release=False).epoch))
    waiting.start()
    waiting.join(0.05)
    assert waiting.is_alive()
    gated.gate.set()
    waiting.join(200)
    assert taken == [bench.epochs[2]]
    assert (camera.lateness.late, camera.lateness.reused) == (1, 2)


def test_mask_that_is_due_by_time_may_be_reused_too(bench: Bench, gated: Gated) -> None:
    camera = held(bench, gated, EverySeconds(seconds=0.1, reuse=1))
    while camera.due_in() > 0:
        time.sleep(0.01)
    assert camera.capture(release=False).epoch == bench.epochs[1]
    assert (camera.lateness.late, camera.lateness.reused) == (1, 1)


def test_nothing_is_late_that_nobody_waits_for(bench: Bench, gated: Gated) -> None:
    camera = held(bench, gated, EveryCaptures(captures=1))
    camera.rotate_if_due()  # returns at once
    assert camera.present == (bench.epochs[1], 1)
    assert camera.lateness.late == 0


def test_preparation_that_fails_is_not_a_licence_to_reuse(bench: Bench, gated: Gated) -> None:
    camera = held(bench, gated, EveryCaptures(captures=1, reuse=100))
    gated.fault = RuntimeError("no decoder")
    gated.gate.set()
    settled(camera)
    captures = bench.sensor.captures
    for _ in range(2):
        with pytest.raises(RuntimeError, match="no decoder"):
            camera.capture(release=False)
    assert bench.sensor.captures == captures
    assert not camera.preparation.ready
    gated.fault = None
    assert camera.capture(release=False).epoch == bench.epochs[2]


def test_every_mask_has_an_epoch_of_its_own_even_if_it_failed(
    bench: Bench, gated: Gated, display_fault: DisplayError
) -> None:
    camera = bench.camera()
    for fault in (None, display_fault, None, None):
        bench.display.faults = [fault] if fault else []
        with contextlib.suppress(DisplayError):
            camera.rotate()
    settled(camera)
    assert len(set(gated.keys)) == len(gated.keys) == 6
    assert len(set(bench.epochs)) == 4


def test_wait_without_end_is_ended(
    bench: Bench, gated: Gated, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = held(bench, gated, EveryCaptures(captures=1))
    monkeypatch.setattr(preparation_module, "LONGEST", 0.01)
    with pytest.raises(NotReadyError, match="still being prepared"):
        camera.capture(release=False)
    gated.gate.set()
    settled(camera)
    assert camera.capture(release=False).epoch == bench.epochs[2]


def test_panel_is_not_blanked_before_a_preparation_has_ended(bench: Bench, gated: Gated) -> None:
    camera = held(bench, gated, EveryCaptures(captures=1))
    stopping = threading.Thread(target=camera.stop)
    stopping.start()
    gated.gate.set()
    stopping.join(200)
    assert not stopping.is_alive()
    assert not bench.display.shown[-1].any()


@pytest.mark.anyio
async def test_status_says_so(running: Running, bench: Bench, gated: Gated) -> None:
    import asyncio

    async with running(policy=EveryCaptures(captures=1, reuse=1)) as client:

        async def preparation() -> dict[str, object]:
            answer: dict[str, object] = (await client.get("/v1/rotation")).json()["preparation"]
            return answer

        while not (await preparation())["ready"]:
            await asyncio.sleep(0.01)
        gated.gate.clear()
        first = (await client.post("/v1/captures")).json()["epoch"]
        while len(bench.epochs) < 2:
            await asyncio.sleep(0.01)
        epochs = [(await client.post("/v1/captures")).json()["epoch"] for _ in range(2)]
        assert epochs == [bench.epochs[1]] * 2
        assert first == bench.epochs[0]
        told = await preparation()
        assert (told["ready"], told["prepared"], told["late"], told["reused"]) == (False, 2, 1, 1)
        gated.gate.set()
        # Nobody captures now; the mask is changed as soon as the next is ready.
        while len(bench.epochs) < 3:
            await asyncio.sleep(0.01)


def test_preparing_takes_no_time_of_the_panel_s_lock(bench: Bench, gated: Gated) -> None:
    camera = held(bench, gated, EveryCaptures(captures=9))
    assert camera.preparation.under_way
    assert [camera.capture(release=False).epoch for _ in range(3)] == [bench.epochs[1]] * 3


def test_waiter_for_a_preparation_is_let_go_when_it_is_called_off(
    bench: Bench, gated: Gated
) -> None:
    preparation = bench.preparation()
    gated.gate.clear()

    def first() -> None:
        preparation.first_of(gated)

    # One is being made, the next stands in line behind it, and somebody waits for that.
    busy = threading.Thread(target=first)
    busy.start()
    deadline = time.monotonic() + 200
    while preparation._thread._work_queue.qsize() or not preparation._thread._threads:
        assert time.monotonic() < deadline
        time.sleep(0.001)
    preparation.begin()
    waiting = threading.Thread(target=preparation.wait, daemon=True)
    waiting.start()
    closing = threading.Thread(target=preparation.close)
    closing.start()
    waiting.join(200)
    gated.gate.set()
    for thread in (busy, closing, waiting):
        thread.join(200)
        assert not thread.is_alive()
