"""Memory of this process: no core file, one small heap for all threads, no needless searches."""

from __future__ import annotations

import ctypes
import gc
import resource
from collections.abc import Iterator
from contextlib import contextmanager

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
"""Of glibc's malloc.h."""

_APART = 8 * 2**20
"""Blocks from this size [B] on are no part of the heap, and leave no holes in it."""

_KEPT = 16 * 2**20
"""What may be free at the heap's end before it goes back to the machine [B]."""


def forbid_core_files() -> None:
    """Let neither this process nor what it starts write a core file, and let nobody undo that.

    A handler that the kernel hands cores to (``core_pattern`` with a pipe) is told of the limit,
    and systemd's keeps to it. Swap is the service manager's affair (``MemorySwapMax=``).
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def share_one_heap() -> None:
    """Have all threads take memory from one heap without large holes, where the C library can.

    Fields of light are megabytes that come and go on several threads. glibc gives each thread a
    heap of its own, which keeps what was freed in it for that thread alone, and takes ever larger
    blocks from the heaps (mallopt(3)). With all blocks apart a simulated camera has 500 MB at its
    peak, but the kernel's pages of zeros take as long as the light; with the largest apart, 574.
    """
    adjust = getattr(ctypes.CDLL(None), "mallopt", None)
    if adjust is not None:
        adjust(_M_ARENA_MAX, 1)
        adjust(_M_MMAP_THRESHOLD, _APART)
        adjust(_M_TRIM_THRESHOLD, _KEPT)


@contextmanager
def no_garbage() -> Iterator[None]:
    """Keep all that is made meanwhile, and never search it for garbage: a tenth of a start."""
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()
