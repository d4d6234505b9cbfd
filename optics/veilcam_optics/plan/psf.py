"""What a mask makes of one point of light: the point spread function a plan stands for."""

from dataclasses import replace

from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.inputs import check_weights
from veilcam_optics.effects.composition import beams, shown
from veilcam_optics.effects.model import Model
from veilcam_optics.errors import require_count
from veilcam_optics.transfer.operator import Reach, TransferOperator

_POINT = 0.01
"""Side of the point's image, in cells: it blurs by as much."""


def psf(model: Model, weights: Tensor, rows: int) -> Tensor:
    """Irradiance of a scene point on the axis, as means over equal cells that cover the sensor.

    It is the transfer from a scene of one very small pixel to an embedding of many.

    Args:
        model: what is computed, and how finely.
        weights: amplitude transmittances asked of the panel, ``camera.mask_shape``.
        rows: cells along the sensor's short side; those along the long one are about square.

    Returns:
        (3, rows, columns), relative to the irradiance at the mask; differentiable.

    Raises:
        OpticsError: the mask has another shape or holds NaN; no rows.
    """
    require_count("rows", rows)
    check_weights(weights, model.camera)
    cells = psf_cells(model.camera, rows)
    side = _POINT * model.camera.sensor.height / rows
    point = Scene(1, 1, side * model.scene.distance / model.camera.distance, model.scene.distance)
    sampling = model.sampling
    operator = TransferOperator(
        model.camera,
        point,
        cells,
        reach=sampling.reach if sampling.diffraction else Reach(0, 0),
        step=min(sampling.step, model.camera.sensor.height / rows / 4),
        colour=True,
        dtype=sampling.dtype,
        beams=beams(model),
        approximation=replace(model.approximation, point_binning=False),
        imperfections=model.conditions.imperfections,
    )
    values: Tensor = operator(shown(model, weights.to(sampling.dtype)))
    return values.reshape(-1, *cells.shape)


def psf_cells(camera: Camera, rows: int) -> Embedding:
    """So many rows of cells over the whole sensor, and columns that make them about square."""
    return Embedding(rows, max(1, round(rows * camera.sensor.width / camera.sensor.height)))
