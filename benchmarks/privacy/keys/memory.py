"""What a memory image, a state directory and a card hold, for who looks for keys in them.

Two searches. One knows what it looks for: secrets of each epoch that a receiver was given. The
other knows nothing: it takes every 32 bytes at every place for a sealing key. All captures that
were the first of their epoch have nonce 0, and all end in spaces, so one block of the key stream of
ChaCha20 tells of a key whether it opens any of them.
"""

from __future__ import annotations

import base64
import io
import os
import signal
import tarfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from veilcam_client.keys.epoch_key import KEY_BYTES

PIECE = 2**24
"""Bytes that are searched at once."""
_BATCH = 2**15
_MOST_SECRET = 128
"""Bytes of the longest secret: so far pieces overlap."""

Words = npt.NDArray[np.uint32]


@dataclass(frozen=True)
class Region:
    """Part of a process's memory."""

    start: int
    end: int
    writable: bool


@contextmanager
def stopped(pid: int) -> Iterator[None]:
    """Stop a process meanwhile, so that its memory is of one instant."""
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(pid, signal.SIGCONT)


def regions(pid: int) -> Iterator[Region]:
    """Every readable region of a process."""
    for line in Path(f"/proc/{pid}/maps").read_text().splitlines():
        span, permissions, *_ = line.split()
        # The kernel's own pages hold no data of the process.
        if "r" in permissions and not line.endswith(("[vvar]", "[vvar_vclock]", "[vsyscall]")):
            start, end = (int(each, 16) for each in span.split("-"))
            yield Region(start, end, "w" in permissions)


def memory(pid: int, *, writable: bool) -> Iterator[bytes]:
    """Memory of a process in pieces that overlap; what cannot be read (a device's) is left out.

    Args:
        pid: of a process of this user.
        writable: only what it can have written; what it cannot is a file's content.
    """
    with Path(f"/proc/{pid}/mem").open("rb", buffering=0) as stream:
        for region in regions(pid):
            if writable and not region.writable:
                continue
            for start in range(region.start, region.end, PIECE):
                stream.seek(start)
                with suppress(OSError):
                    yield stream.read(min(PIECE + _MOST_SECRET, region.end - start))


def files(folder: Path) -> Iterator[bytes]:
    """Every file of a folder, and then a card image of them all."""
    card = io.BytesIO()
    with tarfile.open(fileobj=card, mode="w") as archive:
        for path in sorted(each for each in folder.rglob("*") if each.is_file()):
            yield path.read_bytes()
            archive.add(path, path.relative_to(folder))
    yield card.getvalue()


def holds(pieces: Iterator[bytes], secrets: Sequence[bytes]) -> set[int]:
    """Which of the secrets stand in the pieces: as bytes, in hexadecimal or in base 64.

    Args:
        pieces: that overlap by ``128`` bytes.
        secrets: of 8 to 48 bytes each.
    """
    spelled = {
        form: number
        for number, secret in enumerate(secrets)
        for form in (secret, secret.hex().encode(), secret.hex().upper().encode(), *_base64(secret))
    }
    likely = np.zeros(2**24, bool)
    beginnings = {int.from_bytes(form[:3], "little") for form in spelled}
    likely[list(beginnings)] = True
    by_head: dict[bytes, list[bytes]] = {}
    for form in spelled:
        by_head.setdefault(form[:8], []).append(form)
    found: set[int] = set()
    for piece in pieces:
        if len(piece) < 8:
            continue
        there = np.frombuffer(piece, np.uint8).astype(np.uint32)
        heads = there[:-2] | there[1:-1] << 8 | there[2:] << 16
        for place in map(int, np.flatnonzero(likely[heads])):
            for form in by_head.get(piece[place : place + 8], ()):
                if piece.startswith(form, place):
                    found.add(spelled[form])
    return found


def _base64(secret: bytes) -> tuple[bytes, ...]:
    """What of a secret shows in base 64, at each of the three places where it can begin."""
    spelled = []
    for before in range(3):
        text = base64.b64encode(bytes(before) + secret)
        # Digits that hold bits of neighbours are left out.
        spelled.append(text[(8 * before + 5) // 6 : 8 * (before + len(secret)) // 6])
    return tuple(spelled)


def opened_by_windows(
    pieces: Iterator[bytes], heads: npt.NDArray[np.uint64], *, counter: int, step: int = 1
) -> set[int]:
    """Which captures open with any 32 bytes that stand anywhere in the pieces.

    Args:
        pieces: that overlap.
        heads: of each capture, the first 8 bytes of its key stream's block ``counter``, nonce 0.
        counter: of a block whose plain text is known.
        step: bytes from one place that is tried to the next.

    Returns:
        Their places in ``heads``.
    """
    order = np.argsort(heads)
    known = heads[order]
    found: set[int] = set()
    for piece in pieces:
        for keys in windows(piece, step):
            streams = key_streams(keys, counter)
            places = np.searchsorted(known, streams).clip(max=len(known) - 1)
            for place in places[known[places] == streams]:
                same = np.flatnonzero(known == known[place])
                found |= {int(order[each]) for each in same}
    return found


def windows(piece: bytes, step: int = 1) -> Iterator[Words]:
    """All 32 bytes of a piece that may be a key, as words (8, count), some at a time.

    Left out is what no random key is but with a chance below 1e-8: with a word of zeros, with two
    neighbouring words alike, or without any byte above 127, as text.
    """
    there = np.frombuffer(piece, np.uint8)
    span = _BATCH * step
    for start in range(0, len(piece) - KEY_BYTES + 1, span):
        part = there[start : start + span + KEY_BYTES - step]
        if not part.any():
            continue
        words = np.lib.stride_tricks.sliding_window_view(part, 4).copy().view("<u4")[:, 0]
        keys = np.stack([words[4 * each : len(words) + 4 * each - 28 : step] for each in range(8)])
        likely = (keys != 0).all(0) & (keys[1:] != keys[:-1]).all(0)
        likely &= ((keys & 0x80808080) != 0).any(0)
        if likely.any():
            yield np.ascontiguousarray(keys[:, likely])


def key_streams(keys: Words, counter: int) -> npt.NDArray[np.uint64]:
    """First 8 bytes of block ``counter`` of ChaCha20's key stream (RFC 8439) with nonce 0.

    Args:
        keys: words (8, count).
        counter: of the block.
    """
    constants = np.frombuffer(b"expand 32-byte k", "<u4")
    count = keys.shape[1]
    state = [np.full(count, each, np.uint32) for each in constants]
    state += [each.copy() for each in keys]
    state += [np.full(count, each, np.uint32) for each in (counter, 0, 0, 0)]
    spare = np.empty(count, np.uint32)
    for _ in range(10):
        for step in range(4):
            _quarter(state, (step, 4 + step, 8 + step, 12 + step), spare)
        for step in range(4):
            across = (4 + (step + 1) % 4, 8 + (step + 2) % 4, 12 + (step + 3) % 4)
            _quarter(state, (step, *across), spare)
    low, high = (state[each] + constants[each] for each in (0, 1))
    heads: npt.NDArray[np.uint64] = low.astype(np.uint64) | high.astype(np.uint64) << np.uint64(32)
    return heads


def _quarter(state: list[Words], places: tuple[int, int, int, int], spare: Words) -> None:
    a, b, c, d = (state[each] for each in places)
    for one, other, turned, by in ((a, b, d, 16), (c, d, b, 12), (a, b, d, 8), (c, d, b, 7)):
        np.add(one, other, out=one)
        np.bitwise_xor(turned, one, out=turned)
        np.right_shift(turned, 32 - by, out=spare)
        np.left_shift(turned, by, out=turned)
        np.bitwise_or(turned, spare, out=turned)
