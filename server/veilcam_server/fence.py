"""The fence around an exposure: what must hold for a reading to belong to one mask alone."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from veilcam_server.devices.protocols import Exposure
from veilcam_server.errors import FenceError


@dataclass(frozen=True, slots=True)
class Fence:
    """How a reading is kept from mixing two masks."""

    settle: float = 0.1
    """Given to the panel after a write; measured once per panel, 100 ms to start from [s]."""
    timeout: float = 5.0
    """Longest wait for one reading [s]."""

    def __post_init__(self) -> None:
        if not (math.isfinite(self.settle) and self.settle >= 0):
            raise ValueError(f"settle = {self.settle} s is not valid: use a number >= 0")
        if not (math.isfinite(self.timeout) and self.timeout > 0):
            raise ValueError(f"timeout = {self.timeout} s is not valid: use a number > 0")


def check_exposure(
    exposure: Exposure, *, not_before: float, ended: float, shape: tuple[int, ...]
) -> None:
    """Refuse a reading that cannot be trusted.

    Args:
        exposure: as the sensor gave it.
        not_before: when the mask had settled, monotonic [s].
        ended: when the sensor returned.
        shape: of an embedding.

    Raises:
        FenceError: exposed before or after that, of another shape, or not finite.
    """
    if not not_before <= exposure.started_at <= exposure.ended_at <= ended:
        raise FenceError(
            f"the exposure began {exposure.started_at - not_before:+.4f} s after the mask had "
            "settled and was thrown away: try again"
        )
    if exposure.embedding.shape != shape:
        raise FenceError(
            f"the sensor gave a reading of shape {exposure.embedding.shape}, "
            f"not {shape}: check that the bundle fits this device"
        )
    if not bool(np.isfinite(exposure.embedding).all()):
        raise FenceError("the sensor gave a reading that is not finite: try again")
