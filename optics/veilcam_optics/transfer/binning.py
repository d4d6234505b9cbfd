"""Transfer matrix of a sampled point spread function: means over pixels, cell by cell."""

import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Scene


def transfer_boxes(
    *,
    length: float,
    pixels: int,
    fill: float = 1.0,
    scene_pixels: int,
    image: float,
    cells: int,
    pitch: float,
) -> Tensor:
    """Return the weight of each cell of one axis for each (scene pixel, embedding pixel).

    The weight is the integral over the cell of ``kappa``, the overlap of an embedding pixel's box
    with a scene pixel's image, exact for irradiance that is constant on each cell.

    Args:
        length: side of the sensor [m], cut into ``pixels`` embedding pixels.
        pixels: embedding pixels along the axis.
        fill: side of the averaged box of each, as a share of the pixel.
        scene_pixels: scene pixels along the axis.
        image: side of a scene pixel's geometric image on the sensor [m].
        cells: cells of the irradiance along the axis, centred.
        pitch: side of a cell [m].

    Returns:
        float64 (scene_pixels * pixels, cells), the scene pixel running slower.
    """
    embedding = (torch.arange(pixels, dtype=torch.float64) - (pixels - 1) / 2) * (length / pixels)
    pixel = fill * length / pixels
    # A scene point at s falls at -s d2/d1 (inverted), so the offset to it is o + s d2/d1.
    scene = (torch.arange(scene_pixels, dtype=torch.float64) - (scene_pixels - 1) / 2) * image
    offsets = (scene[:, None] + embedding).reshape(-1, 1)
    edges = (torch.arange(cells + 1, dtype=torch.float64) - cells / 2) * pitch
    outer, inner = (pixel + image) / 2, abs(pixel - image) / 2
    below = torch.zeros(len(offsets), cells + 1, dtype=torch.float64)
    for corner, sign in ((-outer, 1.0), (-inner, -1.0), (inner, -1.0), (outer, 1.0)):
        below += sign * (edges - offsets - corner).clamp_min(0).square() / 2
    return below.diff(dim=1) / (pixel * scene_pixels * image)


class TransferBinning:
    """Turns a point spread function on square cells, centred on the axis, into a transfer matrix.

    Args:
        camera: gives the sensor's sides and the scene's scale.
        scene: scene whose pixels are the rows of the matrix.
        embedding: embedding whose pixels are the columns of the matrix.
        shape: cells (rows, columns) of the irradiance; what falls outside counts as dark.
        pitch: side of a cell [m].
        dtype: type of irradiance and matrix.
    """

    def __init__(
        self,
        camera: Camera,
        scene: Scene,
        embedding: Embedding,
        *,
        shape: tuple[int, int],
        pitch: float,
        dtype: torch.dtype = torch.float64,
    ) -> None:
        self.scene, self.embedding = scene, embedding
        rows, columns = axis_boxes(camera, scene, embedding, shape, pitch)
        self._rows, self._columns = rows.to(dtype), columns.to(dtype).T

    def __call__(self, irradiance: Tensor) -> Tensor:
        """Return the matrix from (..., rows, columns), relative to the irradiance at the mask.

        Returns:
            (..., scene pixels, embedding pixels).
        """
        return as_matrix(self._rows @ irradiance @ self._columns, self.scene, self.embedding)


def axis_boxes(
    camera: Camera, scene: Scene, embedding: Embedding, shape: tuple[int, ...], pitch: float
) -> tuple[Tensor, Tensor]:
    """Return :func:`transfer_boxes` along y and along x."""
    rows, columns = (
        transfer_boxes(
            length=length,
            pixels=pixels,
            fill=embedding.fill,
            scene_pixels=scene_pixels,
            image=scene.pixel_at_sensor(camera),
            cells=cells,
            pitch=pitch,
        )
        for length, pixels, scene_pixels, cells in (
            (camera.sensor.height, embedding.rows, scene.rows, shape[0]),
            (camera.sensor.width, embedding.columns, scene.columns, shape[1]),
        )
    )
    return rows, columns


def as_matrix(transfer: Tensor, scene: Scene, embedding: Embedding) -> Tensor:
    """(..., scene rows x pixel rows, scene columns x pixel columns) to (..., scene, embedding)."""
    leading = transfer.shape[:-2]
    split = transfer.reshape(
        -1, scene.rows, embedding.rows, scene.columns, embedding.columns
    ).permute(0, 1, 3, 2, 4)
    return split.reshape(*leading, scene.rows * scene.columns, embedding.size)
