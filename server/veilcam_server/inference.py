"""From the inputs of a classifier to a label."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self

import torch
from torch import Tensor, nn

from veilcam_training.bundle import LayerRecord, build_classifier


@dataclass(frozen=True, slots=True)
class Verdict:
    """Probability of every label, in the order of the bundle's labels, and the likeliest one."""

    label: str
    confidence: float
    scores: dict[str, float]


@dataclass(frozen=True, eq=False)
class Classifier:
    """A network and the names of what it gives."""

    labels: tuple[str, ...]
    module: nn.Module = field(repr=False)

    @classmethod
    def load(
        cls,
        layers: Sequence[LayerRecord],
        weights: Mapping[str, Tensor],
        *,
        labels: tuple[str, ...],
        inputs: int,
    ) -> Self:
        """Build the network and run it once, so that the first capture is not slower."""
        classifier = cls(labels, build_classifier(layers, weights))
        with torch.inference_mode():
            classifier.module(torch.zeros(1, inputs))
        return classifier

    def classify(self, inputs: Tensor) -> Verdict:
        """Classify one sample, (1, inputs)."""
        with torch.inference_mode():
            scores = self.module(inputs).double().softmax(dim=1)[0]
        best = int(scores.argmax())
        return Verdict(
            self.labels[best],
            float(scores[best]),
            dict(zip(self.labels, scores.tolist(), strict=True)),
        )
