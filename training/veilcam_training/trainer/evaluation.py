"""Evaluation of a model on images that it was not fitted to."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import cross_entropy

from veilcam_training.data import Images
from veilcam_training.errors import TrainingError, require
from veilcam_training.models.lensless import LenslessClassifier

BATCH = 1000


@dataclass(frozen=True)
class Evaluation:
    """``accuracy`` in [0, 1], mean cross entropy ``loss`` [nats], and every predicted label."""

    accuracy: float
    loss: float
    predictions: Tensor
    """int64 (count,)."""


@torch.no_grad()
def evaluate(
    model: LenslessClassifier,
    images: Images,
    seed: int,
    purpose: str,
    *,
    batches: int | None = None,
) -> Evaluation:
    """Classify ``images``, each shown in one way and behind one draw of the noise.

    Args:
        model: model on the device of the images.
        images: images to classify.
        seed: seed of the draws.
        purpose: purpose of the evaluation; each has its own draws, the same every time.
        batches: number of batches to divide the images into, about evenly; by default each has
            ``BATCH``. A camera with fresh masks has another one for each.

    Raises:
        TrainingError: there are no images, or fewer than batches.
    """
    require(len(images) > 0, "there are no images to evaluate with: use a set that holds some")
    if batches is not None and not 1 <= batches <= len(images):
        raise TrainingError(
            f"masks = {batches} is not valid: use 1 to {len(images)}, one a capture"
        )
    was_training = model.training
    model.eval()
    draws = model.begin_evaluation(seed, purpose)
    places = torch.arange(len(images), device=images.labels.device)
    loss, predictions = 0.0, []
    for part in torch.split(places, BATCH) if batches is None else places.tensor_split(batches):
        logits = model(images.scenes(part), *draws)
        loss += cross_entropy(logits, images.labels[part], reduction="sum").item()
        predictions.append(logits.argmax(1))
    model.train(was_training)
    predicted = torch.cat(predictions)
    right = int((predicted == images.labels).sum())
    return Evaluation(right / len(images), loss / len(images), predicted.cpu())
