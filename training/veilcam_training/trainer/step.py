"""One step of fitting: from a few images to a small change of encoder and classifier."""

import math
from collections.abc import Callable

import torch
from torch import Tensor, nn
from torch.nn.functional import cross_entropy, one_hot

from veilcam_training.config.recipes import Recipe
from veilcam_training.config.settings import FreshSettings
from veilcam_training.data import Images
from veilcam_training.errors import require
from veilcam_training.models.lensless import LenslessClassifier
from veilcam_training.trainer.evaluation import BATCH
from veilcam_training.transforms.augmentation import Augmentation
from veilcam_training.transforms.scene import Identity

Hyperparameters = Recipe | FreshSettings
"""How to fit."""


class Inputs(nn.Module):
    """Training images as a step takes them: a module from indices to logits and what is wanted.

    Where images are shown as they are to a camera that does not change, every noiseless
    measurement is computed once.

    Args:
        model: model that is fitted.
        images: images to fit it to.
        transform: changes them at random; None takes them as they are.
        mixup: both parameters of the beta distribution that says how much of another image of the
            step is laid over each; 0 lays none.
    """

    def __init__(
        self,
        model: LenslessClassifier,
        images: Images,
        transform: Augmentation | None = None,
        *,
        mixup: float = 0.0,
    ) -> None:
        super().__init__()
        self._model, self._images, self._transform = model, images, transform
        self._mixup = mixup
        self.draws = model.begin_epoch(0, 0)
        """Random numbers; a fit gives each epoch its own."""
        constant = isinstance(model.change, Identity) and transform is None
        self._measurements = _encode(model, images) if model.encoder.constant and constant else None

    def forward(self, chosen: Tensor) -> tuple[Tensor, Tensor]:
        """Logits for the images at ``chosen``, behind fresh noise, and what they show.

        That is a label each, int64 (count,), or with mixup a share of every class.
        """
        labels = self._images.labels[chosen]
        if not self._mixup:
            return self._logits(chosen, lambda values: values), labels
        # From torch's global generator, as dropout: a fit gives each epoch its own.
        share = float(torch.distributions.Beta(self._mixup, self._mixup).sample())
        other = torch.randperm(len(chosen)).to(chosen.device)
        logits = self._logits(chosen, lambda values: values.lerp(values[other], share))
        shown = one_hot(labels, logits.shape[1]).to(logits)
        return logits, shown.lerp(shown[other], share)

    def _logits(self, chosen: Tensor, mixed: Callable[[Tensor], Tensor]) -> Tensor:
        if self._measurements is not None:
            # Noiseless measurements are linear in scenes: mixed ones are those of mixed scenes.
            return self._model.read(mixed(self._measurements[chosen]), self.draws.noise)
        images = self._images.scenes(chosen)
        if self._transform is not None:
            images = self._transform(images, self.draws.scenes)
        logits: Tensor = self._model(mixed(images), *self.draws)
        return logits


@torch.no_grad()
def _encode(model: LenslessClassifier, images: Images) -> Tensor:
    parts = [slice(start, start + BATCH) for start in range(0, len(images), BATCH)]
    return torch.cat([model.encoder(images.scenes(part)) for part in parts])


def make_optimiser(model: LenslessClassifier, recipe: Hyperparameters) -> torch.optim.Optimizer:
    """Optimiser with a rate for the classifier and one for the encoder.

    Weight decay acts on the matrices of the classifier alone.
    """
    matrices = [p for p in model.classifier.parameters() if p.ndim > 1]
    vectors = [p for p in model.classifier.parameters() if p.ndim <= 1]
    fitted = [p for p in model.encoder.parameters() if p.requires_grad]  # others are held
    groups = [
        {"params": matrices, "peak": recipe.rate, "weight_decay": recipe.weight_decay},
        {"params": vectors, "peak": recipe.rate, "weight_decay": 0.0},
        {"params": fitted, "peak": recipe.mask_rate, "weight_decay": 0.0},
    ]
    groups = [group for group in groups if group["params"]]
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
    value = loss.item()
    require(math.isfinite(value), f"the loss became {value}: use lower learning rates")
    optimiser.zero_grad()
    loss.backward()  # type: ignore[no-untyped-call]
    optimiser.step()
    model.encoder.project()
    most = wanted.argmax(1) if wanted.ndim == 2 else wanted
    return value, int((logits.detach().argmax(1) == most).sum())
