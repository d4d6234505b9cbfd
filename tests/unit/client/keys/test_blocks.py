"""Blocks: round trips, what an opener refuses, and what it remembers."""

from __future__ import annotations

import base64
import hashlib
import hmac
import string
from datetime import timedelta, timezone
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from tests.unit.client.sealing import AT, BUNDLE, NOTES, VALUES, Device, Epoch

from veilcam_client.errors import SealedError
from veilcam_client.keys import blocks
from veilcam_client.keys.blocks import NOTES_BYTES, Opener
from veilcam_client.keys.envelopes import open_key
from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.captures import (
    Capture,
    Classification,
    Embedding,
    Exposure,
    Notes,
    SealedEmbedding,
    Timing,
)

HOUR = timezone(timedelta(hours=1))
LONG = 0.1234567890123456e-100
WORDY = Notes(
    exposure=Exposure(started_after_shown_s=LONG, settle_s=LONG, duration_s=LONG),
    timing=Timing(queue_s=LONG, rotation_s=LONG, settle_s=LONG, capture_s=LONG),
    scene=10**9,
)


@pytest.fixture
def epoch(device: Device, receiver: ReceiverKey) -> Epoch:
    return Epoch(device, receiver)


arrays = npst.arrays(
    np.float32,
    npst.array_shapes(max_dims=3, max_side=5),
    elements=st.floats(width=32, allow_nan=False, allow_infinity=False),
)


@settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(values=arrays, number=st.integers(0, 2**96 - 1))
def test_sealed_capture_is_opened_bit_by_bit(
    device: Device, receiver: ReceiverKey, values: npt.NDArray[np.float32], number: int
) -> None:
    opened = Opener(receiver, device.public).open(
        Epoch(device, receiver).capture(number, values=values)
    )
    assert opened.embedding.form == "raw"
    assert np.asarray(opened).tobytes() == values.tobytes()
    assert np.asarray(opened).shape == values.shape
    assert opened.notes == NOTES
    assert opened.number == number


def test_block_is_what_its_format_says(device: Device, receiver: ReceiverKey) -> None:
    """Opened here by the standard alone, as another implementation would."""
    epoch = Epoch(device, receiver)
    capture = epoch.capture(258)
    info = b"veilcam embedding sealing 1\0" + bytes.fromhex(device.public) + bytes.fromhex(BUNDLE)
    key = hmac.digest(epoch.key.reveal(), info + b"\x01", hashlib.sha256)
    digest = hashlib.sha256(receiver.public.id.encode()).hexdigest()
    data = (
        f'["veilcam sealed embedding",1,"{device.public}","{epoch.name}",258,"sealed",[2,3],'
        f'"float32","{BUNDLE}","2026-01-02T03:04:05+00:00","{digest}"]'
    )
    block = base64.b64decode(_sealed(capture).block)
    opened = ChaCha20Poly1305(key).decrypt(bytes(10) + b"\x01\x02", block, data.encode())
    assert opened[:24] == VALUES.astype("<f4").tobytes()
    assert opened[24:] == NOTES.model_dump_json().encode().ljust(512)


def test_size_and_repr_of_a_block_tell_nothing(epoch: Epoch) -> None:
    dark, bright = np.zeros((2, 3), np.float32), VALUES * np.float32(1e30)
    plain = NOTES.model_copy(update={"scene": None})
    sizes = {
        len(_sealed(epoch.capture(number, AT, values, notes)).block)
        for number, (values, notes) in enumerate(
            [(dark, NOTES), (bright, NOTES), (dark, WORDY), (bright, plain)]
        )
    }
    capture = epoch.capture(4)
    assert _sealed(capture).block not in repr(capture)
    assert sizes == {len(base64.b64encode(bytes(4 * 6 + NOTES_BYTES + 16)))}


def _sealed(answer: Capture) -> SealedEmbedding:
    assert isinstance(answer.embedding, SealedEmbedding)
    return answer.embedding


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((1, AT, VALUES, NOTES), "capture 1 of this epoch was sealed already"),
        ((0, AT, VALUES, NOTES), "capture 0 of this epoch was sealed already"),
        ((2, AT, VALUES.astype(np.float64), NOTES), "float64 are not sealed"),
        *(
            ((2, at, VALUES, NOTES), "use a whole second of UTC")
            for at in (AT.replace(microsecond=1), AT.replace(tzinfo=None), AT.astimezone(HOUR))
        ),
        ((2, AT, VALUES, NOTES.model_copy(update={"scene": 10**500})), "are too long: use 512"),
    ],
)
def test_capture_that_cannot_be_sealed_uses_no_number(
    epoch: Epoch, receiver: ReceiverKey, arguments: Any, message: str
) -> None:
    epoch.capture(1)
    with pytest.raises(ValueError, match=message):
        epoch.sealer.seal(*arguments)
    assert Opener(receiver).open(epoch.capture(2)).notes == NOTES


def test_erased_key_seals_nothing(epoch: Epoch) -> None:
    held = epoch.sealer._key
    epoch.sealer.erase()
    epoch.sealer.erase()
    assert held == bytes(32)
    with pytest.raises(ValueError, match="was erased"):
        epoch.capture(2**95)


def test_number_is_taken_once_and_in_order(epoch: Epoch, receiver: ReceiverKey) -> None:
    captures = [epoch.capture(number) for number in (0, 1, 5, 6)]
    opener = Opener(receiver)
    for capture in (captures[0], captures[2]):  # what was lost in between is no matter
        opener.open(capture)
    for capture in captures[:3]:
        with pytest.raises(SealedError, match="came before, or later than"):
            opener.open(capture)
    assert opener.open(captures[3]).number == 6


def test_changed_capture_is_refused_and_the_genuine_one_still_opens(
    device: Device, epoch: Epoch, receiver: ReceiverKey
) -> None:
    genuine, opener = epoch.capture(3), Opener(receiver)
    sealed, block = _sealed(genuine), base64.b64decode(_sealed(genuine).block)
    other = Epoch(device, receiver)

    def inside(**changes: Any) -> Capture:
        return genuine.model_copy(update={"embedding": sealed.model_copy(update=changes)})

    def with_block(data: bytes) -> Capture:
        return inside(block=base64.b64encode(data).decode())

    for forged in (
        *(genuine.model_copy(update={"number": number}) for number in (2, 4, 2**96, 2**200)),
        genuine.model_copy(update={"taken_at": AT + timedelta(seconds=1)}),
        genuine.model_copy(update={"taken_at": AT.astimezone(HOUR)}),
        genuine.model_copy(update={"taken_at": AT.replace(tzinfo=None)}),
        genuine.model_copy(update={"epoch": other.name}),
        genuine.model_copy(update={"embedding": other.capture(3).embedding}),
        *(inside(shape=shape) for shape in ((3, 2), (6,), (2, -1), (2, 3, 1), ())),
        inside(envelope=_sealed(other.capture(4)).envelope),
        *(with_block(data) for data in (b"", block[:16], block[:-1], block + b"0", block[::-1])),
        with_block(bytes([block[0] ^ 1]) + block[1:]),
        inside(block="?"),
        inside(block=f" {sealed.block}"),
    ):
        with pytest.raises(SealedError):
            opener.open(forged)
    assert opener.open(genuine).notes == NOTES


def test_block_has_one_text(epoch: Epoch, receiver: ReceiverKey) -> None:
    """The last character of base64 may have bits that mean nothing; here they must be 0."""
    genuine = epoch.capture(0, values=np.zeros((1, 1), np.float32))
    block = _sealed(genuine).block
    assert block.endswith("=")
    end = block.rstrip("=")[-1]
    alphabet = string.ascii_uppercase + string.ascii_lowercase + string.digits + "+/"
    changed = block.replace(f"{end}=", f"{alphabet[alphabet.index(end) + 1]}=")
    assert base64.b64decode(changed) == base64.b64decode(block)
    sealed = _sealed(genuine).model_copy(update={"block": changed})
    with pytest.raises(SealedError, match="changed on its way"):
        Opener(receiver).open(genuine.model_copy(update={"embedding": sealed}))


def test_unsealed_embedding_is_refused_by_an_opener(epoch: Epoch, receiver: ReceiverKey) -> None:
    raw = epoch.capture(0).model_copy(
        update={"embedding": Embedding.from_array(VALUES), "notes": NOTES}
    )
    with pytest.raises(SealedError, match="came raw where a sealed one was expected"):
        Opener(receiver).open(raw)


def test_classification_is_opened_too(epoch: Epoch, receiver: ReceiverKey) -> None:
    capture = epoch.capture(0)
    found = Classification(
        id="1", epoch=capture.epoch, number=0, taken_at=AT, label="7", embedding=capture.embedding
    )
    opened = Opener(receiver).open(found)
    assert opened.label == "7"
    assert np.array_equal(np.asarray(opened.embedding), VALUES)
    alone = found.model_copy(update={"embedding": None, "notes": NOTES})
    assert Opener(receiver).open(alone).notes is None  # nothing vouches for them


def test_first_camera_of_an_opener_is_the_only_one(epoch: Epoch, receiver: ReceiverKey) -> None:
    opener, stranger = Opener(receiver), Epoch(Device(), receiver)
    with pytest.raises(SealedError):  # what cannot be opened names no camera
        opener.open(stranger.capture(0).model_copy(update={"number": 1}))
    opener.open(epoch.capture(0))
    with pytest.raises(SealedError, match="check the camera"):
        opener.open(stranger.capture(1))
    with pytest.raises(SealedError, match="check the camera"):
        Opener(receiver, "ab" * 32).open(epoch.capture(1))
    with pytest.raises(ValueError, match="use the camera's public key, 64"):
        Opener(receiver, "AB" * 32)


def test_epoch_has_one_envelope(device: Device, epoch: Epoch, receiver: ReceiverKey) -> None:
    opener, twin = Opener(receiver), Epoch(device, receiver)
    opener.open(epoch.capture(0))
    twin_envelope = _sealed(twin.capture(0)).envelope
    later = epoch.capture(1)
    forged = _sealed(later).model_copy(update={"envelope": twin_envelope})
    with pytest.raises(SealedError, match="has two envelopes"):
        opener.open(later.model_copy(update={"embedding": forged}))
    assert opener.open(later).number == 1


def test_forgotten_epochs_take_nothing_older(device: Device, receiver: ReceiverKey) -> None:
    epochs = [Epoch(device, receiver) for _ in range(6)]
    captures = [
        epoch.capture(0, AT + timedelta(seconds=second)) for second, epoch in enumerate(epochs)
    ]
    few, many = Opener(receiver, epochs=2), Opener(receiver, epochs=4)
    for opener in (few, many):
        for capture in captures[1:5]:
            opener.open(capture)
        for capture in captures[1:5]:  # forgotten or not, none of them comes again
            with pytest.raises(SealedError, match="came before"):
                opener.open(capture)
    # Never seen, and older than what the one forgot: to tell it from a replay takes memory.
    with pytest.raises(SealedError, match="came before"):
        few.open(captures[0])
    assert many.open(captures[0]).number == 0
    assert few.open(captures[5]).number == 0
    # Of an epoch that was used lately, what follows is taken, whatever was forgotten.
    assert few.open(epochs[5].capture(1, AT)).number == 1


def test_key_of_a_forgotten_epoch_is_overwritten(device: Device, receiver: ReceiverKey) -> None:
    opener, first = Opener(receiver, epochs=1), Epoch(device, receiver)
    opener.open(first.capture(0))
    held = opener._epochs[first.name].key
    assert held != bytes(32)
    opener.open(Epoch(device, receiver).capture(0, AT + timedelta(seconds=1)))
    assert held == bytes(32)


def test_epoch_that_was_used_last_is_forgotten_last(device: Device, receiver: ReceiverKey) -> None:
    opener = Opener(receiver, epochs=2)
    first, second, third = (Epoch(device, receiver) for _ in range(3))
    for seconds, (epoch, number) in enumerate(((first, 0), (second, 0), (first, 1), (third, 0))):
        opener.open(epoch.capture(number, AT + timedelta(seconds=seconds)))
    # The second one is forgotten, and the first still known: its number says all, not the time.
    assert opener.open(first.capture(2, AT)).number == 2


def test_forgotten_time_never_becomes_younger(device: Device, receiver: ReceiverKey) -> None:
    """Two are known; the younger of them is forgotten first, as it was used first."""
    opener = Opener(receiver, epochs=2)
    for second in (5, 1, 9, 9):
        opener.open(Epoch(device, receiver).capture(0, AT + timedelta(seconds=second)))
    with pytest.raises(SealedError, match="came before"):
        opener.open(Epoch(device, receiver).capture(0, AT + timedelta(seconds=3)))


def test_key_of_an_epoch_is_not_kept(
    epoch: Epoch, receiver: ReceiverKey, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What seals is all that an opener needs; masks are drawn from the rest."""
    keys = []

    def spied(*arguments: Any, **options: Any) -> EpochKey:
        keys.append(open_key(*arguments, **options))
        return keys[-1]

    monkeypatch.setattr(blocks, "open_key", spied)
    Opener(receiver).open(epoch.capture(0))
    (key,) = keys
    with pytest.raises(ValueError, match="was erased"):
        key.reveal()
