"""What befalls a file: truncated, emptied, flipped bytes, removed."""

from __future__ import annotations

import random
from collections.abc import Callable, Mapping
from pathlib import Path


def truncate(path: Path) -> None:
    """Lose the second half."""
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def flip(path: Path, count: int = 20) -> None:
    """Flip bits in so many bytes."""
    content = bytearray(path.read_bytes())
    source = random.Random(path.name)
    for place in source.sample(range(len(content)), min(count, len(content))):
        content[place] ^= source.randrange(1, 256)
    path.write_bytes(bytes(content))


def empty(path: Path) -> None:
    """Lose everything but the name."""
    path.write_bytes(b"")


DAMAGES: Mapping[str, Callable[[Path], None]] = {
    "truncated": truncate,
    "emptied": empty,
    "flipped": flip,
    "removed": Path.unlink,
}
