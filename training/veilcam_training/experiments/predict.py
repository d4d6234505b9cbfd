"""Labels of picture files, as a simulated camera with a bundle tells them."""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from veilcam_optics.camera.masks import to_weights
from veilcam_optics.decoding import Precision
from veilcam_optics.pictures import KINDS, PictureError, as_scene, read_picture
from veilcam_optics.sensor.readout import photon_snr_db
from veilcam_training.bundle import Bundle, BundleError, Network, classifier_inputs
from veilcam_training.data.folders import pictures_below, shown
from veilcam_training.encoders.base import FixedEncoder, Setup
from veilcam_training.encoders.imperfections import make_operators
from veilcam_training.errors import TrainingError, require
from veilcam_training.seeding import stream

SNR_DB = 40.0
"""Signal-to-noise ratio where a bundle records none: that of a simulated daemon [dB]."""


@dataclass(frozen=True)
class Prediction:
    """Label of one picture."""

    path: Path
    label: str
    confidence: float
    """Score of the label, in [0, 1], as a daemon answers it."""


def find_pictures(paths: Iterable[Path]) -> list[Path]:
    """Return the files among ``paths``, and all pictures below the folders among them.

    Raises:
        TrainingError: a path is missing, or a folder holds no picture.
    """
    found: list[Path] = []
    for path in paths:
        require(path.exists(), f"{shown(path)} is missing: give a picture, or a folder of pictures")
        inside = pictures_below(path)[0] if path.is_dir() else [path]
        require(bool(inside), f"{shown(path)} holds no picture: use files of {KINDS}")
        found += inside
    return found


def predict(bundle: Bundle, paths: Iterable[Path]) -> Iterator[Prediction]:
    """Yield the label of each picture; the same call gives the same ones.

    Every picture is shown as a fit shows it, behind the first mask of :meth:`Bundle.masks`, with
    the noise of the fit. The classifier is that of the mask, computed as on a device.

    Args:
        bundle: bundle read from its file.
        paths: picture files.

    Raises:
        TrainingError: a picture cannot be read.
        BundleError: the classifier gives NaN or infinity.
    """
    levels = next(bundle.masks())
    tolerance = Setup.tolerance if bundle.light is None else bundle.light.tolerance
    setup = Setup(
        bundle.camera,
        bundle.scene,
        bundle.embedding,
        colour=bundle.channels == 3,
        tolerance=tolerance,
    )
    (operator,) = make_operators(setup)
    with torch.no_grad():
        transfer = operator(torch.from_numpy(to_weights(levels, bundle.camera.panel)))
    camera = FixedEncoder(setup, [transfer.float()])
    reader = bundle.pairs[0] if bundle.fresh is None else bundle.fresh
    network, decoder = Network.load(reader.layers, reader.weights), None
    if bundle.fresh is not None:
        frame = bundle.fresh.frame(bundle.camera, bundle.scene, bundle.embedding)
        decoder = frame.decoding(precision=Precision.DOUBLE).prepare(frame.shown(levels))
    snr_db, noise = _snr_db(bundle), stream(0, "predict")
    for path in paths:
        inputs = camera.add_noise(camera(_scene(bundle, path)), snr_db, noise).numpy()
        if decoder is not None:
            inputs = classifier_inputs(decoder, inputs).astype(np.float32)
        logits = network(inputs)[0].astype(np.float64)
        if not np.isfinite(logits).all():
            raise BundleError("a classifier gives NaN or infinity: train it again")
        powers = np.exp(logits - logits.max())
        best = int(powers.argmax())
        yield Prediction(path, bundle.labels[best], float(powers[best] / powers.sum()))


def _scene(bundle: Bundle, path: Path) -> Tensor:
    shape = bundle.scene.shape if bundle.channels == 1 else (3, *bundle.scene.shape)
    try:
        return torch.from_numpy(as_scene(read_picture(path), shape))[None]
    except PictureError as error:
        raise TrainingError(f"{shown(path)} {error}") from None


def _snr_db(bundle: Bundle) -> float:
    """Return the signal-to-noise ratio of the fit, as far as the bundle records it [dB]."""
    if bundle.fresh is not None:
        return bundle.fresh.noise.snr_db
    settings = bundle.provenance.get("settings")
    found = settings.get("snr_db", SNR_DB) if isinstance(settings, Mapping) else SNR_DB
    if found == "photons":
        return photon_snr_db(bundle.camera, bundle.embedding, colour=bundle.channels == 3)
    return float(found) if isinstance(found, int | float) else math.inf
