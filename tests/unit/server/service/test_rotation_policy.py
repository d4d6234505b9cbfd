"""A rotation policy that was set holds after a restart, until the daemon is told otherwise."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.unit.server.damage import DAMAGES

from veilcam_client.wire.events import Event, RotationChanged
from veilcam_client.wire.rotation import (
    EveryCaptures,
    EverySeconds,
    Rotation,
    RotationOff,
    RotationPolicy,
)
from veilcam_server.errors import ProblemError, RotationImpossibleError, StorageError
from veilcam_server.service.rotation_policy import PolicyStore

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench

OFF, OFTEN = RotationOff(), EveryCaptures(captures=1)
SELDOM = EverySeconds(seconds=30.0, jitter=2.0)


class Rig:
    """One start after the other on the same directory."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.faults: list[ProblemError] = []

    def open(self, given: RotationPolicy | None = None) -> PolicyStore:
        return PolicyStore(self.directory, given, self.faults.append)

    def start(
        self,
        given: RotationPolicy | None = None,
        *,
        renewable: bool = True,
        configured: bool = True,
        default: RotationPolicy = OFF,
    ) -> RotationPolicy:
        self.faults.clear()
        store = self.open(given)
        return store.at_start(given or default, renewable=renewable, configured=configured)


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return Rig(tmp_path)


@pytest.mark.parametrize("policy", [OFF, OFTEN, SELDOM])
def test_policy_holds_after_a_restart(rig: Rig, policy: RotationPolicy) -> None:
    assert rig.start() == OFF
    assert rig.start(default=OFTEN) == OFTEN
    rig.open().set(OFTEN)
    rig.open().set(policy)
    assert rig.start() == rig.start(default=OFTEN) == policy
    assert not rig.faults


def test_another_setting_at_the_start_ends_what_was_set(rig: Rig) -> None:
    rig.open(OFTEN).set(SELDOM)
    assert rig.start(OFTEN) == SELDOM
    assert rig.start(EveryCaptures(captures=2)) == EveryCaptures(captures=2)
    assert rig.start(default=OFF) == OFF
    # Nothing was set since then.
    assert rig.start(OFTEN) == SELDOM
    assert not rig.faults


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_lost_record_is_told_and_the_setting_holds(
    rig: Rig, damage: Callable[[Path], None]
) -> None:
    rig.open().set(OFF)
    for name in ("rotation.json", "rotation.json.copy"):
        damage(rig.directory / name)
    assert rig.start(default=OFTEN) == OFTEN
    (fault,) = rig.faults
    assert fault.code == "state_lost"
    assert "masks change as the daemon was told at its start; set it again" in str(fault)


def test_lone_mask_stays_and_no_start_is_refused_for_the_state(rig: Rig) -> None:
    """The bundle of before is damaged, and what is left has one mask."""
    rig.open().set(OFTEN)
    assert rig.start(renewable=False) == OFF
    (fault,) = rig.faults
    assert isinstance(fault, RotationImpossibleError)
    assert "holds one mask only, which stays: activate another bundle" in str(fault)
    rig.open().set(OFF)
    assert rig.start(renewable=False) == OFF
    assert not rig.faults


def test_lone_mask_in_use_under_a_lost_policy_stays(rig: Rig) -> None:
    assert rig.start(OFTEN, renewable=False, configured=False) == OFF
    assert [fault.code for fault in rig.faults] == ["conflict"]
    assert rig.start(OFTEN, renewable=True, configured=False) == OFTEN


def test_settings_that_do_not_fit_together_are_left_to_the_start(rig: Rig) -> None:
    assert rig.start(OFTEN, renewable=False) == OFTEN
    assert not rig.faults


@pytest.mark.anyio
async def test_policy_is_durable_before_the_answer_or_not_in_use(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    service = bench.service(bench.camera())
    bench.state_dir.mkdir(exist_ok=True)
    store = service._policies = PolicyStore(bench.state_dir, None)
    heard: list[Event] = []
    service._events.subscribe(heard.append)

    def fail(policy: RotationPolicy) -> None:
        raise StorageError("the disk is full")

    async with service.open():
        answer = await service.set_policy(OFTEN)
        assert answer.policy == service.rotation().policy == OFTEN
        assert store.at_start(OFF, renewable=True, configured=True) == OFTEN
        with monkeypatch.context() as patch:
            patch.setattr(store, "set", fail)
            with pytest.raises(StorageError):
                await service.set_policy(SELDOM)
        assert service.rotation().policy == OFTEN
        # Of two that are set at once, the one that is in use is the one on the disk.
        both = await asyncio.gather(service.set_policy(SELDOM), service.set_policy(OFF))
        assert all(isinstance(each, Rotation) for each in both)
        now = service.rotation().policy
        assert store.at_start(OFTEN, renewable=True, configured=True) == now == OFF
    told = [event.policy for event in heard if isinstance(event, RotationChanged)]
    assert told == [OFTEN, SELDOM, OFF]


@pytest.mark.anyio
async def test_policy_that_needs_another_mask_is_not_recorded(lone_bench: Bench) -> None:
    service = lone_bench.service(lone_bench.camera())
    service._policies = PolicyStore(lone_bench.state_dir, None)
    async with service.open():
        with pytest.raises(RotationImpossibleError):
            await service.set_policy(OFTEN)
        assert service.rotation().policy == OFF
    assert not list(lone_bench.state_dir.glob("rotation*"))
