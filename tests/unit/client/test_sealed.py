"""Cameras with the key of a receiver, and without."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from tests.unit.client.recordings import Daemon
from tests.unit.client.sealing import NOTES, VALUES, Device, Epoch

from veilcam_client import AsyncCamera, Camera, KeyFileError, SealedError
from veilcam_client.keys.receivers import ReceiverKey

pytestmark = pytest.mark.anyio
KINDS = pytest.mark.parametrize("kind", [Camera, AsyncCamera])


@pytest.fixture
def anyio_backend() -> str:
    return "asyncio"


@pytest.fixture(scope="module")
def receiver() -> ReceiverKey:
    return ReceiverKey.generate()


@pytest.fixture
def device() -> Device:
    return Device()


@pytest.fixture
def daemon(device: Device, receiver: ReceiverKey) -> Daemon:
    """Seals every capture in an epoch of its own."""
    return Daemon(
        answers=lambda _: Epoch(device, receiver).capture(0).model_dump(mode="json"),
        release="sealed",
    )


def camera(kind: type, daemon: Daemon, **options: Any) -> Any:
    client = httpx.Client if kind is Camera else httpx.AsyncClient
    http = client(transport=httpx.MockTransport(daemon))
    return kind("http://localhost", http_client=http, max_retries=0, **options)


async def result(answer: Any) -> Any:
    return await answer if inspect.isawaitable(answer) else answer


@KINDS
async def test_embeddings_come_open_with_a_key(
    kind: type, daemon: Daemon, device: Device, receiver: ReceiverKey, tmp_path: Path
) -> None:
    receiver.write(tmp_path / "key")
    for key, pinned in ((receiver, None), (tmp_path / "key", device.public)):
        asked = camera(kind, daemon, key=key, device=pinned)
        for answer in (
            await result(asked.capture()),
            await result(asked.classify(include_embedding=True)),
        ):
            assert answer.embedding.form == "raw"
            assert np.array_equal(np.asarray(answer.embedding), VALUES)
            assert answer.notes == NOTES


@KINDS
async def test_embeddings_stay_sealed_without_a_key(kind: type, daemon: Daemon) -> None:
    taken = await result(camera(kind, daemon).capture())
    assert taken.embedding.form == "sealed"
    assert taken.notes is None
    with pytest.raises(SealedError, match=r"Camera\(key=\.\.\.\)"):
        np.asarray(taken)


@KINDS
async def test_capture_that_comes_twice_or_of_another_camera_is_refused(
    kind: type, device: Device, receiver: ReceiverKey
) -> None:
    told = Epoch(device, receiver).capture(0).model_dump(mode="json")
    asked = camera(kind, Daemon(answers=lambda _: told), key=receiver)
    await result(asked.capture())
    with pytest.raises(SealedError, match="came before"):
        await result(asked.capture())
    with pytest.raises(SealedError, match="check the camera"):
        await result(
            camera(kind, Daemon(answers=lambda _: told), key=receiver, device="ab" * 32).capture()
        )


@KINDS
async def test_unsealed_embedding_is_refused_where_a_key_was_given(
    kind: type, receiver: ReceiverKey
) -> None:
    with pytest.raises(SealedError, match="came white where a sealed one was expected"):
        await result(camera(kind, Daemon(), key=receiver).capture())


@KINDS
def test_key_file_that_cannot_be_used_is_refused(
    kind: type, tmp_path: Path, receiver: ReceiverKey
) -> None:
    with pytest.raises(KeyFileError, match="cannot be read"):
        kind(key=tmp_path / "missing")
    with pytest.raises(ValueError, match="use the camera's public key"):
        kind(key=receiver, device="camera")
