"""Settings of a fit: all that its result depends on, besides the files of the data set."""

import hashlib
import math
from pathlib import Path
from typing import Annotated, Literal, Self

import torch
from pydantic import BaseModel, Field, model_validator

from veilcam_optics.camera.geometry import Camera, Embedding
from veilcam_optics.errors import OpticsError
from veilcam_optics.sensor.readout import photon_snr_db
from veilcam_training.data import Source
from veilcam_training.encoders.fresh import Misalignment
from veilcam_training.encoders.imperfections import PanelErrors
from veilcam_training.encoders.psf import PsfFile
from veilcam_training.errors import TrainingError, require
from veilcam_training.models.classifiers import Exposure, Normalisation
from veilcam_training.transforms.augmentation import Augmentation

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=1, le=2**20)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]
Rate = Annotated[float, Field(gt=0, le=10, allow_inf_nan=False)]
Tolerance = Annotated[float, Field(gt=0, lt=1, allow_inf_nan=False)]


def parse_embedding(text: str) -> Embedding:
    """Embedding from rows, columns and fill, as :meth:`.Embedding.parse` reads it.

    Raises:
        TrainingError: not of that form, or out of range.
    """
    try:
        return Embedding.parse(text)
    except OpticsError as error:
        valid = str(error).partition(": ")[2]
        raise TrainingError(f"embedding {text!r} is not valid: {valid}") from None


def one_cycle(progress: float, *, warm_up: float, lowest: float) -> float:
    """Factor on a learning rate: it rises at first, and then falls as a cosine.

    Args:
        progress: share of the fit that is done, in [0, 1).
        warm_up: share of the fit in which the rate rises.
        lowest: factor that it does not fall below.
    """
    if progress < warm_up:
        return 0.04 + 0.96 * progress / warm_up
    falling = (progress - warm_up) / (1 - warm_up)
    return max(lowest, 0.5 * (1 + math.cos(math.pi * falling)))


class FreshMasks(BaseModel, frozen=True, extra="forbid", strict=True):
    """Masks of a fit of one classifier to many, each used for a moment only."""

    placement: Literal["centred", "anywhere"] = "centred"
    """``anywhere``: the object lies anywhere fully in the field of view."""
    exponent: Positive = 1.0
    """Masks are ``u ** exponent`` for uniform ``u``, rounded to the panel's levels."""
    spread: Annotated[float, Field(gt=0, le=1)] | None = None
    """Learn a range of ``u`` for each sub-pixel, this much to both sides of a centre."""
    misalignment: Misalignment | None = Misalignment()
    model_error: NotNegative = 0.0
    """Relative error of the response that the decoder expects."""
    masks: Count = 100
    """Masks that each view of the training images is measured behind."""
    validation_masks: Count = 20


class FitSettings(BaseModel, frozen=True, extra="forbid", strict=True):
    """All that the result of a fit depends on. The default values are not tuned to any task."""

    data: str = "mnist"
    encoder: str = "learned"
    psf: Path | None = None
    """File of a measured point spread function; the encoder ``fixed_measured`` needs it."""
    psf_pitch: Positive | None = None
    """Side of its cells, where the file does not say it [m]."""
    psf_distance: Positive | None = None
    """From the coding element to the sensor, where the file does not say it [m]."""
    embedding: str = "24x32"
    binning: Literal["area", "point"] = "area"
    """Averaged over each embedding pixel, or at its centre as in the paper's code."""
    change: Literal["none", "shift", "rescale", "rotate", "perspective"] = "none"
    """How images are shown to the camera, in training and in testing."""
    classifier: str = "LR"
    fresh: FreshMasks | None = None
    """Masks that are drawn anew all the time; None for one mask that stays."""
    seed: Seed = 0
    epochs: Annotated[int, Field(ge=1, le=10_000)] = 50
    batch: Annotated[int, Field(ge=2, le=65_536)] = 512
    """Images in one step."""
    optimiser: Literal["adam", "sgd", "nesterov"] = "adam"
    """``nesterov`` is for ``Scene<width>``: momentum 0.85, and faster biases."""
    rate: Rate = 3e-3
    """Learning rate of the classifier, at its highest."""
    mask_rate: Rate = 3e-2
    """Learning rate of the encoder, at its highest: mask weights have a range of 1."""
    mask_start: Literal["random", "pinhole"] = "random"
    """What a learned mask starts from: random weights, or one open pixel before a dim ground."""
    hidden: bool = True
    """Keep the copies of the scene behind a learned mask many, so that no eye sees one."""
    end_to_end: bool = False
    """Learn mask and ``Scene<width>`` together in a second stage, half as long as the first; other
    classifiers are always learned so."""
    weight_decay: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Decoupled weight decay of the classifier (AdamW); the encoder has none."""
    schedule: Literal["one_cycle", "steps", "constant"] = "one_cycle"
    """``one_cycle`` warms up and then falls as a cosine; ``steps`` divides by 10."""
    warm_up: Annotated[float, Field(ge=0, lt=1)] = 0.15
    """Share of a ``one_cycle`` schedule in which the rate rises."""
    steps_every: Annotated[int, Field(ge=1)] = 20
    """Epochs between two divisions of a ``steps`` schedule."""
    normalisation: Normalisation = "per_pixel"
    """How a classifier takes a measurement, see :mod:`veilcam_training.models.classifiers`."""
    exposure: Exposure = "fixed"
    """Of a measurement, see :data:`veilcam_training.models.classifiers.Exposure`."""
    label_smoothing: Annotated[float, Field(ge=0, lt=1)] = 0.0
    averaging: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Decay per step of the running mean of the classifier's weights, which takes their place in
    validation and after the fit; 0 keeps the weights themselves."""
    pooling: Annotated[int, Field(ge=1, le=16)] = 1
    """Side, in scene pixels, of a pixel of the estimated scene, for classifiers that read one."""
    rank: Annotated[int, Field(ge=1, le=2**12)] = 512
    """Principal components of the scene that its estimate uses."""
    dropout: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Of the classifier's hidden layers."""
    patience: Annotated[int, Field(ge=1)] | None = None
    """Epochs without a better validation accuracy after which fitting stops; None: never."""
    precision: Literal["full", "mixed"] = "full"
    """``mixed`` fits the classifier in bfloat16 on a processor that has it."""
    jitter: Augmentation = Augmentation()
    """Random changes of the training images."""
    panel_errors: PanelErrors = PanelErrors()
    """How the panel errs in training."""
    snr_db: (
        Annotated[float, Field(allow_inf_nan=False, ge=-20, le=200)] | Literal["photons"] | None
    ) = 40.0
    """Signal-to-noise ratio of a measurement [dB]; None for no noise, ``photons`` for that of an
    exposure at full well, see :func:`.photon_snr_db`."""
    tolerance: Tolerance = 3e-3
    """Relative L2 error that the light is planned to, at the embedding: a third of the noise at
    40 dB."""

    @model_validator(mode="after")
    def _fit_together(self) -> Self:
        if self.fresh is not None:
            plain = FitSettings()
            for name in ("encoder", "psf", "binning", "change", "end_to_end"):
                if getattr(self, name) != getattr(plain, name):
                    raise ValueError(f"fresh masks have no {name}: leave it out")
        if self.normalisation == "white" and self.precision == "mixed":
            raise ValueError(
                "normalisation 'white' tells apart what bfloat16 rounds away: use precision 'full'"
            )
        if self.normalisation == "white" and self.averaging:
            raise ValueError(
                "normalisation 'white' changes its coordinates in a fit, and weights in different "
                "coordinates have no mean: use averaging 0"
            )
        return self

    def rate_factor(self, progress: float) -> float:
        """Factor on both learning rates when ``progress``, in [0, 1), of the fit is done."""
        if self.schedule == "constant":
            return 1.0
        if self.schedule == "steps":
            return float(0.1 ** (math.floor(progress * self.epochs + 1e-9) // self.steps_every))
        return one_cycle(progress, warm_up=self.warm_up, lowest=1e-4)

    @property
    def transform(self) -> Augmentation | None:
        """Augmentation of the training images; None if there is none."""
        return self.jitter if self.jitter.any else None

    @property
    def without_mirror(self) -> Augmentation | None:
        """Augmentation of estimates, of which mirror images are measured; None if there is none."""
        left = self.jitter.model_copy(update={"mirror": False})
        return left if left.any else None

    def fingerprint(self, source: Source) -> str:
        """SHA-256 of the settings and of the data: two fits are the same if these are."""
        files = sorted(source.digests().items())
        if self.psf is not None:
            files.append(("psf", hashlib.sha256(self.psf.read_bytes()).hexdigest()))
        # What is in the file counts, not where it lies.
        chosen = self.model_copy(update={"psf": None}).model_dump_json()
        return hashlib.sha256(f"{chosen} {files} torch {torch.__version__}".encode()).hexdigest()

    def noise_db(self, camera: Camera, *, colour: bool) -> float | None:
        """Return the signal-to-noise ratio in numbers [dB]; None for no noise.

        Args:
            camera: camera of the fit.
            colour: True for images in colour.
        """
        if self.snr_db != "photons":
            return self.snr_db
        return photon_snr_db(camera, parse_embedding(self.embedding), colour=colour)

    @property
    def psf_file(self) -> PsfFile | None:
        """The measured point spread function.

        Raises:
            TrainingError: a pitch or a distance of none.
        """
        if self.psf is None:
            require(
                self.psf_pitch is None and self.psf_distance is None,
                "there is no measured PSF: leave out --psf-pitch and --psf-distance",
            )
            return None
        return PsfFile(self.psf, self.psf_pitch, self.psf_distance)
