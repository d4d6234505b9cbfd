"""Witness of the sealed embeddings of one device, over all its lives."""

from __future__ import annotations

import hashlib
from collections.abc import Hashable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from veilcam_client.errors import SealedError
from veilcam_client.keys.blocks import Opener
from veilcam_client.keys.envelopes import open_key
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.captures import Capture, SealedEmbedding


@dataclass
class Life:
    """Epochs that a daemon announced between a start and an end, and embeddings that it gave."""

    told: list[str] = field(default_factory=list)
    taken: list[Capture] = field(default_factory=list)


class Witness:
    def __init__(self, key: ReceiverKey) -> None:
        self._key, self._opener = key, Opener(key)
        self._seen: set[tuple[str, Hashable]] = set()
        self._values: dict[str, npt.NDArray[np.float32]] = {}
        self.names: set[str] = set()
        self.opened = 0
        self.repeated: list[str] = []
        self.unopened: list[str] = []
        self.mixed: list[str] = []

    def see(self, life: Life) -> None:
        answers = sorted(life.taken, key=lambda answer: (answer.epoch, answer.number))
        taken = {answer.epoch: answer for answer in answers}
        for name in (*life.told, *(taken.keys() - set(life.told))):
            self.names.add(name)
            self._once("name", name)
        for answer in taken.values():
            self._once("sealing key", self._sealing_key(answer))
        for answer in answers:
            self._once("number", (answer.epoch, answer.number))
            self._open(answer)

    def _once(self, kind: str, what: Hashable) -> None:
        if (kind, what) in self._seen:
            self.repeated.append(kind)
        self._seen.add((kind, what))

    def _sealing_key(self, answer: Capture) -> str:
        """Return a digest of the key, or the epoch's name if the key cannot be had."""
        try:
            assert isinstance(answer.embedding, SealedEmbedding)
            key = open_key(answer.embedding.envelope, self._key, device=None)
        except (AssertionError, SealedError):
            return answer.epoch
        return hashlib.sha256(key.sealing()).hexdigest()

    def _open(self, answer: Capture) -> None:
        if not isinstance(answer.embedding, SealedEmbedding):
            self.unopened.append("not sealed")
            return
        try:
            values = np.asarray(self._opener.open(answer).embedding)
        except SealedError as error:
            self.unopened.append(str(error))
            return
        self.opened += 1
        if not np.array_equal(self._values.setdefault(answer.epoch, values), values):
            self.mixed.append(answer.epoch)
