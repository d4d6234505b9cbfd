"""A point spread function that was measured: an image of a point source, background removed."""

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from veilcam_optics.errors import OpticsError, require
from veilcam_optics.pictures import PictureError, read_picture, white


def read_image(path: Path) -> Tensor:
    """Return an image file as float64 in [0, 1]: (rows, columns) gray or (3, rows, columns).

    8 and 16 bit files; 16 bit in gray only. Values are taken as they are: a raw frame is linear, a
    photograph for display has a curve to undo first.

    Raises:
        OpticsError: If the file cannot be read as an image of 8 or 16 bit.
    """
    try:
        values = read_picture(path)
    except PictureError as error:
        raise OpticsError(f"cannot read the image {path.name}: it {error}") from None
    require(values.dtype.kind == "u", "path", str(values.dtype), "", "an image of 8 or 16 bit")
    scaled = torch.from_numpy(values.astype(np.float64) / white(values))
    return scaled if scaled.ndim == 2 else scaled.permute(2, 0, 1).contiguous()


def remove_background(image: Tensor, *, margin: float = 0.02, deviations: float = 3.0) -> Tensor:
    """Return an image without what a dark room leaves in it.

    Level and noise of the background are the median and the spread (1.4826 times the median
    absolute deviation) of a frame along the edges, per channel; what does not rise above the level
    by ``deviations`` times the spread is set to zero, from the rest the level is subtracted.

    Args:
        image: Shape (..., rows, columns).
        margin: Width of the frame as a share of the sides.
        deviations: height above the background at which light begins, in standard deviations.

    Raises:
        OpticsError: If ``margin`` is not in (0, 0.5), ``deviations`` is negative, or NaN is found.
    """
    require(0 < margin < 0.5, "margin", margin, "", "a share between 0 and 0.5")
    require(deviations >= 0, "deviations", deviations, "", "a number >= 0")
    if not bool(torch.isfinite(image).all()):
        raise OpticsError("image holds NaN or infinity: use finite values")
    rows, columns = image.shape[-2:]
    deep = max(1, round(rows * margin)), max(1, round(columns * margin))
    frame = torch.ones(rows, columns, dtype=torch.bool, device=image.device)
    frame[deep[0] : rows - deep[0], deep[1] : columns - deep[1]] = False
    outside = image[..., frame]
    level = outside.median(dim=-1).values[..., None, None]
    spread = 1.4826 * (outside - level[..., 0]).abs().median(dim=-1).values[..., None, None]
    risen = image - level
    return torch.where(risen > deviations * spread, risen, torch.zeros_like(risen))


def normalise_psf(image: Tensor, energy: float = 1.0) -> Tensor:
    """Return the image scaled so that all channels together sum to ``energy`` per channel.

    Channels keep their ratio. An image without any light has no PSF and is refused.

    Raises:
        OpticsError: If the image is dark.
    """
    channels = image.shape[-3] if image.ndim > 2 else 1
    total = image.sum()
    if not float(total) > 0:
        raise OpticsError("the image has no light left: use a longer exposure or a smaller margin")
    return image * (energy * channels / total)


def measured_psf(path: Path, *, margin: float = 0.02, deviations: float = 3.0) -> Tensor:
    """Read an image of a point source and return its PSF, of sum 1 per channel on average.

    Raises:
        OpticsError: As :func:`read_image`, :func:`remove_background` and :func:`normalise_psf`.
    """
    image = remove_background(read_image(path), margin=margin, deviations=deviations)
    return normalise_psf(image)
