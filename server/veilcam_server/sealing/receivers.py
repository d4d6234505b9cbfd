"""Receivers that this device is paired with; a change of them holds from the next epoch on."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from pydantic import AwareDatetime, BaseModel, ConfigDict, Field, field_validator

from veilcam_client.keys.receivers import Receiver
from veilcam_client.wire.sealing import MOST_RECEIVERS, PairedReceiver, ReceiverRequest, Receivers
from veilcam_server.errors import ProblemError
from veilcam_server.system.state_file import Report, StateStore, log_fault

NAME = "receivers.json"
"""Of the record in the state directory."""


class _Paired(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)
    label: str
    key: str
    """``veilcam-receiver:BASE64``."""
    added_at: AwareDatetime

    @field_validator("key")
    @classmethod
    def _a_key(cls, key: str) -> str:
        Receiver.parse(key)
        return key

    @property
    def receiver(self) -> Receiver:
        return Receiver.parse(self.key)

    def told(self) -> PairedReceiver:
        return PairedReceiver(id=self.receiver.id, label=self.label, added_at=self.added_at)


class _Receivers(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)
    receivers: tuple[_Paired, ...] = Field(max_length=MOST_RECEIVERS)


class ReceiverStore:
    """``DIRECTORY/receivers.json``, changed by one process and any of its threads.

    Args:
        directory: the daemon's state directory.
        report: takes what was damaged.

    Raises:
        StartError: the record cannot be read.
    """

    def __init__(self, directory: Path, report: Report = log_fault) -> None:
        self._file = StateStore(
            directory / NAME,
            _Receivers,
            lost="nobody receives any more: pair receivers again with 'veilcam receiver add'",
            report=report,
        )
        self._lock = threading.Lock()
        self._take(self._file.read() or _Receivers(receivers=()))

    @property
    def paired(self) -> tuple[PairedReceiver, ...]:
        """Whoever receives from the next epoch on, the oldest first."""
        return self._told

    @property
    def keys(self) -> tuple[Receiver, ...]:
        """Their public keys, in the same order."""
        return self._keys

    @property
    def lost(self) -> bool:
        """Return whether the record of the receivers, or of their absence, is lost."""
        return self._file.lost

    def add(self, label: str, receiver: Receiver) -> PairedReceiver:
        """Pair with a receiver; it is on the disk at return.

        Args:
            label: label for people.
            receiver: public key of the receiver.

        Raises:
            ProblemError: it is paired already, or there are as many as there may be.
            StorageError: the disk does not take it.
        """
        made = _Paired(label=label, key=str(receiver), added_at=datetime.now(UTC))
        with self._lock:
            if receiver in self._keys:
                raise ProblemError("conflict", "this key is paired already: see GET /v1/receivers")
            if len(self._keys) == MOST_RECEIVERS:
                raise ProblemError(
                    "conflict", f"{MOST_RECEIVERS} receivers are paired: remove one first"
                )
            held = _Receivers(receivers=(*self._record.receivers, made))
            self._take(self._file.change(lambda _: held))
        return made.told()

    def remove(self, receiver_id: str) -> None:
        """Seal nothing more to a receiver; that is on the disk at return.

        Raises:
            ProblemError: there is none of this id.
            StorageError: the disk does not take it.
        """
        with self._lock:
            pairs = zip(self._record.receivers, self._told, strict=True)
            left = tuple(each for each, told in pairs if told.id != receiver_id)
            if len(left) == len(self._told):
                raise ProblemError(
                    "not_found", "there is no receiver of this id: see GET /v1/receivers"
                )
            held = _Receivers(receivers=left)
            self._take(self._file.change(lambda _: held))

    def _take(self, record: _Receivers) -> None:
        # Each is replaced whole: who looks from another thread sees one of the two records.
        self._record = record
        self._told = tuple(each.told() for each in record.receivers)
        self._keys = tuple(each.receiver for each in record.receivers)


def parse_receiver(text: str) -> Receiver:
    """Read a receiver's public key; raises :class:`ProblemError`."""
    try:
        return Receiver.parse(text)
    except ValueError as error:
        raise ProblemError("invalid_request", str(error)) from None


class Pairing:
    """Pairing of receivers, for the API.

    Args:
        store: store of the receivers.
        device: public key of the device that seals to them.
        renew: discards the epoch that was prepared for the receivers of before; blocks.
    """

    def __init__(self, store: ReceiverStore, device: str, renew: Callable[[], None]) -> None:
        self.device, self.renew = device, renew
        self._store = store

    @property
    def paired(self) -> tuple[PairedReceiver, ...]:
        """Whoever receives from the next epoch on, the oldest first."""
        return self._store.paired

    def all(self) -> Receivers:
        """Every receiver, and the device that seals to them."""
        return Receivers(device=self.device, receivers=self.paired)

    async def add(self, question: ReceiverRequest) -> PairedReceiver:
        """Pair with a receiver.

        Raises:
            ProblemError: it is no receiver's key.
            ProblemError, StorageError: as
                :meth:`ReceiverStore.add`.
        """
        return await asyncio.to_thread(self._add, question)

    async def remove(self, receiver_id: str) -> None:
        """Seal nothing more to a receiver; raises as :meth:`ReceiverStore.remove`."""
        await asyncio.to_thread(self._remove, receiver_id)

    def pair(self, question: ReceiverRequest) -> PairedReceiver:
        """Pair with a receiver as :meth:`add`, on this thread; ``renew`` has to follow."""
        return self._store.add(question.label, parse_receiver(question.key))

    # Each on one thread: who breaks off in between leaves no epoch of the receivers of before.
    def _add(self, question: ReceiverRequest) -> PairedReceiver:
        made = self.pair(question)
        self.renew()
        return made

    def _remove(self, receiver_id: str) -> None:
        self._store.remove(receiver_id)
        self.renew()
