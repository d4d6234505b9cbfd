"""Searches of memory find what is planted, in every spelling, and nothing in noise."""

from __future__ import annotations

import base64
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from benchmarks.privacy.keys import memory
from cryptography.hazmat.primitives.ciphers import Cipher, algorithms

COUNTER = 56


def stream_head(key: bytes, counter: int = COUNTER) -> np.uint64:
    nonce = counter.to_bytes(4, "little") + bytes(12)
    stream = Cipher(algorithms.ChaCha20(key, nonce), mode=None).encryptor()
    return np.uint64(int.from_bytes(stream.update(bytes(8)), "little"))


@pytest.mark.parametrize("place", [0, 3, 40_001, 99_968])
def test_key_opens_wherever_it_stands(place: int) -> None:
    random = np.random.default_rng(place)
    keys = [random.bytes(32) for _ in range(50)]
    heads = np.array([stream_head(key) for key in keys])
    noise = bytearray(random.bytes(100_000))
    assert memory.opened_by_windows(iter([bytes(noise)]), heads, counter=COUNTER) == set()
    noise[place : place + 32] = keys[17]
    assert memory.opened_by_windows(iter([bytes(noise)]), heads, counter=COUNTER) == {17}


SPELLINGS: dict[str, Callable[[bytes], bytes]] = {
    "bytes": bytes,
    "hexadecimal": lambda secret: secret.hex().encode(),
    "capitals": lambda secret: secret.hex().upper().encode(),
    "base64": base64.b64encode,
    "base64 after one byte": lambda secret: base64.b64encode(b"1" + secret + b"23"),
    "base64 after two bytes": lambda secret: base64.b64encode(b"12" + secret),
}


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_secret_is_found_in_every_spelling(spelling: str) -> None:
    random = np.random.default_rng(1)
    secrets = [random.bytes(32) for _ in range(200)]
    noise = random.bytes(300_000)
    assert memory.holds(iter([noise, b"", b"short"]), secrets) == set()
    planted = noise[:777] + SPELLINGS[spelling](secrets[33]) + noise[777:]
    assert memory.holds(iter([noise, planted]), secrets) == {33}
    missed = planted.replace(SPELLINGS[spelling](secrets[33])[:20], bytes(20))
    assert memory.holds(iter([missed]), secrets) == set()


def test_state_directory_is_searched_file_by_file_and_as_a_card(tmp_path: Path) -> None:
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / "one").write_bytes(b"first")
    (tmp_path / "two").write_bytes(b"second")
    *each, card = memory.files(tmp_path)
    assert each == [b"first", b"second"]
    assert b"first" in card
    assert b"second" in card
    assert b"inner/one" in card


_CHILD = """
import sys
said, key = sys.stdin.readline(), bytearray(32)
for place in range(32):
    key[31 - place] = int(said[2 * place : 2 * place + 2], 16)
print("ready", flush=True)
sys.stdin.readline()
key[:] = bytes(32)
print("erased", flush=True)
sys.stdin.readline()
"""
"""Gets a key back to front, and puts it together where it can be overwritten."""


@pytest.mark.slow
def test_key_in_a_process_is_found_until_it_is_overwritten() -> None:
    key = os.urandom(32)
    heads = np.array([stream_head(key)])
    with subprocess.Popen(
        [sys.executable, "-c", _CHILD], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdin is not None
        assert child.stdout is not None
        for told, said, found in ((key[::-1].hex(), "ready", {0}), ("erase", "erased", set())):
            child.stdin.write(f"{told}\n")
            child.stdin.flush()
            assert child.stdout.readline().strip() == said
            with memory.stopped(child.pid):
                exact = memory.holds(memory.memory(child.pid, writable=False), [key])
                pieces = memory.memory(child.pid, writable=True)
                guessed = memory.opened_by_windows(pieces, heads, counter=COUNTER)
            assert (exact, guessed) == (found, found)
        child.stdin.write("end\n")
