"""Cameras with the key of a receiver, and without."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.unit.client.conftest import camera_of, result
from tests.unit.client.recordings import Daemon
from tests.unit.client.sealing import NOTES, VALUES, Device, Epoch

from veilcam_client.errors import FileError, SealedError
from veilcam_client.keys.receivers import ReceiverKey

pytestmark = pytest.mark.anyio


@pytest.fixture
def daemon(device: Device, receiver: ReceiverKey) -> Daemon:
    """Seals every capture in an epoch of its own."""
    return Daemon(
        answers=lambda _: Epoch(device, receiver).capture(0).model_dump(mode="json"),
        release="sealed",
    )


async def test_embeddings_come_open_with_a_key(
    kind: type, daemon: Daemon, device: Device, receiver: ReceiverKey, tmp_path: Path
) -> None:
    receiver.write(tmp_path / "key")
    for key, pinned in ((receiver, None), (tmp_path / "key", device.public)):
        asked = camera_of(kind, daemon, key=key, device=pinned)
        for answer in (
            await result(asked.capture()),
            await result(asked.classify(include_embedding=True)),
        ):
            assert answer.embedding.form == "raw"
            assert np.array_equal(np.asarray(answer.embedding), VALUES)
            assert answer.notes == NOTES


async def test_embeddings_stay_sealed_without_a_key(kind: type, daemon: Daemon) -> None:
    taken = await result(camera_of(kind, daemon).capture())
    assert (taken.embedding.form, taken.notes) == ("sealed", None)


async def test_capture_that_comes_twice_or_of_another_camera_is_refused(
    kind: type, device: Device, receiver: ReceiverKey
) -> None:
    told = Epoch(device, receiver).capture(0).model_dump(mode="json")
    asked = camera_of(kind, Daemon(answers=lambda _: told), key=receiver)
    await result(asked.capture())
    with pytest.raises(SealedError, match="came before"):
        await result(asked.capture())
    pinned = camera_of(kind, Daemon(answers=lambda _: told), key=receiver, device="ab" * 32)
    with pytest.raises(SealedError, match="check the camera"):
        await result(pinned.capture())


async def test_unsealed_embedding_is_refused_where_a_key_was_given(
    kind: type, receiver: ReceiverKey, tmp_path: Path
) -> None:
    with pytest.raises(SealedError, match="came raw where a sealed one was expected"):
        await result(camera_of(kind, Daemon(), key=receiver).capture())
    with pytest.raises(FileError, match="cannot be read"):
        kind(key=tmp_path / "missing")
