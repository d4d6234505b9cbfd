"""Receivers: durable before acknowledged, at most eight, and never silently nobody."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from pathlib import Path

import pytest
from tests.unit.server.damage import DAMAGES

from veilcam_client.keys.receivers import Receiver, ReceiverKey
from veilcam_server.errors import (
    ProblemError,
    StorageError,
)
from veilcam_server.sealing.receivers import NAME, ReceiverStore


def some(count: int) -> list[Receiver]:
    return [ReceiverKey.generate().public for _ in range(count)]


@pytest.fixture
def store(tmp_path: Path) -> ReceiverStore:
    return ReceiverStore(tmp_path)


def test_receiver_is_told_and_stays(tmp_path: Path, store: ReceiverStore) -> None:
    assert (len(store.paired), len(store.keys)) == (0, 0)
    assert not list(tmp_path.iterdir())
    first, second = some(2)
    made = [store.add("archive", first), store.add("lamp", second)]
    assert store.paired == tuple(made)
    assert list(store.keys) == [first, second]
    assert [each.id for each in made] == [first.id, second.id]
    assert [each.label for each in made] == ["archive", "lamp"]
    assert all(abs(datetime.now(UTC) - each.added_at) < timedelta(minutes=1) for each in made)
    again = ReceiverStore(tmp_path)
    assert (again.paired, again.keys) == (store.paired, store.keys)
    store.remove(first.id)
    assert store.paired == (made[1],)
    assert store.keys == ReceiverStore(tmp_path).keys == (second,)
    store.remove(second.id)
    emptied = ReceiverStore(tmp_path)
    assert (emptied.paired, emptied.keys, emptied.lost) == ((), (), False)


def test_one_key_is_paired_once_and_unknown_ones_are_said(store: ReceiverStore) -> None:
    (receiver,) = some(1)
    store.add("archive", receiver)
    with pytest.raises(ProblemError, match="paired already"):
        store.add("another label", receiver)
    for unknown in ("0" * 64, "", receiver.id[:-1]):
        with pytest.raises(ProblemError):
            store.remove(unknown)
    assert store.keys == (receiver,)


def test_receivers_are_eight_at_most(store: ReceiverStore) -> None:
    receivers = some(9)
    for receiver in receivers[:8]:
        store.add("one", receiver)
    with pytest.raises(ProblemError, match="8 receivers are paired: remove one first"):
        store.add("one more", receivers[8])
    assert store.keys == tuple(receivers[:8])
    store.remove(receivers[3].id)
    store.add("one more", receivers[8])
    assert store.keys == (*receivers[:3], *receivers[4:])


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_lost_record_is_told_until_somebody_is_paired(
    tmp_path: Path, store: ReceiverStore, damage: Callable[[Path], None]
) -> None:
    faults: list[ProblemError] = []
    store.add("archive", *some(1))
    for end in ("", ".copy"):
        damage(tmp_path / f"{NAME}{end}")
    for _ in range(2):
        again = ReceiverStore(tmp_path, faults.append)
        assert (again.paired, again.keys, again.lost) == ((), (), True)
    assert [fault.code for fault in faults] == ["state_lost"] * 2
    assert "nobody receives any more: pair receivers again" in str(faults[0])
    (receiver,) = some(1)
    again.add("archive", receiver)
    assert not again.lost
    found = ReceiverStore(tmp_path, faults.append)
    assert (found.keys, found.lost, len(faults)) == ((receiver,), False, 2)


def test_receiver_that_the_disk_does_not_take_is_not_acknowledged(
    store: ReceiverStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = some(2)
    store.add("archive", first)

    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as full:
        full.setattr(os, "fsync", refuse)
        for change in (lambda: store.add("lamp", second), lambda: store.remove(first.id)):
            with pytest.raises(StorageError, match="No space left"):
                change()
            assert store.keys == (first,)
    assert store.add("lamp", second).id == second.id


@pytest.mark.parametrize(
    ("field", "value"), [("key", "veilcam-receiver:AAAA"), ("key", 3), ("added_at", "yesterday")]
)
def test_record_that_holds_something_else_is_lost(
    tmp_path: Path, store: ReceiverStore, field: str, value: object
) -> None:
    store.add("archive", *some(1))
    for end in ("", ".copy"):
        path = tmp_path / f"{NAME}{end}"
        serial, record = path.read_bytes().partition(b" ")[2].decode().splitlines()
        changed = json.loads(record)
        changed["receivers"][0][field] = value
        content = f"{serial}\n{json.dumps(changed)}\n".encode()
        path.write_bytes(sha256(content).hexdigest().encode() + b" " + content)
    faults: list[ProblemError] = []
    found = ReceiverStore(tmp_path, faults.append)
    assert (found.keys, found.lost) == ((), True)
    (fault,) = faults
    assert "receivers.json holds another record" in str(fault)
    assert (tmp_path / f"{NAME}.damaged").exists()
