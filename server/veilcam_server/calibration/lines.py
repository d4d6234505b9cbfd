"""Rows and columns of the mask that do not obey: each is opened alone."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from veilcam_optics.transfer.product import Transfer
from veilcam_server.calibration.rig import Geometry, Rig, Values
from veilcam_server.errors import CalibrationError

_DEAD = 0.5
"""A line with less than this share of the light that its neighbours let through is dead."""
_MOST = 0.25
"""Largest share of dead lines along an axis."""


@dataclass(frozen=True, slots=True)
class Lines:
    """Light of each opened row and column, over the light expected."""

    rows: Values = field(repr=False)
    columns: Values = field(repr=False)

    @property
    def dead_rows(self) -> tuple[int, ...]:
        """Numbers of the dead rows, from 0."""
        return _dead(self.rows)

    @property
    def dead_columns(self) -> tuple[int, ...]:
        """Numbers of the dead columns, from 0."""
        return _dead(self.columns)


def measure_lines(rig: Rig, geometry: Geometry, image: Values, transfer: Transfer[Any]) -> Lines:
    """Open each row and each column alone.

    Args:
        rig: rig in front of ``image``.
        geometry: the nominal camera.
        image: (rows, columns) of the scene.
        transfer: transfer of the nominal camera: it gives the light expected of each line.

    Raises:
        CalibrationError: so many do not obey that the panel cannot be used.
    """
    rows, columns = geometry.camera.mask_shape
    floor = rig.read(rig.opaque).mean()
    top = int(np.max(rig.open))
    scene = image.reshape(1, -1)
    found = []
    for count, axis in ((rows, 0), (columns, 1)):
        shares = np.empty(count)
        for line in range(count):
            opened = np.zeros((rows, columns), np.uint8)
            opened.swapaxes(0, axis)[line] = top
            expected = float((scene @ transfer(opened / top)).mean())
            shares[line] = (rig.read(opened).mean() - floor) / expected
        typical = float(np.median(shares))
        if not typical > 0:
            raise CalibrationError("single lines let no light through: light the card, try again")
        found.append(shares / typical)
    lines = Lines(*found)
    for name, dead, count in (
        ("rows", lines.dead_rows, rows),
        ("columns", lines.dead_columns, columns),
    ):
        if len(dead) > _MOST * count:
            raise CalibrationError(
                f"{len(dead)} of {count} {name} of the mask do not obey: check the panel's "
                "wiring and that the card is evenly lit"
            )
    return lines


def _dead(shares: Values) -> tuple[int, ...]:
    return tuple(int(line) for line in np.flatnonzero(shares < _DEAD))
