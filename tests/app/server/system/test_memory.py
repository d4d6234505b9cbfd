"""No core file of a daemon, however it is ended; and memory that one thread freed is for all."""

from __future__ import annotations

import ctypes
import subprocess
import sys

import pytest

FORBID = """
import resource
from veilcam_server.system.memory import forbid_core_files
soft, hard = resource.getrlimit(resource.RLIMIT_CORE)
resource.setrlimit(resource.RLIMIT_CORE, (hard, hard))
forbid_core_files()
print(resource.getrlimit(resource.RLIMIT_CORE))
"""


THREADS = 4
BLOCKS = f"""
import ctypes, threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from veilcam_server.system.memory import share_one_heap

SIZE = 4 * 2**20
libc = ctypes.CDLL(None)
libc.malloc.restype = ctypes.c_void_p
libc.malloc.argtypes = [ctypes.c_size_t]
libc.free.argtypes = [ctypes.c_void_p]

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096

def fill_and_free(_):
    everyone.wait()  # so that each takes one turn
    with turn:
        size = sizes.pop()
        block = libc.malloc(size)
        ctypes.memset(block, 1, size)
        libc.free(block)
    everyone.wait()

SET
libc.free(libc.malloc(2 * SIZE))  # from then on glibc takes blocks of this size from its heaps
turn, everyone = threading.Lock(), threading.Barrier({THREADS})
# Each smaller than the one before: what the interpreter puts in a hole meanwhile leaves enough.
sizes = [SIZE - SIZE // 16 * smaller for smaller in reversed(range({THREADS}))]
before = resident()
with ThreadPoolExecutor({THREADS}) as threads:
    list(threads.map(fill_and_free, range({THREADS})))
    print((resident() - before) / SIZE)
"""


def kept(setting: str) -> float:
    """Blocks that a process keeps after each of its threads had one and freed it."""
    command = [sys.executable, "-c", BLOCKS.replace("SET", setting)]
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallopt"), reason="glibc's malloc alone")
def test_threads_use_what_others_freed() -> None:
    # One block, or all four, which are 3.6 of the first's size. What the interpreter takes
    # meanwhile is far from half of a block.
    assert kept("share_one_heap()") < 1.5
    assert kept("") > 3


def test_no_core_file_is_written() -> None:
    # In a process of its own: a hard limit that was lowered stays low.
    command = [sys.executable, "-c", FORBID]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == "(0, 0)\n"
