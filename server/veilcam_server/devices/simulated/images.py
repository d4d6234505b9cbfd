"""Pictures of any size and colour as scenes: of the scene's size, grey or in colour.

Values are taken as reflectances, as training takes them: no gamma is undone.
"""

from __future__ import annotations

import io
import math

import numpy as np
import numpy.typing as npt

from veilcam_optics import pictures
from veilcam_optics.pictures import PictureError, read_picture, used_range

Picture = npt.NDArray[np.generic]
Reflectance = npt.NDArray[np.float32]

MAX_PIXELS = 2**25
"""A picture may have so many; a small file can claim to have many more."""
_NPY = b"\x93NUMPY"


def as_scene(picture: bytes | Picture, shape: tuple[int, ...]) -> Reflectance:
    """Return a picture as a scene, as a fit takes it: see :func:`veilcam_optics.pictures.as_scene`.

    Args:
        picture: content of a file as :func:`decoded` takes it, or an array.
        shape: (rows, columns) of the scene; (3, rows, columns) in colour.

    Raises:
        PictureError: it is no picture, or too large.
    """
    values = decoded(picture) if isinstance(picture, bytes) else picture
    if (pixels := math.prod(values.shape[:2])) > MAX_PIXELS:
        raise PictureError(f"has {pixels} pixels: use at most {MAX_PIXELS}")
    return pictures.as_scene(values, shape)


def decoded(content: bytes) -> Picture:
    """Return the picture in a ``.npy`` file, or in one that ``read_picture`` takes.

    Raises:
        PictureError: it is neither, or damaged, or too large.
    """
    if not content.startswith(_NPY):
        return read_picture(content, most=MAX_PIXELS)
    try:
        array: Picture = np.load(io.BytesIO(content), allow_pickle=False)
    except Exception:  # its header may hold anything
        raise PictureError("is no image: its .npy file is damaged, or holds no numbers") from None
    return array


def range_warning(picture: Picture) -> str | None:
    """Return what to say of a picture of :func:`as_scene` that uses little of its range."""
    used = used_range(picture)
    return None if used is None else f"uses only {used}: spread its values over the range"
