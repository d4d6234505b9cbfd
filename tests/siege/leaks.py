"""What a daemon must not let out, in every form that it could leave in.

Levels of masks, weights of classifiers and decoders, keys of epochs and what is derived from them,
the private keys of device and receivers, tokens, and embeddings that leave sealed are looked for as
raw bytes, in hexadecimal and base64, and as numbers in text, levels also as fractions.
"""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.progress import track

from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_optics.keys.masks import draw_levels
from veilcam_server.masks.fresh import FreshSource
from veilcam_server.sealing.identity import KEY_NAME
from veilcam_training.bundle import Bundle

WINDOW = 12
"""So many bytes or levels in a row are a leak; a run of twice as many is found surely."""
DISTINCT = 5
"""Windows of fewer values than this, such as dark areas of a mask, tell nothing."""
NUMBERS = 3
"""So many weights in a row, to five digits, are a leak."""
DECODERS = 3
"""Of so many epochs the decoders are searched, which are large; the masks of all."""

_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
_HEX = re.compile(rb"[0-9a-fA-F]{24,}")
_BASE64 = re.compile(rb"[A-Za-z0-9+/_-]{16,}")


class Planted:
    """What must not leave, in the forms that it could leave in."""

    def __init__(self) -> None:
        self._bytes: dict[bytes, str] = {}
        self._numbers: dict[tuple[str, ...], str] = {}

    def add_bytes(self, name: str, content: bytes, step: int = WINDOW) -> None:
        """Bytes, or numbers that fit in one."""
        for start in range(0, len(content) - WINDOW + 1, step):
            window = content[start : start + WINDOW]
            if len(set(window)) >= DISTINCT:
                self._bytes[window] = name

    def add_levels(self, name: str, levels: npt.NDArray[np.uint8]) -> None:
        """A mask, row by row and column by column."""
        self.add_bytes(name, levels.tobytes())
        self.add_bytes(name, np.ascontiguousarray(levels.T).tobytes())

    def add_weights(self, name: str, values: npt.NDArray[Any]) -> None:
        """Trained or derived numbers, of which the first 20,000 are searched."""
        flat = values.astype(np.float64).ravel()[:20_000]
        self.add_bytes(name, flat.astype(np.float32).tobytes(), 4)
        self.add_bytes(name, flat.tobytes(), 8)
        short = [_short(value) for value in flat.tolist()]
        for start in range(len(short) - NUMBERS + 1):
            row = tuple(short[start : start + NUMBERS])
            if len(set(row)) == NUMBERS and not any(float(each).is_integer() for each in row):
                self._numbers[row] = name

    def include(self, other: Planted) -> None:
        """All that is planted elsewhere, too."""
        self._bytes |= other._bytes
        self._numbers |= other._numbers

    def found_in(self, content: bytes) -> set[str]:
        """Names of what is in ``content``."""
        found = set()
        for form in _forms(content):
            for start in range(len(form) - WINDOW + 1):
                name = self._bytes.get(form[start : start + WINDOW])
                if name is not None:
                    found.add(name)
        short = [_short(float(each)) for each in _numbers(content)]
        for start in range(len(short) - NUMBERS + 1):
            name = self._numbers.get(tuple(short[start : start + NUMBERS]))
            if name is not None:
                found.add(name)
        return found


def _short(value: float) -> str:
    return f"{value:.4e}"


def _numbers(content: bytes) -> list[str]:
    return _NUMBER.findall(content.decode("latin-1").lower())


def _forms(content: bytes) -> Iterator[bytes]:
    """The content itself, and whatever could be written in it as text."""
    yield content
    for match in _HEX.findall(content):
        for start in (0, 1):
            digits = match[start:]
            yield bytes.fromhex(digits[: len(digits) // 2 * 2].decode())
    for match in _BASE64.findall(content):
        standard = match.translate(bytes.maketrans(b"-_", b"+/"))
        for start in range(4):
            digits = standard[start:]
            yield base64.b64decode(digits[: len(digits) // 4 * 4])
    run = bytearray()
    for number in _numbers(content):
        level = _level(float(number))
        if level is None:
            yield bytes(run)
            run.clear()
        else:
            run.append(level)
    yield bytes(run)


def _level(value: float) -> int | None:
    """A byte, or a level written as a fraction of the brightest."""
    if value.is_integer():
        return int(value) if 0 <= value < 256 else None
    if not 0 <= value <= 1:
        return None
    level = round(63 * value)
    return level if abs(63 * value - level) < 1e-3 else None


def plant(bundle: Bundle, tokens: Sequence[str]) -> Planted:
    """What a daemon with this bundle and these tokens must not let out."""
    planted = Planted()
    for index, pair in enumerate(bundle.pairs):
        planted.add_levels(f"mask {index}", pair.levels)
        for name, weights in pair.weights.items():
            planted.add_weights(f"weights of pair {index}, {name}", weights)
    if bundle.fresh is not None:
        for name, weights in bundle.fresh.weights.items():
            planted.add_weights(f"weights, {name}", weights)
    for token in tokens:
        planted.add_bytes("a token", bytes.fromhex(token[16:]), 1)
        planted.add_bytes("a token", token[16:].encode(), 1)
    return planted


def plant_epochs(planted: Planted, bundle: Bundle, keys: Sequence[EpochKey]) -> None:
    """Keys of epochs, and what was derived from them."""
    source = FreshSource(bundle) if bundle.fresh is not None else None
    for number, key in enumerate(track(keys, "deriving masks")):
        for name, derived in (
            ("the key", key.reveal()),
            ("the key of levels", key.levels()),
            ("the key of the rotation", key.rotation()),
            ("the sealing key", key.sealing()),
        ):
            planted.add_bytes(f"{name} of epoch {number}", bytes(derived), 1)
        if source is None or bundle.fresh is None:
            continue
        if number < DECODERS:
            mask = source.make(key, "white", frozenset())
            planted.add_levels(f"mask of epoch {number}", mask.levels)
            for name, values in _tensors(mask.reader):
                planted.add_weights(f"{name} of epoch {number}", values)
        else:
            levels = draw_levels(
                key.levels(), camera=bundle.camera, distribution=bundle.fresh.distribution
            )
            planted.add_levels(f"mask of epoch {number}", levels)


def plant_receiver(planted: Planted, receiver: ReceiverKey, folder: Path) -> None:
    """The private key of a receiver, as the file that it is kept in has it."""
    path = folder / "receiver"
    receiver.write(path)
    text = path.read_bytes().strip().rpartition(b":")[2]
    planted.add_bytes("a receiver's private key", base64.b64decode(text), 1)
    planted.add_bytes("a receiver's private key", text, 1)


def plant_device(planted: Planted, state: Path) -> None:
    """The private key of the device, from its state directory."""
    seed = json.loads((state / KEY_NAME).read_text().splitlines()[1])["seed"]
    planted.add_bytes("the device's private key", bytes.fromhex(seed), 1)
    planted.add_bytes("the device's private key", seed.encode(), 1)


def _tensors(holder: object, name: str = "decoder", depth: int = 3) -> Iterator[tuple[str, Any]]:
    """All arrays of an object and of its parts."""
    for slot in [*getattr(holder, "__slots__", ()), *getattr(holder, "__dict__", ())]:
        value = getattr(holder, slot, None)
        if (
            isinstance(value, np.ndarray)
            and np.issubdtype(value.dtype, np.floating)
            and value.size > NUMBERS
        ):
            yield f"{name}.{slot}", value
        elif depth and type(value).__module__.startswith("veilcam"):
            yield from _tensors(value, f"{name}.{slot}", depth - 1)
