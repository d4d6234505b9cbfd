"""Secrets that a daemon must not let out, in every form that they could leave in.

Levels of masks, weights of classifiers and decoders, keys of epochs and what is derived from them,
the private keys of device and receivers, tokens, and embeddings that leave sealed are looked for as
raw bytes, in hexadecimal and base64, and as numbers in text, levels also as fractions.
"""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from veilcam_client.keys.blocks import Opener
from veilcam_client.keys.envelopes import open_key
from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.captures import Capture, SealedEmbedding
from veilcam_optics.keys.masks import draw_levels
from veilcam_server.masks.fresh import FreshSource
from veilcam_server.sealing.identity import KEY_NAME
from veilcam_training.bundle import Bundle

WINDOW = 12
"""Bytes or levels in a row that are a leak; a run of twice as many is found surely."""
DISTINCT = 5
"""Least different values of a window: a dark area of a mask tells nothing."""
NUMBERS = 3
"""Weights in a row, to five digits, that are a leak."""
DECODERS = 3

_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e[+-]?\d+)?")
_HEX = re.compile(rb"[0-9a-fA-F]{24,}")
_BASE64 = re.compile(rb"[A-Za-z0-9+/_-]{16,}")


class Planted:
    def __init__(self) -> None:
        self._bytes: dict[bytes, str] = {}
        self._numbers: dict[tuple[str, ...], str] = {}

    def add_bytes(self, name: str, content: bytes, step: int = 1) -> None:
        """Add bytes, or numbers that fit in one; a window begins every ``step`` bytes."""
        for start in range(0, len(content) - WINDOW + 1, step):
            window = content[start : start + WINDOW]
            if len(set(window)) >= DISTINCT:
                self._bytes[window] = name

    def add_levels(self, name: str, levels: npt.NDArray[np.uint8]) -> None:
        self.add_bytes(name, levels.tobytes(), WINDOW)
        self.add_bytes(name, np.ascontiguousarray(levels.T).tobytes(), WINDOW)

    def add_weights(self, name: str, values: npt.NDArray[Any]) -> None:
        """Add trained or derived numbers, of which the first 20,000 are searched."""
        flat = values.astype(np.float64).ravel()[:20_000]
        self.add_bytes(name, flat.astype(np.float32).tobytes(), 4)
        self.add_bytes(name, flat.tobytes(), 8)
        for row in _rows(flat.tolist()):
            if len(set(row)) == NUMBERS and not any(float(each).is_integer() for each in row):
                self._numbers[row] = name

    def add_bundle(self, bundle: Bundle) -> None:
        for index, pair in enumerate(bundle.pairs):
            self.add_levels(f"mask {index}", pair.levels)
            for name, weights in pair.weights.items():
                self.add_weights(f"weights of pair {index}, {name}", weights)
        for name, weights in (bundle.fresh.weights if bundle.fresh else {}).items():
            self.add_weights(f"weights, {name}", weights)

    def add_tokens(self, tokens: Iterable[str]) -> None:
        for token in tokens:
            self._add_hex("a token", token[16:])

    def add_epochs(self, bundle: Bundle, keys: Sequence[EpochKey]) -> None:
        fresh, source = bundle.fresh, FreshSource(bundle) if bundle.fresh is not None else None
        for number, key in enumerate(keys):
            derived = {"key": key.reveal(), "key of levels": key.levels()}
            derived["sealing key"] = key.sealing()
            for name, content in derived.items():
                self.add_bytes(f"the {name} of epoch {number}", bytes(content))
            if source is None or fresh is None:
                continue
            if number < DECODERS:
                mask = source.make(key, frozenset())
                levels = mask.levels
                for name, values in _tensors(mask.reader):
                    self.add_weights(f"{name} of epoch {number}", values)
            else:
                levels = draw_levels(
                    key.levels(), camera=bundle.camera, distribution=fresh.distribution
                )
            self.add_levels(f"mask of epoch {number}", levels)

    def add_sealed(self, receiver: ReceiverKey, answers: Sequence[Capture]) -> None:
        opener = Opener(receiver)
        for answer in answers:
            assert isinstance(answer.embedding, SealedEmbedding)
            key = open_key(answer.embedding.envelope, receiver, device=None)
            self.add_bytes("an opened key", bytes(key.reveal()))
            opened = np.asarray(opener.open(answer).embedding)
            self.add_weights("an embedding that left sealed", opened)

    def add_receiver(self, receiver: ReceiverKey, folder: Path) -> None:
        path = folder / "receiver"
        receiver.write(path)
        text = path.read_bytes().strip().rpartition(b":")[2]
        self.add_bytes("a receiver's private key", base64.b64decode(text))
        self.add_bytes("a receiver's private key", text)

    def add_device(self, state: Path) -> None:
        seed = json.loads((state / KEY_NAME).read_text().splitlines()[1])["seed"]
        self._add_hex("the device's private key", seed)

    def _add_hex(self, name: str, digits: str) -> None:
        self.add_bytes(name, bytes.fromhex(digits))
        self.add_bytes(name, digits.encode())

    def found_in(self, content: bytes) -> set[str]:
        rows = _rows([float(each) for each in _numbers(content)])
        found = {self._numbers[row] for row in rows if row in self._numbers}
        for form in _forms(content):
            windows = (form[start : start + WINDOW] for start in range(len(form) - WINDOW + 1))
            found |= {self._bytes[window] for window in windows if window in self._bytes}
        return found


def _rows(values: Sequence[float]) -> Iterator[tuple[str, ...]]:
    short = [f"{value:.4e}" for value in values]
    return (tuple(short[at : at + NUMBERS]) for at in range(len(short) - NUMBERS + 1))


def _numbers(content: bytes) -> list[str]:
    return _NUMBER.findall(content.decode("latin-1").lower())


def _forms(content: bytes) -> Iterator[bytes]:
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
    """Return a byte, or a level written as a fraction of the brightest."""
    if value.is_integer():
        return int(value) if 0 <= value < 256 else None
    if not 0 <= value <= 1:
        return None
    level = round(63 * value)
    return level if abs(63 * value - level) < 1e-3 else None


def _tensors(holder: object, name: str = "decoder", depth: int = 3) -> Iterator[tuple[str, Any]]:
    for slot in [*getattr(holder, "__slots__", ()), *getattr(holder, "__dict__", ())]:
        value = getattr(holder, slot, None)
        if isinstance(value, np.ndarray):
            if np.issubdtype(value.dtype, np.floating) and value.size > NUMBERS:
                yield f"{name}.{slot}", value
        elif depth and type(value).__module__.startswith("veilcam"):
            yield from _tensors(value, f"{name}.{slot}", depth - 1)
