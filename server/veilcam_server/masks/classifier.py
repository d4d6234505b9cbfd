"""From the inputs of a classifier to a label, one sample at a time.

Nothing is gained by batches: captures come one after the other, each takes tens of milliseconds and
its inference less than one, so that two of them never wait.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Self

import torch
from torch import Tensor, nn

from veilcam_client.wire.captures import Prediction
from veilcam_server.errors import InferenceError
from veilcam_training.bundle import BundleError, LayerRecord, build_classifier


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
        """Build the network and run it once, so that the first capture is not slower.

        Raises:
            BundleError: it gives no numbers, even for a dark scene.
        """
        classifier = cls(labels, build_classifier(layers, weights))
        try:
            classifier.classify(torch.zeros(1, inputs))
        except InferenceError:
            raise BundleError("a classifier gives NaN or infinity: train it again") from None
        return classifier

    def classify(self, inputs: Tensor) -> Prediction:
        """Classify one sample, (1, inputs).

        Raises:
            InferenceError: the network gives NaN or infinity for it.
        """
        with torch.inference_mode():
            logits = self.module(inputs).double()
        if not bool(torch.isfinite(logits).all()):
            raise InferenceError
        scores = logits.softmax(dim=1)[0]
        best = int(scores.argmax())
        return Prediction(
            label=self.labels[best],
            confidence=float(scores[best]),
            scores=dict(zip(self.labels, scores.tolist(), strict=True)),
        )
