"""The door for arrays that come in: masks and scenes, refused alike by whatever computes light."""

from types import EllipsisType

from veilcam_optics.arrays import Array, ends, namespace
from veilcam_optics.camera.geometry import Camera
from veilcam_optics.errors import OpticsError, require, require_shape

_ROUNDING = 1e-5
"""What rounding may add to a value in [0, 1], in float32 and after a resampling."""


def check_weights(weights: Array, camera: Camera, *, batched: bool = False) -> None:
    """Raise :class:`OpticsError` unless ``weights`` is a mask for ``camera``; if ``batched``, many.

    Amplitude transmittances: real floating-point numbers from 0 (dark) to 1 (open). The message
    never holds a weight: a mask is a secret.
    """
    shape, window = tuple(weights.shape), camera.mask_shape
    fits = shape[1:] == window if batched else shape == window
    require(fits, "weights.shape", shape, "", f"the window, {window}")
    _check_values("weights", weights, "amplitude transmittances")


def check_scenes(scenes: Array, *axes: int | str | EllipsisType) -> None:
    """Raise :class:`OpticsError` unless ``scenes`` hold reflectances from 0 to 1.

    Args:
        scenes: real floating-point numbers.
        axes: lengths of the axes, as :func:`~veilcam_optics.errors.require_shape` takes them.
    """
    require_shape("scenes", scenes, *axes)
    _check_values("scenes", scenes, "reflectances")


def _check_values(argument: str, values: Array, what: str) -> None:
    xp = namespace(values)
    real = xp.isdtype(values.dtype, "real floating")
    require(real, f"{argument}.dtype", values.dtype, "", "float32 or float64")
    if 0 in values.shape:
        return
    low, high = ends(values)
    # Both are NaN where one value is: then neither comparison holds.
    if low >= -_ROUNDING and high <= 1 + _ROUNDING:
        return
    if not bool(xp.all(xp.isfinite(values))):
        raise OpticsError(f"{argument} hold NaN or infinity: use finite numbers in [0, 1]")
    outside = int(xp.sum((values < -_ROUNDING) | (values > 1 + _ROUNDING)))
    raise OpticsError(
        f"{argument} hold {outside} values outside [0, 1]: use {what} without a unit, 0 to 1"
    )
