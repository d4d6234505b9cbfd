"""Proof that the panel hides the scene: what a self test found, and for how long it holds."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from veilcam_server.devices.protocols import Device
from veilcam_server.fence import Fence
from veilcam_server.self_test import SelfTest

EVERY = 600.0
"""Longest that a test holds, unless it is said otherwise [s]."""


class Proof:
    """Holds from a test that passed until the panel is set up anew, or until it is too old.

    Args:
        test: what decides.
        device: that is tested.
        fence: times to keep.
        every: longest time that it holds [s].
        clock: monotonic time [s].

    Raises:
        ValueError: a time that cannot be.
    """

    def __init__(
        self,
        test: SelfTest,
        device: Device,
        fence: Fence,
        *,
        every: float = EVERY,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        if not (math.isfinite(every) and every > 0):
            raise ValueError(f"every = {every} s is not valid: use a number > 0")
        self._test, self._device, self._fence = test, device, fence
        self._every, self._clock = every, clock
        self._ends, self._resets = -math.inf, 0

    def holds_for(self) -> float:
        """Seconds for which it holds still; 0 if it does not."""
        if self._device.display.resets != self._resets:
            return 0.0
        return max(0.0, self._ends - self._clock())

    def void(self, device: Device, fence: Fence) -> None:
        """Test again before anything is believed.

        Args:
            device: from now on.
            fence: times to keep from now on.
        """
        self._device, self._fence, self._ends = device, fence, -math.inf

    def renew(self) -> None:
        """Test now; raises as :meth:`SelfTest.run`, and then there is no proof any more."""
        self._ends = -math.inf
        resets = self._device.display.resets
        self._test.run(self._device, self._fence)
        # Set up anew in the middle of the test, the panel may have forgotten what was tested.
        self._resets, self._ends = resets, self._clock() + self._every
