"""What a panel can show instead of the mask that is due."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from benchmarks.proof.cameras import Build
from benchmarks.proof.light import Singles

from veilcam_optics.keys.masks import Levels

Fault = Literal["dead", "bare", "stuck", "lost", "inverted", "opaque"]
"""``dead``: the window is transparent and what is around it opaque, as behind a frame; ``bare``:
all of the panel is transparent; ``stuck``: the mask before is shown; ``lost``: the one before
that; ``inverted``: black is white, around the window too."""
FAULTS: tuple[Fault, ...] = get_args(Fault)
SHIFTS = tuple(
    (lines, 0) if along == "rows" else (0, lines)
    for along in ("rows", "columns")
    for lines in (-3, -2, -1, 1, 2, 3)
)


def fault_patches(build: Build, due: Levels, before: Levels, earlier: Levels) -> Singles:
    """Amplitudes of the panel in each of :data:`FAULTS`, (faults, rows, columns).

    What passes around the window and its margin is not the patch's: see
    :meth:`~benchmarks.proof.light.Optics.uncovered`.
    """
    top = build.camera.panel.levels - 1
    white, black = np.full_like(due, top), np.zeros_like(due)
    return np.stack(
        [
            build.patch(white),
            build.patch(white, around=top),
            build.patch(before),
            build.patch(earlier),
            build.patch((top - due).astype(due.dtype), around=top),
            build.patch(black),
        ]
    )


def shifted_patches(build: Build, due: Levels) -> Singles:
    """Amplitudes of the panel for each of :data:`SHIFTS`, (shifts, rows, columns)."""
    return np.stack([build.patch(due, moved=moved) for moved in SHIFTS])
