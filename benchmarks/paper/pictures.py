"""What a camera makes of a point, and of a few images: arrays for a report.

These show how a mask spreads light; they belong into a report made offline, not on a device.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Embedding, Scene
from veilcam_optics.files import replacing
from veilcam_training.config.settings import FitSettings
from veilcam_training.data import Images
from veilcam_training.encoders import Digital, LearnedMask, make_encoder
from veilcam_training.errors import TrainingError
from veilcam_training.models.lensless import LenslessClassifier
from veilcam_training.seeding import stream

PSF_SHAPE = Embedding(95, 127)
EXAMPLES = 3

Pixels = npt.NDArray[np.float32]


@dataclass(frozen=True)
class Pictures:
    """Arrays in [0, 1]: each PSF and each embedding is scaled to its own brightest value."""

    psf: Pixels | None
    """(rows, columns) or (rows, columns, 3); None for what is no camera."""
    scenes: Pixels
    """(count, rows, columns) or (count, rows, columns, 3): the first validation images."""
    embeddings: Pixels
    """As the scenes, but of the embedding: what the sensor reads of them, noise included."""


def make_pictures(model: LenslessClassifier, settings: FitSettings, validation: Images) -> Pictures:
    """Pictures of a fitted model, with the first images of the validation part."""
    setup, seed = model.encoder.setup, settings.seed
    device = next(model.parameters()).device
    images = validation.scenes(slice(0, EXAMPLES)).to(device)
    was_training = model.training
    model.eval()
    with torch.no_grad():
        scenes = model.change(images, stream(seed, "pictures", "change"))
        measurements = model.embed(images, stream(seed, "pictures", "change"))
        if model.snr_db is not None:
            noise = stream(seed, "pictures", "noise", device=device)
            measurements = model.encoder.add_noise(measurements, model.snr_db, noise)
        psf = point_image(model, settings)
    model.train(was_training)
    shape = (len(images), setup.channels, *setup.embedding.shape)
    return Pictures(
        psf=psf,
        scenes=_last(scenes.reshape(len(images), setup.channels, *scenes.shape[-2:])),
        embeddings=_last(_scaled(measurements.reshape(shape))),
    )


def point_image(model: LenslessClassifier, settings: FitSettings) -> Pixels | None:
    """What a point on the axis becomes on the sensor, finer than any embedding.

    The same camera, read with small pixels, looks at a scene of one small pixel.
    """
    encoder = model.encoder
    if isinstance(encoder, Digital):
        return None
    setup = replace(
        encoder.setup,
        scene=Scene(1, 1, 1e-4, encoder.setup.scene.distance),
        embedding=PSF_SHAPE,
        point_binning=False,
        finer=(),
    )
    camera = make_encoder(
        settings.encoder, setup, stream(settings.seed, "encoder"), psf=settings.psf_file
    )
    if isinstance(encoder, LearnedMask) and isinstance(camera, LearnedMask):
        camera.weights.copy_(encoder.weights.cpu())
    camera.eval()
    image = camera.transfer().reshape(1, setup.channels, *PSF_SHAPE.shape)
    pixels: Pixels = _last(_scaled(image))[0]
    return pixels


def save_pictures(path: Path, pictures: Pictures) -> None:
    """Write an ``.npz`` with 8 bits for each value, whole or not at all."""
    arrays = {"scenes": pictures.scenes, "embeddings": pictures.embeddings}
    if pictures.psf is not None:
        arrays["psf"] = pictures.psf
    with replacing(path) as stream:
        np.savez_compressed(
            stream,
            allow_pickle=False,
            **{name: np.round(255 * array).astype(np.uint8) for name, array in arrays.items()},
        )


def load_pictures(path: Path) -> Pictures:
    """Read what :func:`save_pictures` wrote.

    Raises:
        TrainingError: the file is missing or damaged.
    """
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as content:
            arrays = {name: (content[name] / 255).astype(np.float32) for name in content}
        return Pictures(arrays.get("psf"), arrays["scenes"], arrays["embeddings"])
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        raise TrainingError(
            f"{path} holds no pictures of a cell: remove {path.parent} to run it again"
        ) from None


def _scaled(images: Tensor) -> Tensor:
    """Bring each image from its least value (0 for light) to its largest into [0, 1]."""
    least = images.amin((1, 2, 3), keepdim=True).clamp_max(0)
    span = images.amax((1, 2, 3), keepdim=True) - least
    return (images - least) / torch.where(span > 0, span, 1)


def _last(images: Tensor) -> Pixels:
    """Channels last, or none for gray, as pictures are drawn."""
    array = images.permute(0, 2, 3, 1).cpu().numpy().astype(np.float32)
    return array[..., 0] if array.shape[-1] == 1 else array
