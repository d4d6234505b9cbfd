"""Encoder and classifier in one module: from scenes to logits."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from veilcam_training.bundle import LayerRecord, build_untrained
from veilcam_training.encoders import Encoder
from veilcam_training.models.whitening import decorrelate
from veilcam_training.transforms.scene import Identity, Transform


class LenslessClassifier(nn.Module):
    """A camera, its noise, and the classifier that reads the noisy embedding.

    Args:
        encoder: the camera.
        layers: the classifier, made with fresh weights from torch's global generator.
        snr_db: signal-to-noise ratio of a reading [dB]; None for no noise.
        change: how images are shown to the camera; by default as they are.
        mixed_precision: True lets the classifier's matrix products run in bfloat16. The optics and
            the noise stay in float32.
        decorrelated: True has the classifier's first fully connected layer fitted in coordinates
            in which what it is given is decorrelated.
    """

    def __init__(
        self,
        encoder: Encoder,
        layers: Sequence[LayerRecord],
        snr_db: float | None,
        *,
        change: Transform | None = None,
        mixed_precision: bool = False,
        decorrelated: bool = False,
    ) -> None:
        super().__init__()
        self.encoder, self.layers, self.snr_db = encoder, tuple(layers), snr_db
        self.change = Identity(encoder.setup.scene) if change is None else change
        self.mixed_precision = mixed_precision
        self.classifier = build_untrained(self.layers)
        if decorrelated:
            decorrelate(self.classifier)

    def read(self, embeddings: Tensor, noise: torch.Generator) -> Tensor:
        """Logits for noiseless embeddings (batch, encoder.outputs), after fresh sensor noise."""
        if self.snr_db is not None:
            embeddings = self.encoder.add_noise(embeddings, self.snr_db, noise)
        if not self.mixed_precision:
            logits: Tensor = self.classifier(embeddings)
            return logits
        with torch.autocast(embeddings.device.type, dtype=torch.bfloat16):
            logits = self.classifier(embeddings)
        return logits.float()

    def forward(
        self, images: Tensor, noise: torch.Generator, draws: torch.Generator | None = None
    ) -> Tensor:
        """Logits (batch, classes) for images in [0, 1].

        Args:
            images: (batch, rows, columns) or (batch, 3, rows, columns).
            noise: of the sensor, on the device of the images.
            draws: of how the images are shown, on the CPU; None for images that are scenes already.
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
