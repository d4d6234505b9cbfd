"""How well a classifier does behind masks that it has never seen."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import cross_entropy

from veilcam_training.data import Images
from veilcam_training.encoders.fresh import FreshCamera
from veilcam_training.errors import TrainingError
from veilcam_training.seeding import stream


@dataclass(frozen=True)
class FreshEvaluation:
    """``accuracy`` in [0, 1], mean cross entropy ``loss`` [nats], and every predicted label."""

    accuracy: float
    loss: float
    predictions: Tensor
    """int64 (count,)."""
    masks: int
    """How many different masks were used, each for the same number of captures (or one less)."""


@torch.no_grad()
def evaluate_fresh(
    classifier: nn.Module,
    camera: FreshCamera,
    images: Images,
    *,
    masks: int | None = None,
    purpose: str,
    wrong_key: bool = False,
) -> FreshEvaluation:
    """Classify ``images``, each behind one draw of the noise.

    Args:
        classifier: in evaluation mode.
        camera: gives the masks and readings.
        images: to classify.
        masks: how many masks to spread them over; by default each capture has one of its own.
        purpose: masks for one purpose are never those for another, nor those of a fit.
        wrong_key: True decodes every reading with another mask's decoder.

    Raises:
        TrainingError: there are no images, or fewer than masks.
    """
    masks = len(images) if masks is None else masks
    if not 1 <= masks <= len(images):
        raise TrainingError(f"masks = {masks} is not valid: use 1 to {len(images)}, one a capture")
    source = camera.masks(purpose)
    random = stream(camera.settings.seed, "images", purpose)
    loss, predictions = 0.0, []
    for part in torch.arange(len(images)).tensor_split(masks):
        mask = next(source)
        readings = mask.read(camera.placement(images.scenes(part), random), random)
        logits = classifier((next(source) if wrong_key else mask).decode(readings))
        loss += float(cross_entropy(logits, images.labels[part], reduction="sum"))
        predictions.append(logits.argmax(1))
    predicted = torch.cat(predictions)
    right = int((predicted == images.labels).sum())
    return FreshEvaluation(right / len(images), loss / len(images), predicted, masks)
