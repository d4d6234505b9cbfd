"""No core file of a daemon, however it is ended; and memory that is free is the machine's."""

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


BLOCKS = """
import ctypes
from pathlib import Path
from veilcam_server.system.memory import give_back_large_blocks

SIZE, COUNT = 4 * 2**20, 20
libc = ctypes.CDLL(None)
libc.malloc.restype = ctypes.c_void_p
libc.malloc.argtypes = [ctypes.c_size_t]
libc.free.argtypes = [ctypes.c_void_p]

def resident():
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096

def filled(size):
    block = libc.malloc(size)
    ctypes.memset(block, 1, size)
    return block

SET
libc.free(filled(4 * SIZE))  # from then on glibc takes blocks of this size from its heap
before = resident()
blocks = []
for _ in range(COUNT):
    blocks.append(filled(SIZE))
    filled(2**16)  # stays, and keeps the heap from shrinking
for block in blocks:
    libc.free(block)
print((resident() - before) / (SIZE * COUNT))
"""


def kept(setting: str) -> float:
    """Share of large blocks that a process keeps after it freed them."""
    command = [sys.executable, "-c", BLOCKS.replace("SET", setting)]
    return float(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallopt"), reason="glibc's malloc alone")
def test_large_blocks_that_are_freed_go_back() -> None:
    # All of a block goes with it: what else the interpreter takes meanwhile is less than a tenth.
    assert kept("give_back_large_blocks()") < 0.1
    assert kept("") > 0.9


def test_no_core_file_is_written() -> None:
    # In a process of its own: a hard limit that was lowered stays low.
    command = [sys.executable, "-c", FORBID]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == "(0, 0)\n"
