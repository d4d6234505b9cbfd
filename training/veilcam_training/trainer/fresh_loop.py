"""Fitting one classifier to a stream of fresh masks."""

from __future__ import annotations

import copy
import dataclasses
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn.functional import cross_entropy

from veilcam_optics.keys.masks import MaskDistribution
from veilcam_training.bundle import build_untrained
from veilcam_training.bundle.layers import LayerRecord
from veilcam_training.data import Images, Split
from veilcam_training.encoders.fresh import FreshCamera, PreparedMask
from veilcam_training.encoders.learned_levels import LearnedRange
from veilcam_training.errors import TrainingError
from veilcam_training.seeding import seeded, stream
from veilcam_training.trainer.checkpoint import load_checkpoint, save_checkpoint
from veilcam_training.trainer.fresh_evaluation import evaluate_fresh
from veilcam_training.trainer.loop import Epoch, Observer

CENTRE = "centre"
"""Where the learned centres of the masks' ranges are among the best weights."""
WARM_UP = 0.15
"""Share of the fit in which the learning rate rises."""


@dataclass(frozen=True)
class FreshFit:
    """A fitted classifier, as it was after the epoch that did best on the validation set."""

    classifier: nn.Module
    layers: tuple[LayerRecord, ...]
    distribution: MaskDistribution
    """What masks have to be drawn from."""
    history: tuple[Epoch, ...]
    best: Epoch


def fit_fresh(
    camera: FreshCamera,
    layers: Sequence[LayerRecord],
    split: Split,
    *,
    checkpoint: Path | None = None,
    fingerprint: str = "",
    observers: Sequence[Observer] = (),
) -> FreshFit:
    """Fit a classifier; every step sees several masks, and each mask serves a few steps only.

    The weights that are validated, and returned, are a running mean over the steps.

    Args:
        camera: the simulated camera; its settings say how to fit.
        layers: of the classifier.
        split: images to fit to and to select with.
        checkpoint: file to take the fit up from, and to leave it in after every epoch.
        fingerprint: of the fit; a checkpoint of another one is refused.
        observers: told how far it has come.

    Raises:
        TrainingError: the loss is no number any more, too few images, or a bad checkpoint.
    """
    settings = camera.settings
    if len(split.training) < settings.batch:
        raise TrainingError(
            f"{len(split.training)} training images do not fill a batch of {settings.batch}: "
            "use a smaller batch"
        )
    with seeded(settings.seed, "classifier"):
        state = _State(build_untrained(layers), camera)
    if checkpoint is not None and (saved := load_checkpoint(checkpoint, fingerprint)) is not None:
        state.load(saved)
    while len(state.history) < settings.epochs:
        number, started = len(state.history), time.monotonic()
        with seeded(settings.seed, "epoch", number):
            loss, accuracy = _run_epoch(state, camera, split.training, observers)
        state.publish(camera)
        result = evaluate_fresh(
            state.mean,
            camera,
            split.validation,
            masks=min(settings.validation_masks, len(split.validation)),
            purpose="validation",
        )
        seconds = time.monotonic() - started
        epoch = Epoch(number, loss, accuracy, result.accuracy, result.loss, seconds)
        state.finish(epoch)
        if checkpoint is not None:
            save_checkpoint(checkpoint, fingerprint, state.dump())
        for observer in observers:
            observer.epoch(epoch)
    state.restore_best()
    state.publish(camera)
    return FreshFit(
        state.mean, tuple(layers), camera.distribution, tuple(state.history), state.best
    )


class _State:
    """All that changes during a fit."""

    def __init__(self, model: nn.Module, camera: FreshCamera) -> None:
        settings = camera.settings
        self.model = model.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.mean = copy.deepcopy(model).requires_grad_(False).eval()
        self.steps = 0
        matrices = [p for p in model.parameters() if p.ndim > 1]
        vectors = [p for p in model.parameters() if p.ndim <= 1]
        rate, decay = settings.rate, settings.weight_decay
        groups = [
            {"params": matrices, "peak": rate, "weight_decay": decay},
            {"params": vectors, "peak": rate, "weight_decay": 0.0},
        ]
        self.masks: LearnedRange | None = None
        if settings.spread is not None:
            random = stream(settings.seed, "centres")
            self.masks = LearnedRange(camera.camera, settings.exponent, settings.spread, random)
            centres = list(self.masks.parameters())
            groups.append({"params": centres, "peak": settings.mask_rate, "weight_decay": 0.0})
        self.optimiser = torch.optim.AdamW(groups, lr=rate, fused=True)
        self.history: list[Epoch] = []
        self.best_weights: dict[str, Tensor] = {}

    def publish(self, camera: FreshCamera) -> None:
        """Let the camera draw from what has been learned, if anything is."""
        if self.masks is not None:
            camera.distribution = self.masks.distribution()

    def restore_best(self) -> None:
        weights = dict(self.best_weights)
        if self.masks is not None:
            self.masks.load_state_dict({"centre": weights.pop(CENTRE)})
        self.mean.load_state_dict(weights)

    @property
    def best(self) -> Epoch:
        return max(self.history, key=lambda e: (e.validation_accuracy, -e.validation_loss))

    def average(self, decay: float) -> None:
        """Take the new weights into the running mean, which forgets the first ones fast."""
        self.steps += 1
        share = 1 - min(decay, self.steps / (self.steps + 9))
        with torch.no_grad():
            for mean, new in zip(
                self.mean.state_dict().values(), self.model.state_dict().values(), strict=True
            ):
                if mean.is_floating_point():
                    mean.lerp_(new, share)
                else:
                    mean.copy_(new)

    def finish(self, epoch: Epoch) -> None:
        self.history.append(epoch)
        if self.best is epoch:
            self.best_weights = copy.deepcopy(dict(self.mean.state_dict()))
            if self.masks is not None:
                self.best_weights[CENTRE] = self.masks.centre.detach().clone()

    def dump(self) -> dict[str, Any]:
        return {
            "model": self.model.state_dict(),
            "mean": self.mean.state_dict(),
            "steps": self.steps,
            "optimiser": self.optimiser.state_dict(),
            "masks": None if self.masks is None else self.masks.state_dict(),
            "best_weights": self.best_weights,
            "history": [dataclasses.asdict(epoch) for epoch in self.history],
        }

    def load(self, saved: dict[str, Any]) -> None:
        self.model.load_state_dict(saved["model"])
        self.mean.load_state_dict(saved["mean"])
        self.steps = saved["steps"]
        self.optimiser.load_state_dict(saved["optimiser"])
        if self.masks is not None:
            self.masks.load_state_dict(saved["masks"])
        self.best_weights = saved["best_weights"]
        self.history = [Epoch(**epoch) for epoch in saved["history"]]


def rate_factor(progress: float) -> float:
    """Factor on the learning rate when ``progress``, in [0, 1), of the fit is done."""
    if progress < WARM_UP:
        return 0.04 + 0.96 * progress / WARM_UP
    return max(1e-3, 0.5 * (1 + math.cos(math.pi * (progress - WARM_UP) / (1 - WARM_UP))))


def _run_epoch(
    state: _State, camera: FreshCamera, images: Images, observers: Sequence[Observer]
) -> tuple[float, float]:
    """One pass over the training images; mean loss and accuracy."""
    settings, number = camera.settings, len(state.history)
    order = torch.randperm(len(images), generator=stream(settings.seed, "order", number))
    steps = len(images) // settings.batch
    random = stream(settings.seed, "images", number)
    rings = (
        camera.rings("training", number)
        if state.masks is None
        else _learned_rings(state.masks, camera, stream(settings.seed, "training", number))
    )
    total, right = 0.0, 0
    state.model.train()
    for step in range(steps):
        for group in state.optimiser.param_groups:
            group["lr"] = group["peak"] * rate_factor((number + step / steps) / settings.epochs)
        chosen = order[step * settings.batch : (step + 1) * settings.batch]
        inputs = _inputs(camera, next(rings), images.scenes(chosen), random)
        with torch.autocast("cpu", torch.bfloat16, enabled=settings.bfloat16):
            logits = state.model(inputs).float()
        wanted = images.labels[chosen]
        loss = cross_entropy(logits, wanted, label_smoothing=settings.label_smoothing)
        state.optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        state.optimiser.step()
        if state.masks is not None:
            state.masks.project()
        state.average(settings.averaging)
        total += float(loss.detach())
        right += int((logits.detach().argmax(1) == wanted).sum())
        for observer in observers:
            observer.step(number, step + 1, steps)
    if not math.isfinite(total):
        raise TrainingError(f"the loss became {total} in epoch {number + 1}: use a lower rate")
    return total / steps, right / (steps * settings.batch)


def _learned_rings(
    masks: LearnedRange, camera: FreshCamera, random: torch.Generator
) -> Iterator[tuple[PreparedMask, ...]]:
    """New masks at every step: a gradient cannot pass through a step that is over."""
    panels = camera.panels("training")
    while True:
        yield tuple(
            camera.prepare(masks(random), panels, random) for _ in range(camera.settings.masks)
        )


def _inputs(
    camera: FreshCamera,
    ring: tuple[PreparedMask, ...],
    images: Tensor,
    random: torch.Generator,
) -> Tensor:
    """What the classifier sees of a batch whose images are spread over the masks in use."""
    if camera.settings.augmentation is not None:
        images = camera.settings.augmentation(images, random)
    scenes = camera.placement(images, random)
    pairs = zip(ring, scenes.chunk(len(ring)), strict=True)
    return torch.cat([mask.decode(mask.read(part, random)) for mask, part in pairs])
