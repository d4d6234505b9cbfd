"""Parts of a scene, and which of its pixels send any light.

What is black costs nothing: an object in a large scene needs the transfer of its own place alone,
and a batch of handwritten digits only that of the pixels that one of them touches.
"""

from collections.abc import Callable
from dataclasses import dataclass

from veilcam_optics.arrays import Array, device, namespace, needs_gradient
from veilcam_optics.camera.geometry import Scene
from veilcam_optics.errors import require

MOSTLY_LIT = 0.9
"""Share of lit pixels above which picking them out does not pay."""


@dataclass(frozen=True, slots=True)
class Region:
    """Part of a scene: ``rows x columns`` of its pixels, the first of them at (top, left)."""

    top: int
    left: int
    rows: int
    columns: int

    def check(self, scene: Scene) -> None:
        """Raise :class:`OpticsError` unless this is wholly in ``scene``."""
        below, beside = self.top + self.rows, self.left + self.columns
        require(
            min(self.top, self.left) >= 0
            and min(self.rows, self.columns) >= 1
            and (below <= scene.rows and beside <= scene.columns),
            "region",
            self,
            "",
            f"a part of the scene's {scene.rows} x {scene.columns} pixels",
        )


def embed_lit(scenes: Array, region: Region, transfer: Callable[[Region], Array]) -> Array:
    """Embeddings of scenes, at the cost of those pixels that are lit in any of them.

    Args:
        scenes: (batch, rows, columns) of ``region``.
        region: part of a scene that is shown; the rest is black.
        transfer: function of a region that gives its matrix (pixels, embedding pixels).

    Returns:
        (batch, embedding pixels).
    """
    xp = namespace(scenes)
    flat: Array = xp.reshape(scenes, (scenes.shape[0], scenes.shape[1] * scenes.shape[2]))
    lit = _lit(scenes)
    values: Array
    if lit is None:
        values = flat @ transfer(region)
        return values
    rows, columns = lit
    top, left = int(xp.min(rows)), int(xp.min(columns))
    height, width = int(xp.max(rows)) - top + 1, int(xp.max(columns)) - left + 1
    matrix = transfer(Region(region.top + top, region.left + left, height, width))
    wanted: Array = xp.take(matrix, (rows - top) * width + (columns - left), axis=0)
    seen: Array = xp.take(flat, rows * region.columns + columns, axis=1)
    values = seen @ wanted
    return values


def _lit(scenes: Array) -> tuple[Array, Array] | None:
    """Rows and columns of the pixels that are lit in any scene, unless they are most or none."""
    # An accelerator would have to wait for their number, and its product is short as it is. A
    # gradient with respect to the scenes is asked for at black pixels too.
    if str(device(scenes)) != "cpu" or needs_gradient(scenes) or not scenes.shape[0]:
        return None
    xp = namespace(scenes)
    lit = (xp.max(scenes, axis=0) != 0) | (xp.min(scenes, axis=0) != 0)
    rows, columns = xp.nonzero(lit)
    count = lit.shape[0] * lit.shape[1]
    return (rows, columns) if 0 < rows.shape[0] <= MOSTLY_LIT * count else None
