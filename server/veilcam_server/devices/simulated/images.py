"""Pictures of any size and colour as scenes: of the scene's size, grey or in colour.

Values are taken as reflectances, as training takes them: no gamma is undone.
"""

from __future__ import annotations

import io

import numpy as np
import numpy.typing as npt

from veilcam_optics.pictures import PictureError, read_picture, used_range

Picture = npt.NDArray[np.generic]
Reflectance = npt.NDArray[np.float32]

MAX_PIXELS = 2**25
"""A picture may have so many; a small file can claim to have many more."""
LUMA = (0.299, 0.587, 0.114)
"""Shares of red, green and blue in grey (ITU-R BT.601)."""
_NPY = b"\x93NUMPY"


def as_scene(picture: bytes | Picture, shape: tuple[int, ...]) -> Reflectance:
    """Return a picture as a scene: as large as fits, its sides' ratio kept, black around it.

    Args:
        picture: content of a file as :func:`decoded` takes it; or an array, (rows, columns) or
            (rows, columns, 3), of uint8 or uint16, the largest number being white, or floats in
            [0, 1].
        shape: (rows, columns) of the scene, whose pixels are square; (3, rows, columns) in colour.

    Raises:
        PictureError: it is none of those, or too large.
    """
    values = _reflectance(decoded(picture) if isinstance(picture, bytes) else picture)
    if len(shape) == 2:
        return _fitted(_grey(values), shape)
    planes = [values] * 3 if values.ndim == 2 else np.moveaxis(values, 2, 0)
    return np.stack([_fitted(plane, shape[1:]) for plane in planes])


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


def _fitted(grey: Reflectance, shape: tuple[int, ...]) -> Reflectance:
    scale = min(wanted / given for wanted, given in zip(shape, grey.shape, strict=True))
    inner = tuple(max(1, round(scale * given)) for given in grey.shape)
    if inner != grey.shape:
        import torch  # noqa: PLC0415 - with the extra `simulate` alone

        from veilcam_optics.propagation.sampling import area_average  # noqa: PLC0415

        # Of pixels that come together, the light is averaged; rounding may leave [0, 1].
        grey = area_average(torch.from_numpy(grey).double(), *inner).clamp(0, 1).float().numpy()
    if inner == shape:
        return grey
    scene = np.zeros(shape, np.float32)
    top, left = ((wanted - given) // 2 for wanted, given in zip(shape, inner, strict=True))
    scene[top : top + inner[0], left : left + inner[1]] = grey
    return scene


def _reflectance(picture: Picture) -> Reflectance:
    if picture.ndim not in (2, 3) or picture.shape[2:] not in ((), (3,)) or picture.size == 0:
        raise PictureError(
            f"has the shape {picture.shape}: use (rows, columns), or (rows, columns, 3) for colour"
        )
    _require_size(picture.shape[0] * picture.shape[1])
    for kind in (np.uint8, np.uint16):
        if picture.dtype.newbyteorder("=") == kind:
            return np.asarray(picture.astype(np.float32) / np.float32(np.iinfo(kind).max))
    if picture.dtype.kind != "f":
        raise PictureError("holds no reflectances: use uint8, uint16, or floats in [0, 1]")
    values = picture.astype(np.float32)
    if not bool(((values >= 0) & (values <= 1)).all()):  # nor is NaN
        raise PictureError("holds no reflectances: use uint8, uint16, or floats in [0, 1]")
    return values


def _grey(values: Reflectance) -> Reflectance:
    if values.ndim == 2:
        return values
    return np.asarray((values @ np.array(LUMA, np.float32)).clip(0, 1), np.float32)


def _require_size(pixels: int) -> None:
    if pixels > MAX_PIXELS:
        raise PictureError(f"has {pixels} pixels: use at most {MAX_PIXELS}")
