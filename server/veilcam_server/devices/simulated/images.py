"""Pictures of any size and colour as scenes: grey, of the scene's size.

Values are taken as reflectances, as training takes them: no gamma is undone.
"""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from PIL import Image

Picture = npt.NDArray[np.generic]
Reflectance = npt.NDArray[np.float32]

MAX_PIXELS = 2**25
"""A picture may have so many; a small file can claim to have many more."""
LUMA = (0.299, 0.587, 0.114)
"""Shares of red, green and blue in grey (ITU-R BT.601)."""
_NPY = b"\x93NUMPY"


class PictureError(ValueError):
    """This is no picture; the message goes on after its name."""


def as_scene(picture: bytes | Picture, shape: tuple[int, int]) -> Reflectance:
    """Return a picture as a scene: as large as fits, its sides' ratio kept, black around it.

    Args:
        picture: content of a ``.npy``, PNG or JPEG file, which its first bytes tell; or an array,
            (rows, columns) or (rows, columns, 3), of uint8 or uint16, the largest number being
            white, or floats in [0, 1]. A file is turned upright as it says, and black is behind
            what is transparent.
        shape: rows and columns of the scene, whose pixels are square.

    Raises:
        PictureError: it is none of those, or damaged, or too large.
    """
    return _fitted(_decoded(picture) if isinstance(picture, bytes) else picture, shape)


def _decoded(content: bytes) -> Picture:
    # With the extra `simulate` alone, as torch: who has no simulated camera holds nothing up to it.
    from PIL import Image, ImageOps, UnidentifiedImageError  # noqa: PLC0415

    try:
        if content.startswith(_NPY):
            array: Picture = np.load(io.BytesIO(content), allow_pickle=False)
            return array
        with Image.open(io.BytesIO(content), formats=("PNG", "JPEG")) as image:
            _require_size(image.width * image.height)
            return _pixels(ImageOps.exif_transpose(image))
    except PictureError:
        raise
    # A damaged file makes Pillow raise whatever its decoders come across, SyntaxError included.
    except (UnidentifiedImageError, OSError, ValueError, EOFError, SyntaxError, MemoryError):
        raise PictureError("is no image: use .npy, PNG or JPEG") from None


def _fitted(picture: Picture, shape: tuple[int, int]) -> Reflectance:
    grey = _grey(_reflectance(picture))
    scale = min(wanted / given for wanted, given in zip(shape, grey.shape, strict=True))
    inner = tuple(max(1, round(scale * given)) for given in grey.shape)
    if inner != grey.shape:
        import torch  # noqa: PLC0415 - as Pillow

        from veilcam_optics.propagation.sampling import area_average  # noqa: PLC0415

        # Of pixels that come together, the light is averaged; rounding may leave [0, 1].
        grey = area_average(torch.from_numpy(grey).double(), *inner).clamp(0, 1).float().numpy()
    if inner == shape:
        return grey
    scene = np.zeros(shape, np.float32)
    top, left = ((wanted - given) // 2 for wanted, given in zip(shape, inner, strict=True))
    scene[top : top + inner[0], left : left + inner[1]] = grey
    return scene


def _pixels(image: Image.Image) -> Picture:
    if image.mode.startswith("I"):
        return np.asarray(image).astype(np.uint16)  # PNG has no more than 16 bits
    if image.has_transparency_data:
        # Not Image.alpha_composite, which would need a black image of the same size.
        values = np.asarray(image.convert("RGBA")).astype(np.float32) / 255
        return np.asarray(values[..., :3] * values[..., 3:])
    return np.asarray(image.convert("L" if image.mode in ("1", "L") else "RGB"))


def _reflectance(picture: Picture) -> Reflectance:
    if picture.ndim not in (2, 3) or picture.shape[2:] not in ((), (3,)) or picture.size == 0:
        raise PictureError(
            f"has the shape {picture.shape}: use (rows, columns), or (rows, columns, 3) for colour"
        )
    _require_size(picture.shape[0] * picture.shape[1])
    for kind in (np.uint8, np.uint16):
        if picture.dtype == kind:
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
