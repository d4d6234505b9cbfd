"""Memory of this process: no core file has it, and its threads share one heap."""

from __future__ import annotations

import ctypes
import resource

_M_ARENA_MAX = -8
"""Of glibc's malloc.h."""


def forbid_core_files() -> None:
    """Let neither this process nor what it starts write a core file, and let nobody undo that.

    A handler that the kernel hands cores to (``core_pattern`` with a pipe) is told of the limit,
    and systemd's keeps to it. Swap is the service manager's affair (``MemorySwapMax=``).
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def share_one_heap() -> None:
    """Have all threads take memory from one heap, where the C library can.

    Fields of light are tens of megabytes that come and go on several threads. glibc gives each
    thread a heap of its own, which keeps what was freed in it for that thread alone: a simulated
    camera has 580 MB at its peak, and 500 with one heap (mallopt(3)). Blocks that go back to the
    machine at once leave 450, and cost more than the light: each comes back in pages of zeros, and
    a capture takes 2.5 times as long.
    """
    adjust = getattr(ctypes.CDLL(None), "mallopt", None)
    if adjust is not None:
        adjust(_M_ARENA_MAX, 1)
