"""Parts of a scene, and which of its pixels send any light.

What is black costs nothing: an object in a large scene needs the transfer of its own place alone,
and a batch of handwritten digits only that of the pixels that one of them touches.
"""

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor

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


def embed_lit(scenes: Tensor, region: Region, transfer: Callable[[Region], Tensor]) -> Tensor:
    """Embeddings of scenes, at the cost of those pixels that are lit in any of them.

    Args:
        scenes: (batch, rows, columns) of ``region``.
        region: which part of a scene that is; the rest is black.
        transfer: from a region to its matrix (pixels, embedding pixels).

    Returns:
        (batch, embedding pixels).
    """
    flat = scenes.flatten(1)
    lit = _lit(scenes)
    if lit is None:
        return flat @ transfer(region)
    rows, columns = lit
    top, left = int(rows.min()), int(columns.min())
    height, width = int(rows.max()) - top + 1, int(columns.max()) - left + 1
    matrix = transfer(Region(region.top + top, region.left + left, height, width))
    wanted = matrix.index_select(0, (rows - top) * width + (columns - left))
    return flat.index_select(1, rows * region.columns + columns) @ wanted


def _lit(scenes: Tensor) -> tuple[Tensor, Tensor] | None:
    """Rows and columns of the pixels that are lit in any scene, unless they are most or none."""
    # An accelerator would have to wait for their number, and its product is short as it is. A
    # gradient with respect to the scenes is asked for at black pixels too.
    if scenes.device.type != "cpu" or scenes.requires_grad or not len(scenes):
        return None
    lit = scenes.amax(0).ne(0) | scenes.amin(0).ne(0)
    rows, columns = lit.nonzero(as_tuple=True)
    return (rows, columns) if 0 < len(rows) <= MOSTLY_LIT * lit.numel() else None
