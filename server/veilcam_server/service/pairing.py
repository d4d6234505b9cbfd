"""Receivers of a camera that is served: who is added or removed holds from the next epoch on."""

from __future__ import annotations

import asyncio
from collections.abc import Callable

from veilcam_client.wire.sealing import PairedReceiver, ReceiverRequest, Receivers
from veilcam_server.sealing.receivers import ReceiverStore, parse_receiver


class Pairing:
    """Pairing of receivers, for the API.

    Args:
        store: store of the receivers.
        device: public key of the device that seals to them.
        renew: discards the epoch that was prepared for the receivers of before; blocks.
    """

    def __init__(self, store: ReceiverStore, device: str, renew: Callable[[], None]) -> None:
        self._store, self._device, self._renew = store, device, renew

    @property
    def paired(self) -> tuple[PairedReceiver, ...]:
        """Whoever receives from the next epoch on, the oldest first."""
        return self._store.paired

    def all(self) -> Receivers:
        """Every receiver, and the device that seals to them."""
        return Receivers(device=self._device, receivers=self.paired)

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

    # Each on one thread: who breaks off in between leaves no epoch of the receivers of before.
    def _add(self, question: ReceiverRequest) -> PairedReceiver:
        made = self._store.add(question.label, parse_receiver(question.key))
        self._renew()
        return made

    def _remove(self, receiver_id: str) -> None:
        self._store.remove(receiver_id)
        self._renew()
