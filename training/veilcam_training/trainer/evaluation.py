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


def evaluate(
    model: LenslessClassifier,
    images: Images,
    seed: int,
    purpose: str,
    *,
    batches: int | None = None,
) -> Evaluation:
    """Classify ``images``, each shown in one way and behind one draw of the noise.

    Arguments and errors are those of :func:`measure`.
    """
    inputs = measure(model, images, seed, purpose, batches=batches)
    return judge(model, inputs, images.labels)


@torch.no_grad()
def measure(
    model: LenslessClassifier,
    images: Images,
    seed: int,
    purpose: str,
    *,
    batches: int | None = None,
    mirrored: bool = False,
    dtype: torch.dtype = torch.float32,
) -> Tensor:
    """Return the classifier's inputs for ``images``, (count, inputs).

    Args:
        model: model on the device of the images.
        images: images to measure.
        seed: seed of the draws.
        purpose: purpose of the measurement; each has its own draws, the same every time.
        batches: number of batches to divide the images into, about evenly; by default each has
            ``BATCH``. A camera with fresh masks has another one for each.
        mirrored: True shows their mirror images.
        dtype: type of the result.

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
    taken = []
    for part in torch.split(places, BATCH) if batches is None else places.tensor_split(batches):
        scenes = images.scenes(part)
        embeddings = model.embed(scenes.flip(-1) if mirrored else scenes, draws.scenes)
        taken.append(model.taken(embeddings, draws.noise).to(dtype))
    model.train(was_training)
    return torch.cat(taken)


@torch.no_grad()
def judge(model: LenslessClassifier, inputs: Tensor, labels: Tensor) -> Evaluation:
    """Classify inputs of :func:`measure`.

    Args:
        model: model that they were measured with.
        inputs: (count, inputs).
        labels: int64 (count,).
    """
    logits = logits_of(model, inputs)
    predicted = logits.argmax(1)
    right = int((predicted == labels).sum())
    loss = cross_entropy(logits, labels).item()
    return Evaluation(right / len(labels), loss, predicted.cpu())


@torch.no_grad()
def logits_of(model: LenslessClassifier, inputs: Tensor) -> Tensor:
    """Return the logits (count, classes) of inputs of :func:`measure`."""
    was_training = model.training
    model.eval()
    logits = torch.cat([model.classify(part.float()) for part in torch.split(inputs, BATCH)])
    model.train(was_training)
    return logits
