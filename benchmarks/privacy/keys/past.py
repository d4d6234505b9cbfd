"""What whoever takes a daemon, its memory and its files, can open of what it took before."""

from __future__ import annotations

import base64
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from benchmarks.privacy.keys import memory
from benchmarks.privacy.keys.plant import Daemon, fresh_daemon

from veilcam_client.keys.blocks import NOTES_BYTES, Opener
from veilcam_client.keys.envelopes import open_key
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.captures import Capture, SealedEmbedding
from veilcam_client.wire.rotation import RotationOff
from veilcam_optics.keys.masks import draw_levels
from veilcam_training.bundle import Bundle, read_bundle

_BLOCK = 64
"""Bytes of a block of ChaCha20's key stream."""
_HEAD = 8
_LEVELS = 48
"""Sub-pixels of a mask that are looked for: no two masks have them in common."""
NAMES = ("key", "sealing", "levels", "mask")
"""Secrets of an epoch: its key, the two keys made of it, and the mask's levels."""


@dataclass(frozen=True)
class Epoch:
    """One capture, and the secrets of its epoch, as its receiver has them."""

    secrets: dict[str, bytes]
    head: np.uint64
    """What a key has to give for it: see :func:`memory.key_streams`."""


@dataclass(frozen=True)
class Findings:
    """Of how many epochs something was left.

    Attributes:
        opened: whose captures open: with their key, with their sealing key, or with any 32 bytes.
        found: by the name of the secret, in memory or in files.
    """

    opened: set[int]
    found: dict[str, set[int]]


def epoch_of(capture: Capture, receiver: ReceiverKey, bundle: Bundle) -> Epoch:
    """Open what is sealed to a receiver, and make all secrets of the epoch again."""
    sealed = capture.embedding
    if not isinstance(sealed, SealedEmbedding) or bundle.fresh is None:
        raise ValueError("what was captured is not sealed, or the bundle is not of mode fresh")
    if capture.number != 0:
        raise ValueError(f"capture {capture.number} is not the first of its epoch")
    key = open_key(sealed.envelope, receiver, device=None)
    levels = draw_levels(key.levels(), camera=bundle.camera, distribution=bundle.fresh.distribution)
    values = (key.reveal(), key.sealing(), key.levels())
    kept = [bytes(value) for value in values] + [levels.tobytes()[:_LEVELS]]
    return Epoch(dict(zip(NAMES, kept, strict=True)), head_of(sealed))


def head_of(sealed: SealedEmbedding) -> np.uint64:
    """First bytes of the key stream's last block: the notes end in spaces."""
    start = _BLOCK * (counter_of(sealed.shape) - 1)
    last = int.from_bytes(base64.b64decode(sealed.block)[start : start + _HEAD], "little")
    return np.uint64(last ^ int.from_bytes(b" " * _HEAD, "little"))


def counter_of(shape: tuple[int, ...]) -> int:
    """Number of the last block that has 8 bytes to tell by; a text's first block has number 1."""
    return (4 * int(np.prod(shape)) + NOTES_BYTES - _HEAD) // _BLOCK + 1


def search(
    epochs: Sequence[Epoch],
    *,
    process: int,
    folder: Path,
    counter: int,
    step: int,
    told: Callable[[str], None],
) -> Findings:
    """Look for the secrets of epochs in the memory of a process and in its files.

    Args:
        epochs: of which anything may be left.
        process: of the daemon, stopped.
        folder: its state directory.
        counter: see :func:`counter_of`.
        step: bytes from one place that is tried for a key to the next.
        told: what is under way.
    """
    wanted = [each.secrets[name] for each in epochs for name in NAMES]
    told("known secrets")
    found = memory.holds(memory.memory(process, writable=False), wanted)
    found |= memory.holds(memory.files(folder), wanted)
    by_name = {
        name: {each // len(NAMES) for each in found if each % len(NAMES) == place}
        for place, name in enumerate(NAMES)
    }
    heads: npt.NDArray[np.uint64] = np.array([each.head for each in epochs], np.uint64)
    told("any 32 bytes")
    opened = memory.opened_by_windows(
        memory.memory(process, writable=True), heads, counter=counter, step=step
    )
    opened |= memory.opened_by_windows(memory.files(folder), heads, counter=counter, step=step)
    return Findings(opened | by_name["key"] | by_name["sealing"], by_name)


def take_past(
    bundle: Path, folder: Path, captures: int, *, step: int, told: Callable[[str], None]
) -> tuple[Findings, int]:
    """Take captures behind a mask each, rotate, and look for what opens them.

    Args:
        bundle: of mode fresh.
        folder: for the daemon.
        captures: how many.
        step: bytes from one place that is tried for a key to the next.
        told: what is under way.

    Returns:
        What was found of them, and the bytes of memory that were searched.

    Raises:
        RuntimeError: the mask that is shown is not found either: the search is worth nothing.
    """
    receiver, contents = ReceiverKey.generate(), read_bundle(bundle)
    with fresh_daemon(bundle, folder, receiver.public) as daemon:
        opener, epochs = Opener(receiver), []
        for number in range(captures + 1):
            if number == captures:
                # One mask that stays, so that its keys have to be there.
                daemon.rotate(RotationOff())
            capture = _captured(daemon)
            opener.open(capture)
            epochs.append(epoch_of(capture, receiver, contents))
            told(f"{number + 1} captures")
        process, state = daemon_process(folder / "state"), folder / "state"
        counter = counter_of(capture.embedding.shape)
        with memory.stopped(process):
            size = sum(each.end - each.start for each in memory.regions(process))
            findings = search(
                epochs, process=process, folder=state, counter=counter, step=step, told=told
            )
    return past_of(findings, captures), size


def past_of(findings: Findings, last: int) -> Findings:
    """What was found of all epochs but the last, which goes on and has to be found.

    Raises:
        RuntimeError: it was not.
    """
    if last not in findings.opened or last not in findings.found["sealing"]:
        raise RuntimeError("the epoch that goes on was not found: the search proves nothing")
    found = {name: each - {last} for name, each in findings.found.items()}
    return Findings(findings.opened - {last}, found)


def _captured(daemon: Daemon) -> Capture:
    return Capture.model_validate_json(daemon.capture().body)


def daemon_process(state: Path) -> int:
    """The child of this process that has ``state`` for its state directory."""
    for task in Path(f"/proc/{os.getpid()}/task").iterdir():
        for child in (task / "children").read_text().split():
            words = Path(f"/proc/{child}/cmdline").read_bytes().split(b"\0")
            if os.fsencode(state) in words:
                return int(child)
    raise RuntimeError(f"no child serves {state}")
