"""One step of fitting: from a few images to a small change of encoder and classifier."""

import math

import torch
from torch import Tensor, nn
from torch.nn.functional import cross_entropy

from veilcam_training.config.recipes import Recipe
from veilcam_training.data import Images
from veilcam_training.errors import require
from veilcam_training.models.lensless import LenslessClassifier
from veilcam_training.seeding import stream
from veilcam_training.trainer.evaluation import BATCH, measure
from veilcam_training.transforms.scene import Identity

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
        recipe: settings of the fit.
        seed: seed of what is measured once.
        masks: number of fresh masks that each view of the images is measured behind.
    """

    def __init__(
        self,
        model: LenslessClassifier,
        images: Images,
        recipe: Recipe,
        seed: int = 0,
        *,
        masks: int | None = None,
    ) -> None:
        super().__init__()
        self._model, self._images = model, images
        self._transform = recipe.transform
        self.draws, self._epoch = model.begin_epoch(seed, 0), 0
        self._views: list[Tensor] = []
        self._measurements: Tensor | None = None
        shown = isinstance(model.change, Identity)
        if model.measures_once:
            for view in range(2 if shown else ELSEWHERE):
                mirrored = recipe.jitter.mirror and view % 2 == 1
                if shown and view and not mirrored:
                    continue
                purpose = f"training {view}"
                self._views.append(
                    measure(
                        *(model, images, seed, purpose),
                        batches=None if masks is None else min(masks, len(images)),
                        mirrored=mirrored,
                        dtype=torch.bfloat16,
                    )
                )
            self._transform = recipe.without_mirror
        elif model.encoder.constant and shown and recipe.transform is None:
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


def make_optimiser(model: LenslessClassifier, recipe: Recipe) -> torch.optim.Optimizer:
    """Optimiser with a rate for the classifier and one for the encoder.

    Weight decay acts on the matrices of the classifier alone; with ``nesterov`` it acts on all.
    """
    fitted = [p for p in model.classifier.parameters() if p.requires_grad]
    matrices = [p for p in fitted if p.ndim > 1]
    vectors = [p for p in fitted if p.ndim <= 1]
    masks = [p for p in model.encoder.parameters() if p.requires_grad]  # others are held
    nesterov = recipe.optimiser == "nesterov"
    faster = BIAS_RATE if nesterov else 1.0
    decay = recipe.weight_decay
    groups = [
        {"params": matrices, "peak": recipe.rate, "weight_decay": decay},
        {
            "params": vectors,
            "peak": faster * recipe.rate,
            "weight_decay": decay / faster if nesterov else 0.0,
        },
        {"params": masks, "peak": recipe.mask_rate, "weight_decay": 0.0},
    ]
    groups = [group for group in groups if group["params"]]
    if nesterov:
        return torch.optim.SGD(groups, lr=recipe.rate, momentum=0.85, nesterov=True)
    if recipe.optimiser == "sgd":
        return torch.optim.SGD(groups, lr=recipe.rate, momentum=0.9)
    return torch.optim.AdamW(groups, lr=recipe.rate, fused=True)


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
