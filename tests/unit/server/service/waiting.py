"""Waiting for what another task or thread does."""

from __future__ import annotations

import asyncio
from collections.abc import Callable


async def until(condition: Callable[[], bool]) -> None:
    """Wait for what must happen; the test's own time-out ends a wait that is in vain."""
    while not condition():
        await asyncio.sleep(0.002)
