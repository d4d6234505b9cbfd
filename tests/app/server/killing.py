"""Writers that are killed at a moment that nobody chose."""

from __future__ import annotations

import os
import random
import signal
import time
from collections.abc import Callable, Iterator


def kill_writers(write: Callable[[int], Iterator[int]], found: Callable[[int], int]) -> int:
    """Kill a forked writer thirty times, and return the last number on the disk.

    write: writes on from a number, and yields each number that it acknowledges.
    found: checks what is on the disk against the last acknowledged number, and returns its own.
    """
    said = 0
    for _ in range(30):
        told, tell = os.pipe()
        child = os.fork()
        if child == 0:
            try:
                for number in write(said):
                    os.write(tell, number.to_bytes(4))
            finally:
                os._exit(1)
        os.close(tell)
        # So many numbers on any machine, and then one at a moment that nobody chose.
        for _ in range(random.randrange(8)):
            said = int.from_bytes(os.read(told, 4))
        time.sleep(random.uniform(0.0, 0.01))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        while left := os.read(told, 4):
            said = int.from_bytes(left)
        os.close(told)
        said = found(said)
    return said
