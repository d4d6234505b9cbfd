"""Cameras that are known by their point spread function (PSF): simulated elsewhere, or measured."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Embedding, Scene, Sensor
from veilcam_optics.pictures import KINDS, SUFFIXES, PictureError, read_picture, used_range
from veilcam_optics.propagation.sampling import axis, coverage
from veilcam_optics.transfer.binning import TransferBinning
from veilcam_optics.transfer.field_angle import fading
from veilcam_training.data.base import UNREADABLE
from veilcam_training.encoders.base import FixedEncoder, Setup
from veilcam_training.errors import TrainingError, require


@dataclass(frozen=True)
class Psf:
    """A PSF on square cells centred on the axis; what falls outside counts as dark.

    ``irradiance`` is (3, rows, columns) for R, G, B; ``pitch`` the side of a cell [m];
    ``distance`` from the coding element to the sensor [m], which sets the scene's scale there;
    ``warning`` is what to say of its file.
    """

    irradiance: Tensor
    pitch: float
    distance: float
    warning: str | None = None


class PsfEncoder(FixedEncoder):
    """A camera with one PSF for the whole scene."""

    def __init__(self, setup: Setup, psf: Psf) -> None:
        super().__init__(setup, [_transfer(setup, scene, psf) for scene in setup.grids])


def _transfer(setup: Setup, scene: Scene, psf: Psf) -> Tensor:
    camera = replace(setup.camera, distance=psf.distance)
    if setup.point_binning:
        image = scene.pixel_at_sensor(camera)
        channels = point_transfer(psf, camera.sensor, scene, setup.embedding, image=image)
    else:
        rows, columns = psf.irradiance.shape[1:]
        binning = TransferBinning(
            camera,
            scene,
            setup.embedding,
            shape=(rows, columns),
            pitch=psf.pitch,
            dtype=psf.irradiance.dtype,
        )
        channels = binning(psf.irradiance)
    if not setup.colour:
        shares = torch.tensor(camera.sensor.channel_weights, dtype=channels.dtype)
        channels = torch.einsum("c,cpe->pe", shares, channels)
    fade = torch.from_numpy(fading(scene)).reshape(-1, 1)
    return (channels * fade).float()


def point_transfer(
    psf: Psf, sensor: Sensor, scene: Scene, embedding: Embedding, *, image: float
) -> Tensor:
    """Transfer (3, scene pixels, embedding pixels) to the centres of the embedding pixels.

    Args:
        psf: the PSF.
        sensor: is read.
        scene: is seen.
        embedding: embedding whose pixels' centres are where the sensor is read.
        image: side of a scene pixel's geometric image on the sensor [m].
    """
    rows, columns = psf.irradiance.shape[1:]
    boxes = []
    for length, pixels, scene_pixels, cells in (
        (sensor.height, embedding.rows, scene.rows, rows),
        (sensor.width, embedding.columns, scene.columns, columns),
    ):
        # A scene point falls on the other side of the axis: the offset to it is a sum.
        at = (axis(scene_pixels, image)[:, None] + axis(pixels, length / pixels)).flatten()
        covered = coverage(at - image / 2, at + image / 2, cells, psf.pitch)
        boxes.append(covered * (psf.pitch / (scene_pixels * image)))
    y, x = (box.to(psf.irradiance.dtype) for box in boxes)
    split = (y @ psf.irradiance @ x.T).reshape(
        3, scene.rows, embedding.rows, scene.columns, embedding.columns
    )
    return split.transpose(2, 3).reshape(3, scene.rows * scene.columns, embedding.size)


@dataclass(frozen=True)
class PsfFile:
    """File of a measured PSF, and the numbers that it leaves open.

    ``pitch`` is the side of its cells [m], which a picture and an array cannot tell; ``distance``
    [m] is from the coding element to the sensor.
    """

    path: Path
    pitch: float | None = None
    distance: float | None = None


def read_psf(file: PsfFile, distance: float) -> Psf:
    """Read a measured PSF.

    An ``.npz`` file holds ``psf``, (rows, columns) or (3, rows, columns), not negative; ``pitch``,
    the side of its cells [m]; and may hold ``distance`` [m]. An ``.npy`` file is the array alone,
    or (rows, columns, 3), as pictures are. A picture is proportional to the irradiance, without
    gamma and with the dark level taken off, as developed from raw; of 8 bits a channel, or of 16
    bits or floats in gray.

    Args:
        file: and what it leaves open.
        distance: distance where neither the option nor the file gives one [m].

    Raises:
        TrainingError: the file is missing, damaged or not such a file; a pitch that is told twice
            or not at all.
    """
    path = file.path
    require(path.is_file(), f"{path} is missing: give the file of a PSF as --psf")
    try:
        content = _content(path)
    except PictureError as error:
        raise TrainingError(f"{path} {error}") from None
    except UNREADABLE as error:
        raise TrainingError(
            f"{path} is not the file of a PSF ({error}): save psf and pitch with numpy.savez, or "
            f"give an array (.npy) or a picture ({KINDS})"
        ) from None
    require(
        content.pitch is None or file.pitch is None,
        f"{path} tells its pitch by itself: leave out --psf-pitch",
    )
    require(
        content.distance is None or file.distance is None,
        f"{path} tells its distance by itself: leave out --psf-distance",
    )
    psf = (
        content.psf
        if content.psf.ndim != 2
        else np.broadcast_to(content.psf, (3, *content.psf.shape))
    )
    require(
        psf.ndim == 3 and len(psf) == 3 and psf.size != 0,
        f"{path} has a PSF of shape {psf.shape}: use (3, rows, columns)",
    )
    require(
        bool(np.isfinite(psf).all() and np.min(psf) >= 0 and np.max(psf) > 0),
        f"{path} has a PSF that is no irradiance: use finite numbers >= 0",
    )
    pitch = content.pitch or file.pitch
    if pitch is None:
        raise TrainingError(f"{path} does not tell the side of its cells: give --psf-pitch METRES")
    distance = content.distance or file.distance or distance
    require(
        0 < pitch < 1 and 0 < distance < 1,
        f"{path} has pitch {pitch} m and distance {distance} m: use metres, > 0",
    )
    values = torch.from_numpy(np.ascontiguousarray(psf, np.float32))
    warning = None if content.used is None else f"{path} uses only {content.used}"
    return Psf(values, pitch, distance, warning)


class _Content(NamedTuple):
    psf: npt.NDArray[np.float32]
    pitch: float | None = None
    distance: float | None = None
    used: str | None = None


def _content(path: Path) -> _Content:
    if path.suffix.lower() in SUFFIXES:
        shown = read_picture(path)
        return _Content(
            np.asarray(shown if shown.ndim == 2 else np.moveaxis(shown, 2, 0), dtype=np.float32),
            used=None if shown.dtype.kind == "f" else used_range(shown),
        )
    with path.open("rb") as file:
        loaded = np.load(file, allow_pickle=False)
        if isinstance(loaded, np.ndarray):
            array = np.asarray(loaded, dtype=np.float32)
            last = array.ndim == 3 and array.shape[2] == 3 and array.shape[0] != 3
            return _Content(np.moveaxis(array, 2, 0) if last else array)
        with loaded as content:
            return _Content(
                np.asarray(content["psf"], dtype=np.float32),
                float(content["pitch"]),
                float(content["distance"]) if "distance" in content else None,
            )
