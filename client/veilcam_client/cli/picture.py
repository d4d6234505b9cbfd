"""Pictures in a terminal: two values a character, as greys of 256 colours."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from veilcam_client.numbers import flat

DARKEST, GREYS = 232, 24
"""The first grey of the 256 colours of a terminal (xterm), and how many there are."""


def in_blocks(values: npt.NDArray[np.float32]) -> str:
    """Draw an array; the smallest value is the darkest.

    Args:
        values: (rows, columns), or (channels, rows, columns), which are drawn side by side.
    """
    across = flat(values)
    low, high = across.min(), across.max()
    greys = DARKEST + np.rint((across - low) * ((GREYS - 1) / ((high - low) or 1.0))).astype(int)
    if len(greys) % 2:
        greys = np.concatenate([greys, np.full_like(greys[:1], DARKEST)])
    return "\n".join(
        "".join(
            f"\x1b[38;5;{upper};48;5;{lower}m▀" for upper, lower in zip(above, below, strict=True)
        )
        + "\x1b[0m"
        for above, below in zip(greys[::2], greys[1::2], strict=True)
    )
