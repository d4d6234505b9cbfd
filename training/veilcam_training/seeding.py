"""Random numbers that depend on a seed and on what they are for, and on nothing that ran before.

Every epoch has streams of its own, so a fit that is killed and taken up again draws the same
numbers as one that was not.
"""

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager

import torch


def derive(seed: int, *purpose: str | int) -> int:
    """Return a seed for one purpose, e.g. ``derive(seed, "noise", epoch)``; 0 to 2^63 - 1."""
    text = ":".join(map(str, (seed, *purpose)))
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big") >> 1


def stream(seed: int, *purpose: str | int, device: torch.device | str = "cpu") -> torch.Generator:
    """Return a generator for one purpose on ``device``."""
    return torch.Generator(device).manual_seed(derive(seed, *purpose))


@contextmanager
def seeded(seed: int, *purpose: str | int) -> Iterator[None]:
    """For code that draws from torch's global generators (initial weights, dropout).

    What they held before is put back.
    """
    devices = list(range(torch.cuda.device_count())) if torch.cuda.is_available() else []
    with torch.random.fork_rng(devices):
        torch.manual_seed(derive(seed, *purpose))
        yield
