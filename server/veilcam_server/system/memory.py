"""Memory of this process: none of it goes into a core file, and what is free goes back."""

from __future__ import annotations

import ctypes
import resource


def forbid_core_files() -> None:
    """Let neither this process nor what it starts write a core file, and let nobody undo that.

    A handler that the kernel hands cores to (``core_pattern`` with a pipe) is told of the limit,
    and systemd's keeps to it. Swap is the service manager's affair (``MemorySwapMax=``).
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def give_back_free_memory() -> None:
    """Hand what was freed back to the machine, where the C library can (glibc's ``malloc_trim``).

    Fields of light are tens of megabytes that come and go on several threads. The C library keeps
    what they leave, a heap for each thread, and after some hundred captures that is more than all
    that is in use.
    """
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
