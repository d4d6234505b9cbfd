"""One fit from its settings: data, camera and classifier are made, fitted and tested once."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import torch
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding
from veilcam_training.bundle import Accuracy, Pair
from veilcam_training.config.recipes import Recipe
from veilcam_training.data import Images, Source, Split, split
from veilcam_training.encoders import Encoder, Mask, Setup, make_encoder
from veilcam_training.errors import TrainingError
from veilcam_training.models.classifiers import Task, make_layers
from veilcam_training.models.lensless import LenslessClassifier
from veilcam_training.models.whitening import plain
from veilcam_training.seeding import seeded, stream
from veilcam_training.trainer.distributed import ALONE, Ranks
from veilcam_training.trainer.evaluation import confusion, evaluate
from veilcam_training.trainer.loop import Fit, Observer, fit
from veilcam_training.transforms.scene import make_transform


def parse_embedding(text: str) -> Embedding:
    """Embedding from rows and columns, e.g. ``24x32``.

    Raises:
        TrainingError: not of that form, or zero.
    """
    match = re.fullmatch(r"([1-9]\d{0,3})x([1-9]\d{0,3})", text)
    if match is None:
        raise TrainingError(f"embedding {text!r} is not valid: use ROWSxCOLUMNS, e.g. 24x32")
    return Embedding(int(match[1]), int(match[2]))


class Settings(BaseModel):
    """All that the result of a fit depends on, besides the files of the data set."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)

    data: str = "mnist"
    encoder: str = "learned"
    psf: Path | None = None
    """File of the point spread function of the encoder ``fixed_measured``."""
    embedding: str = "24x32"
    reading: Literal["area", "point"] = "area"
    """Averaged over each embedding pixel, or at its centre as in the paper's code."""
    change: Literal["none", "shift", "rescale", "rotate", "perspective"] = "none"
    """How images are shown to the camera, in training and in testing."""
    classifier: str = "LR"
    seed: Annotated[int, Field(ge=0, lt=2**63)] = 0
    recipe: Recipe = Recipe()

    def fingerprint(self, source: Source) -> str:
        """SHA-256 of the settings and of the data: two fits are the same if these are."""
        files = sorted(source.digests().items())
        if self.psf is not None:
            files.append(("psf", hashlib.sha256(self.psf.read_bytes()).hexdigest()))
        # What is in the file counts, not where it lies.
        chosen = self.model_copy(update={"psf": None}).model_dump_json()
        text = f"{chosen} {files} torch {torch.__version__}"
        return hashlib.sha256(text.encode()).hexdigest()


@dataclass(frozen=True)
class Outcome:
    """A fit and its one look at the test set."""

    settings: Settings
    fit: Fit
    accuracy: Accuracy
    confusion: Tensor
    """Of the test set, see :func:`veilcam_training.trainer.evaluation.confusion`."""


def make_model(settings: Settings, source: Source, camera: Camera) -> LenslessClassifier:
    """The model that ``settings`` describe, not fitted yet.

    Raises:
        TrainingError: an unknown encoder or classifier, or an embedding that is none.
    """
    embedding = parse_embedding(settings.embedding)
    change = make_transform(settings.change, source.scene, camera)
    setup = Setup(
        camera,
        change.scene,
        embedding,
        colour=source.colour,
        point_reading=settings.reading == "point",
        finer=change.finer,
    )
    encoder = make_encoder(
        settings.encoder,
        setup,
        stream(settings.seed, "encoder"),
        psf=settings.psf,
        errors=settings.recipe.panel_errors,
        pinhole=settings.recipe.mask_start == "pinhole",
    )
    task = Task(
        channels=setup.channels,
        rows=embedding.rows,
        columns=embedding.columns,
        classes=len(source.labels),
        rectified=encoder.trainable,
        normalisation=settings.recipe.normalisation,
        gain=white_gain(encoder),
        exposure=settings.recipe.exposure,
    )
    layers = make_layers(settings.classifier, task, dropout=settings.recipe.dropout)
    with seeded(settings.seed, "classifier"):
        return LenslessClassifier(
            encoder,
            layers,
            settings.recipe.snr_db,
            change=change,
            mixed_precision=settings.recipe.precision == "mixed",
            decorrelated=settings.recipe.normalisation == "white",
        )


def white_gain(encoder: Encoder) -> float:
    """Factor that brings the reading of a white scene to a root mean square of 1, to 3 digits."""
    encoder.eval()  # without the errors of a panel, which are drawn at random
    with torch.no_grad():
        white = encoder.transfer().sum(-2).square().mean().sqrt().item()
    encoder.train()
    return float(f"{1 / white:.3g}") if white > 0 else 1.0


def run_job(
    settings: Settings,
    source: Source,
    camera: Camera,
    *,
    training: Images | None = None,
    device: torch.device | str = "cpu",
    checkpoint: Path | None = None,
    observers: Sequence[Observer] = (),
    ranks: Ranks = ALONE,
) -> Outcome:
    """Fit, select on the validation split, then look at the test set once.

    Args:
        settings: what to fit and how.
        source: the data set.
        camera: the device.
        training: training images if they have been read before.
        device: that computes.
        checkpoint: see :func:`veilcam_training.trainer.loop.fit`.
        observers: told how far it has come.
        ranks: processes that fit it together, each with this same call.

    Raises:
        TrainingError: settings or data that cannot be used.
    """
    model = make_model(settings, source, camera).to(device)
    # Another number of ranks draws other noise.
    fingerprint = settings.fingerprint(source) + (f" {ranks.size} ranks" if ranks.size > 1 else "")
    parts = split(source.training() if training is None else training)
    # Read now, so that a bad file does not cost a fit; fitting has no part in it.
    test = source.test()
    if len(test) == 0:
        raise TrainingError(f"{source.name} has no test images: use a data set that holds some")
    fitted = fit(
        model,
        Split(parts.training.to(device), parts.validation.to(device)),
        settings.recipe,
        settings.seed,
        checkpoint=checkpoint,
        fingerprint=fingerprint,
        observers=observers,
        ranks=ranks,
    )
    test = test.to(device)
    result = ranks.from_first(lambda: evaluate(fitted.model, test, settings.seed, "test"))
    return Outcome(
        settings,
        fitted,
        Accuracy(result.accuracy, f"{source.name} test", len(test)),
        confusion(test.labels.cpu(), result.predictions, len(source.labels)),
    )


def as_pair(model: LenslessClassifier) -> Pair:
    """Mask and classifier of a fitted model, for a bundle.

    Raises:
        TrainingError: the encoder has no mask that a panel could show.
    """
    encoder = model.encoder
    if not isinstance(encoder, Mask):
        raise TrainingError(
            "this encoder has no mask that a panel can show: "
            "use 'learned' or 'fixed_simulated', or leave out --out"
        )
    weights = plain(model.classifier).state_dict()
    weights = {name: tensor.cpu() for name, tensor in weights.items()}
    return Pair(encoder.levels(), model.layers, weights)
