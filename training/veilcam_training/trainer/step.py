"""One step of a fit, and evaluation: images are measured, estimated and classified."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import cross_entropy

from veilcam_training.config.settings import FitSettings
from veilcam_training.data import Images
from veilcam_training.errors import TrainingError, require
from veilcam_training.models.lensless import LenslessClassifier
from veilcam_training.seeding import stream
from veilcam_training.transforms.scene import Identity

BATCH = 1000
"""Images that are measured or classified together."""
ELSEWHERE = 4
"""Views of each image that are measured once, where images are shown at random places."""
BIAS_RATE = 64.0
"""Rate of a batch normalisation's bias in a scene classifier, over the rate of the others."""


class Inputs(nn.Module):
    """Training images as a step takes them: a module from indices to logits and what is wanted.

    Where images are shown as they are to a camera that does not change, every noiseless
    measurement is computed once. A classifier of scenes has them measured and estimated once, and
    their mirror images, too; other random changes are made to the estimates.

    Args:
        model: model that is fitted.
        images: images to fit it to.
        settings: settings of the fit.
    """

    def __init__(
        self,
        model: LenslessClassifier,
        images: Images,
        settings: FitSettings,
    ) -> None:
        super().__init__()
        seed, fresh = settings.seed, settings.fresh
        self._model, self._images = model, images
        self._transform = settings.transform
        self.draws, self._epoch = model.begin_epoch(seed, 0), 0
        self._views: list[Tensor] = []
        self._measurements: Tensor | None = None
        shown = isinstance(model.change, Identity)
        if model.measures_once:
            for view in range(2 if shown else ELSEWHERE):
                mirrored = settings.jitter.mirror and view % 2 == 1
                if shown and view and not mirrored:
                    continue
                purpose = f"training {view}"
                self._views.append(
                    measure(
                        *(model, images, seed, purpose),
                        batches=None if fresh is None else min(fresh.masks, len(images)),
                        mirrored=mirrored,
                        dtype=torch.bfloat16,
                    )
                )
            self._transform = settings.without_mirror
        elif model.encoder.constant and shown and settings.transform is None:
            self._measurements = _encode(model, images)
        self._first = torch.randint(2**16, (len(images),), generator=stream(seed, "views"))

    def begin_epoch(self, seed: int, epoch: int) -> None:
        """Take the random numbers of an epoch, and of every image its next view."""
        self.draws, self._epoch = self._model.begin_epoch(seed, epoch), epoch

    @property
    def begun_with(self) -> Tensor | None:
        """Estimated scenes that a classifier begins with, (count, values); None for others."""
        return self._views[0] if self._views else None

    def forward(self, chosen: Tensor) -> tuple[Tensor, Tensor]:
        """Logits for the images at ``chosen``, behind fresh noise, and their labels (count,)."""
        return self._logits(chosen), self._images.labels[chosen]

    def _logits(self, chosen: Tensor) -> Tensor:
        if self._views:
            estimates = self._view(chosen)
            if self._transform is not None:
                estimates = self._transform(estimates, self.draws.scenes)
            return self._model.classify(estimates.flatten(1))
        if self._measurements is not None:
            return self._model.read(self._measurements[chosen], self.draws.noise)
        images = self._images.scenes(chosen)
        if self._transform is not None:
            images = self._transform(images, self.draws.scenes)
        logits: Tensor = self._model(images, *self.draws)
        return logits

    def _view(self, chosen: Tensor) -> Tensor:
        """Estimates (batch, channels, rows, columns) of images, each in its present view."""
        views = (self._first.to(chosen.device)[chosen] + self._epoch) % len(self._views)
        estimates = self._views[0][chosen]
        for number, view in enumerate(self._views[1:], 1):
            estimates = torch.where((views == number)[:, None], view[chosen], estimates)
        planes: Tensor = self._model.classifier[0](estimates.float())
        return planes


@torch.no_grad()
def _encode(model: LenslessClassifier, images: Images) -> Tensor:
    parts = [slice(start, start + BATCH) for start in range(0, len(images), BATCH)]
    return torch.cat([model.encoder(images.scenes(part)) for part in parts])


def make_optimiser(model: LenslessClassifier, settings: FitSettings) -> torch.optim.Optimizer:
    """Optimiser with a rate for the classifier and one for the encoder.

    Weight decay acts on the matrices of the classifier alone; with ``nesterov`` it acts on all.
    """
    fitted = [p for p in model.classifier.parameters() if p.requires_grad]
    matrices = [p for p in fitted if p.ndim > 1]
    vectors = [p for p in fitted if p.ndim <= 1]
    masks = [p for p in model.encoder.parameters() if p.requires_grad]  # others are held
    nesterov = settings.optimiser == "nesterov"
    faster = BIAS_RATE if nesterov else 1.0
    decay = settings.weight_decay
    groups = [
        {"params": matrices, "peak": settings.rate, "weight_decay": decay},
        {
            "params": vectors,
            "peak": faster * settings.rate,
            "weight_decay": decay / faster if nesterov else 0.0,
        },
        {"params": masks, "peak": settings.mask_rate, "weight_decay": 0.0},
    ]
    groups = [group for group in groups if group["params"]]
    if nesterov:
        return torch.optim.SGD(groups, lr=settings.rate, momentum=0.85, nesterov=True)
    if settings.optimiser == "sgd":
        return torch.optim.SGD(groups, lr=settings.rate, momentum=0.9)
    return torch.optim.AdamW(groups, lr=settings.rate, fused=True)


def train_step(
    model: LenslessClassifier,
    inputs: Inputs,
    chosen: Tensor,
    optimiser: torch.optim.Optimizer,
    *,
    label_smoothing: float = 0.0,
) -> tuple[float, int]:
    """One step on the images at ``chosen``; their mean loss and how many were right before it.

    Args:
        model: model that is fitted.
        inputs: training images of the model.
        chosen: indices of images, int64 (count,).
        optimiser: optimiser of the model.
        label_smoothing: share of the wanted probability that all classes have in common.

    Raises:
        TrainingError: the loss is no number; the model is as it was before.
    """
    logits, wanted = inputs(chosen)
    loss = cross_entropy(logits, wanted, label_smoothing=label_smoothing)
    loss = loss + model.encoder.penalty()
    value = loss.item()
    require(math.isfinite(value), f"the loss became {value}: use lower learning rates")
    optimiser.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    optimiser.step()
    model.encoder.project()
    return value, int((logits.detach().argmax(1) == wanted).sum())


@dataclass(frozen=True)
class Evaluation:
    """``accuracy`` in [0, 1], mean cross entropy ``loss`` [nats], and all logits."""

    accuracy: float
    loss: float
    logits: Tensor
    """float32 (count, classes)."""


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
    right = int((logits.argmax(1) == labels).sum())
    loss = cross_entropy(logits, labels).item()
    return Evaluation(right / len(labels), loss, logits.cpu())


@torch.no_grad()
def logits_of(model: LenslessClassifier, inputs: Tensor) -> Tensor:
    """Return the logits (count, classes) of inputs of :func:`measure`."""
    was_training = model.training
    model.eval()
    logits = torch.cat([model.classify(part.float()) for part in torch.split(inputs, BATCH)])
    model.train(was_training)
    return logits
