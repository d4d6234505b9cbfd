"""Encoder and classifier in one module: from images to logits."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn

from veilcam_training.bundle import LayerRecord
from veilcam_training.bundle.layers import Affine
from veilcam_training.encoders import Encoder
from veilcam_training.encoders.estimate import SceneEstimate
from veilcam_training.encoders.fresh import FreshCamera
from veilcam_training.models.network import AffineModule, build_untrained
from veilcam_training.models.whitening import plain, whiten
from veilcam_training.seeding import stream
from veilcam_training.transforms.scene import Identity, Transform


def has_bfloat16(device: torch.device) -> bool:
    """Return True if ``device`` has instructions for bfloat16; emulated ones are slow.

    Every CUDA device is taken to have them: those before compute capability 8.0 do not.
    """
    capabilities = torch.cpu.get_capabilities()
    return device.type != "cpu" or any(
        present for name, present in capabilities.items() if "bf16" in name
    )


class Draws(NamedTuple):
    """Random numbers of an epoch, or of an evaluation."""

    noise: torch.Generator
    """Of the sensor, on the device of the images."""
    scenes: torch.Generator
    """Of how images are shown, on the CPU."""


class LenslessClassifier(nn.Module):
    """A camera, its noise, and the classifier that reads the noisy embedding.

    Args:
        encoder: the camera.
        layers: the classifier, made with fresh weights from torch's global generator.
        snr_db: signal-to-noise ratio of a measurement [dB]; None for no noise.
        change: transform that shows images to the camera; by default none.
        mixed_precision: True lets the classifier run in bfloat16 in training, on a processor that
            has it. The optics and the noise stay in float32.
        whitened: True has the classifier's first fully connected layer fitted in coordinates in
            which what it is given is white.
        estimate: estimate of the scene, computed in the place of the first ``layers``.
    """

    def __init__(
        self,
        encoder: Encoder,
        layers: Sequence[LayerRecord],
        snr_db: float | None,
        *,
        change: Transform | None = None,
        mixed_precision: bool = False,
        whitened: bool = False,
        estimate: SceneEstimate | None = None,
    ) -> None:
        super().__init__()
        self.encoder, self.layers, self.snr_db = encoder, tuple(layers), snr_db
        self.change = Identity(encoder.setup.scene) if change is None else change
        self.mixed_precision = mixed_precision
        self.estimate = estimate
        computed = 0 if estimate is None else len(estimate.layers)
        self.classifier = build_untrained(self.layers[computed:])
        if whitened:
            whiten(self.classifier)
        if estimate is not None:  # all that follows are convolutions
            self.classifier.to(memory_format=torch.channels_last)  # type: ignore[call-overload]

    @property
    def measures_once(self) -> bool:
        """True where the classifier reads scenes that a camera has measured once and for all."""
        return self.estimate is not None and self.encoder.constant

    def read(self, embeddings: Tensor, noise: torch.Generator) -> Tensor:
        """Logits for noiseless embeddings (batch, encoder.outputs), after fresh sensor noise."""
        return self.classify(self.taken(embeddings, noise))

    def taken(self, embeddings: Tensor, noise: torch.Generator) -> Tensor:
        """Return the classifier's inputs for noiseless embeddings, after fresh sensor noise."""
        if self.snr_db is not None:
            embeddings = self.encoder.add_noise(embeddings, self.snr_db, noise)
        inputs = self.encoder.decode(embeddings)
        return inputs if self.estimate is None else self.estimate(inputs)

    def classify(self, inputs: Tensor) -> Tensor:
        """Logits for inputs of the classifier."""
        if not self.is_mixed:
            logits: Tensor = self.classifier(inputs)
            return logits
        with torch.autocast(inputs.device.type, dtype=torch.bfloat16):
            logits = self.classifier(inputs)
        return logits.float()

    def rescale(self, factor: float) -> None:
        """Multiply the logits of a scene classifier by a factor."""
        last, module = self.layers[-1], self.classifier[-1]
        if isinstance(last, Affine) and isinstance(module, AffineModule):
            scale = factor * last.scale
            self.layers = (*self.layers[:-1], last.model_copy(update={"scale": scale}))
            module.scale = scale

    def reader(self) -> nn.Module:
        """Return a copy of the reader of measurements: a module of plain ``layers``."""
        copied = plain(self.classifier)
        if self.estimate is None:
            return copied
        return nn.Sequential(*self.estimate.as_layers(), *copied.children()).train(copied.training)

    @property
    def is_mixed(self) -> bool:
        """True if the classifier is to run in mixed precision now: in training alone."""
        return self.mixed_precision and self.training and has_bfloat16(self.device)

    @property
    def device(self) -> torch.device:
        """Device of the model."""
        return next(self.classifier.parameters()).device

    def begin_epoch(self, seed: int, epoch: int) -> Draws:
        """Return the random numbers of an epoch of training."""
        return Draws(
            stream(seed, "noise", epoch, device=self.device), stream(seed, "change", epoch)
        )

    def begin_evaluation(self, seed: int, purpose: str) -> Draws:
        """Random numbers of an evaluation; each purpose has its own, the same every time."""
        return Draws(
            stream(seed, purpose, "noise", device=self.device), stream(seed, purpose, "change")
        )

    def forward(
        self, images: Tensor, noise: torch.Generator, draws: torch.Generator | None = None
    ) -> Tensor:
        """Logits (batch, classes) for images in [0, 1].

        Args:
            images: (batch, rows, columns) or (batch, 3, rows, columns).
            noise: generator of the sensor's noise, on the device of the images.
            draws: generator of the transform, on the CPU; None for images that are scenes already.
        """
        if draws is None:
            return self.read(self.encoder(images), noise)
        return self.read(self.embed(images, draws), noise)

    def embed(self, images: Tensor, draws: torch.Generator) -> Tensor:
        """Noiseless embeddings (batch, encoder.outputs) of images, shown as the change says."""
        chosen: list[Tensor] = []
        embeddings: list[Tensor] = []
        for shown in self.change.in_parts(images, draws, training=self.training):
            chosen.append(shown.chosen)
            embeddings.append(self.encoder(shown.scenes, shown.part, shown.grid))
        if len(embeddings) == 1:
            return embeddings[0]
        back = torch.cat(chosen).argsort().to(images.device)
        return torch.cat(embeddings).index_select(0, back)


class FreshClassifier(LenslessClassifier):
    """A camera whose mask changes all the time, and one classifier for all its masks.

    Args:
        encoder: the camera.
        layers: the classifier, made with fresh weights from torch's global generator.
        change: transform that shows images to the camera.
        mixed_precision: True lets the classifier's matrix products run in bfloat16 in training.
    """

    encoder: FreshCamera

    def __init__(
        self,
        encoder: FreshCamera,
        layers: Sequence[LayerRecord],
        change: Transform | None = None,
        *,
        mixed_precision: bool = False,
    ) -> None:
        super().__init__(
            encoder,
            layers,
            encoder.frame.noise.snr_db,
            change=change,
            mixed_precision=mixed_precision,
        )
        self.classifier.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.wrong_key = False
        """True evaluates with every measurement decoded by the key of another mask."""

    @property
    def measures_once(self) -> bool:
        """True: every image is measured behind a mask of its own, or of a few images."""
        return True

    def begin_evaluation(self, seed: int, purpose: str) -> Draws:
        """Random numbers of an evaluation, and a new mask for each of its batches."""
        self.encoder.coming = self.encoder.one_by_one(purpose, wrong_key=self.wrong_key)
        return super().begin_evaluation(seed, purpose)
