"""Memory of this process: no core file has it, and large blocks that are free go back."""

from __future__ import annotations

import ctypes
import resource

_M_MMAP_THRESHOLD = -3
"""Of glibc's malloc.h."""
_LARGE = 2**18
"""Smaller than any field of light [bytes]."""


def forbid_core_files() -> None:
    """Let neither this process nor what it starts write a core file, and let nobody undo that.

    A handler that the kernel hands cores to (``core_pattern`` with a pipe) is told of the limit,
    and systemd's keeps to it. Swap is the service manager's affair (``MemorySwapMax=``).
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def give_back_large_blocks() -> None:
    """Have large blocks go back to the machine when they are freed, where the C library can.

    Fields of light are tens of megabytes that come and go on several threads. Once one was freed,
    glibc takes blocks of that size from its heaps, one for each thread, and keeps what they leave
    there: a simulated camera had 600 MB at its peak, and has 530 this way. A threshold that was set
    is not moved any more (mallopt(3)).
    """
    adjust = getattr(ctypes.CDLL(None), "mallopt", None)
    if adjust is not None:
        adjust(_M_MMAP_THRESHOLD, _LARGE)
