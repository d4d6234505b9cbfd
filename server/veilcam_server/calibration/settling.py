"""Settling time of the panel: black to white and back, seen by the camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from veilcam_server.calibration.rig import Moment, Rig
from veilcam_server.errors import CalibrationError

SETTLED = 0.02
"""Largest distance from the end, over the step, that counts as settled."""


@dataclass(frozen=True, slots=True)
class Settling:
    """Times since the panel's last byte [s]."""

    seconds: float
    """An exposure that starts no earlier sees a settled panel."""
    uncertainty: float
    """Distance of the samples there [s]."""
    residual: float
    """How far the measurements taken as settled scatter, root mean square over the step."""
    rising: tuple[Moment, ...]
    """From opaque to open; means from 0 to 1."""
    falling: tuple[Moment, ...]


def measure_settling(rig: Rig, *, longest: float, samples: int) -> Settling:
    """Sample both steps at equal distances, then more finely where they end.

    Args:
        rig: rig in front of a lit scene.
        longest: longest time that settling may take [s].
        samples: number of samples of each step and of each of the two passes.

    Raises:
        CalibrationError: it takes longer.
    """
    steps: tuple[list[Moment], list[Moment]] = ([], [])
    low, high = 0.0, longest
    end = rig.after(rig.opaque, longest).mean
    for _ in range(2):
        for delay in np.linspace(low, high, samples):
            for moments, levels in zip(steps, (rig.open, rig.opaque), strict=True):
                begin = end
                seen = rig.after(levels, float(delay))
                # What it comes to, and the beginning of the next step.
                end = rig.after(levels, longest).mean
                if end == begin:
                    raise CalibrationError(
                        "the panel shows nothing of what it is told: check its power and wiring"
                    )
                moments.append(
                    Moment(seen.started, seen.ended, (seen.mean - begin) / (end - begin))
                )
        low, high = (max(ends) for ends in zip(*(_ends(each) for each in steps), strict=True))
        if high == np.inf:
            raise CalibrationError(
                f"the panel has not settled after {longest * 1000:.3g} ms: give a longer --settle, "
                "or hold the light still"
            )
    settled = [each for moments in steps for each in moments if each.started >= high]
    return Settling(
        seconds=high,
        uncertainty=high - low,
        residual=float(np.sqrt(np.mean([(1 - each.mean) ** 2 for each in settled]))),
        rising=_in_order(steps[0]),
        falling=_in_order(steps[1]),
    )


def _ends(moments: list[Moment]) -> tuple[float, float]:
    """Start of the last exposure that was not settled (or 0), and of the next one (or inf)."""
    last, first = 0.0, np.inf
    for moment in reversed(_in_order(moments)):
        if abs(1 - moment.mean) > SETTLED:
            last = moment.started
            break
        first = moment.started
    return last, first


def _in_order(moments: list[Moment]) -> tuple[Moment, ...]:
    return tuple(sorted(moments, key=lambda moment: moment.started))
