"""A receiver that notices whatever comes twice, and what it cannot open."""

from __future__ import annotations

from datetime import UTC, datetime

import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from tests.siege.witness import Life, Witness

from veilcam_client.keys.blocks import Sealer
from veilcam_client.keys.envelopes import seal_key
from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.keys.receivers import Receiver, ReceiverKey
from veilcam_client.wire.captures import Capture, Embedding, Exposure, Notes, Timing
from veilcam_server.sealing.identity import DeviceKey

DEVICE, BUNDLE = DeviceKey(Ed25519PrivateKey.generate()), "0f" * 32
ARCHIVE = ReceiverKey.generate()
AT = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)
FIRST, SECOND, THIRD, IDLE = (f"{number:032x}" for number in range(4))
NOTES = Notes(
    exposure=Exposure(started_after_shown_s=0.1, settle_s=0.1, duration_s=0.01),
    timing=Timing(queue_s=0.0, rotation_s=0.0, settle_s=0.0, capture_s=0.0),
)


class Epoch:
    """One that seals whatever number it is told to."""

    def __init__(self, name: str, key: int, receiver: Receiver = ARCHIVE.public) -> None:
        self.name = name
        self._key = EpochKey(bytes([key]) * 32, device=DEVICE.public, bundle=BUNDLE)
        self._envelope = seal_key(
            self._key, DEVICE, epoch=name, bundle=BUNDLE, receivers=[receiver]
        )

    def take(self, number: int, light: float = 1.0) -> Capture:
        values = np.full((2, 3), light, np.float32)
        sealed = Sealer(self._key, self._envelope).seal(number, AT, values, NOTES)
        return Capture(id="1", epoch=self.name, number=number, taken_at=AT, embedding=sealed)


@pytest.fixture
def witness() -> Witness:
    return Witness(ARCHIVE)


def test_what_is_new_is_opened_in_whatever_order_it_came(witness: Witness) -> None:
    first, second = Epoch(FIRST, 1), Epoch(SECOND, 2)
    witness.see(Life([FIRST, IDLE], [first.take(3), second.take(0), first.take(2)]))
    witness.see(Life([THIRD], [Epoch(THIRD, 3).take(2, light=2.0)]))
    assert witness.names == {FIRST, SECOND, THIRD, IDLE}
    assert witness.opened == 4
    assert witness.repeated == witness.unopened == witness.mixed == []


def test_an_epoch_that_is_told_of_again_is_a_name_that_is_repeated(witness: Witness) -> None:
    witness.see(Life([FIRST, SECOND], []))
    witness.see(Life([SECOND, THIRD], []))
    assert witness.repeated == ["name"]
    witness.see(Life([IDLE, IDLE], []))
    assert witness.repeated == ["name", "name"]


def test_an_epoch_that_goes_on_in_another_life_repeats_its_name_and_its_key(
    witness: Witness,
) -> None:
    epoch = Epoch(FIRST, 1)
    witness.see(Life([FIRST], [epoch.take(0)]))
    witness.see(Life([], [epoch.take(1)]))
    assert witness.repeated == ["name", "sealing key"]
    assert (witness.opened, witness.unopened) == (2, [])


def test_a_number_that_is_sealed_twice_is_noticed(witness: Witness) -> None:
    epoch = Epoch(FIRST, 1)
    witness.see(Life([FIRST], [epoch.take(0), epoch.take(0)]))
    assert witness.repeated == ["number"]
    assert (witness.opened, len(witness.unopened)) == (1, 1)


def test_two_epochs_with_one_key_are_noticed(witness: Witness) -> None:
    witness.see(Life([], [Epoch(FIRST, 1).take(0)]))
    witness.see(Life([], [Epoch(SECOND, 1).take(0)]))
    assert witness.repeated == ["sealing key"]


def test_two_masks_in_one_epoch_are_mixed(witness: Witness) -> None:
    epoch = Epoch(FIRST, 1)
    witness.see(Life([], [epoch.take(0), epoch.take(1), epoch.take(2, light=1.01)]))
    assert witness.mixed == [FIRST]


def test_what_is_not_sealed_or_for_another_is_not_opened(witness: Witness) -> None:
    plain = Embedding.from_array(np.ones((2, 3), np.float32), form="raw")
    open_one = Capture(id="1", epoch=FIRST, number=0, taken_at=AT, embedding=plain)
    foreign = Epoch(SECOND, 2, ReceiverKey.generate().public).take(0)
    witness.see(Life([], [open_one, foreign]))
    assert witness.opened == 0
    assert witness.unopened[0] == "not sealed"
    assert "not sealed to receiver" in witness.unopened[1]
