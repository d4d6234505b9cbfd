"""Key pairs of receivers: files, lines, and what is sealed to them."""

from __future__ import annotations

import base64
import copy
import errno
import os
import pickle
from pathlib import Path

import pytest
from cryptography.exceptions import InvalidTag

from veilcam_client.errors import FileError
from veilcam_client.keys.receivers import PRIVATE_BYTES, PUBLIC_BYTES, Receiver, ReceiverKey


def test_public_half_seals_what_the_private_one_opens(receiver: ReceiverKey) -> None:
    sealed = receiver.public.seal(bytearray(b"secret"), b"info")
    assert len(sealed) == len(b"secret") + 1136
    assert sealed != receiver.public.seal(b"secret", b"info")
    assert receiver.open(sealed, b"info") == b"secret"
    for key, text, info in (
        (ReceiverKey.generate(), sealed, b"info"),
        (receiver, sealed, b"other"),
        (receiver, sealed[:-1], b"info"),
        (receiver, b"", b"info"),
        (receiver, bytes([sealed[0] ^ 1]) + sealed[1:], b"info"),
    ):
        with pytest.raises(InvalidTag):
            key.open(text, info)


def test_line_names_a_receiver(receiver: ReceiverKey) -> None:
    line = str(receiver.public)
    assert line.startswith("veilcam-receiver:")
    assert Receiver.parse(line) == receiver.public
    assert len(receiver.public.id) == 64
    assert receiver.public.id != ReceiverKey.generate().public.id


def test_invalid_receiver_is_refused(receiver: ReceiverKey) -> None:
    raw = receiver.public.raw
    for text in (
        "",
        str(receiver.public).removeprefix("veilcam-receiver:"),
        str(receiver.public)[:-4],
        f"{receiver.public}\n",
        "veilcam-receiver:!",
        f"veilcam-receiver:{base64.b64encode(bytes([255]) * PUBLIC_BYTES).decode()}",
        # A point of low order: all secrets agreed with it are zero.
        f"veilcam-receiver:{base64.b64encode(raw[:-32] + bytes(32)).decode()}",
    ):
        with pytest.raises(ValueError, match="this is no receiver's key"):
            Receiver.parse(text)
    with pytest.raises(ValueError, match=f"has 5 bytes: use {PUBLIC_BYTES}"):
        Receiver(b"12345")


def test_file_keeps_the_private_half(receiver: ReceiverKey, tmp_path: Path) -> None:
    path = tmp_path / "key"
    receiver.write(path)
    assert path.stat().st_mode & 0o777 == 0o600
    again = ReceiverKey.read(path)
    assert again.public == receiver.public
    assert again.open(receiver.public.seal(b"secret", b""), b"") == b"secret"


def test_key_is_never_overwritten(receiver: ReceiverKey, tmp_path: Path) -> None:
    path = tmp_path / "key"
    path.write_text("mine")
    with pytest.raises(FileError, match="exists and was left alone"):
        receiver.write(path)
    assert path.read_text() == "mine"
    with pytest.raises(FileError, match=r"cannot be written \(No such file"):
        receiver.write(tmp_path / "no" / "such")


def test_half_a_key_is_not_left_behind(
    receiver: ReceiverKey, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(FileError, match="No space left"):
            receiver.write(tmp_path / "key")
    receiver.write(tmp_path / "key")


def test_file_that_is_no_key_of_ones_own_is_refused(receiver: ReceiverKey, tmp_path: Path) -> None:
    path = tmp_path / "key"
    receiver.write(path)
    text = path.read_text()
    path.chmod(0o640)
    with pytest.raises(FileError, match="is open to others: run chmod 600"):
        ReceiverKey.read(path)
    path.chmod(0o600)
    for other in ("", str(receiver.public), text[:-5], "\xff" * 99, text.partition(":")[2]):
        path.write_text(other, "latin-1")
        with pytest.raises(FileError, match="holds no receiver's private key") as refused:
            ReceiverKey.read(path)
        assert text.partition(":")[2][:10] not in str(refused.value)
    with pytest.raises(FileError, match=r"cannot be read \(No such file"):
        ReceiverKey.read(tmp_path / "missing")
    with pytest.raises(FileError, match=r"cannot be read \(Is a directory"):
        ReceiverKey.read(tmp_path)


def test_private_key_shows_nowhere(receiver: ReceiverKey) -> None:
    assert repr(receiver) == f"ReceiverKey(public={receiver.public.id[:16]})"
    for leak in (pickle.dumps, copy.copy, copy.deepcopy):
        with pytest.raises(TypeError, match="not pickled"):
            leak(receiver)
    with pytest.raises(ValueError, match=f"use {PRIVATE_BYTES} bytes"):
        ReceiverKey(b"1")
