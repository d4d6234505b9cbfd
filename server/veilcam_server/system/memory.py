"""Memory of this process, which holds keys: none of it goes into a core file."""

from __future__ import annotations

import resource


def forbid_core_files() -> None:
    """Let neither this process nor what it starts write a core file, and let nobody undo that.

    A handler that the kernel hands cores to (``core_pattern`` with a pipe) is told of the limit,
    and systemd's keeps to it. Swap is the service manager's affair (``MemorySwapMax=``).
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
