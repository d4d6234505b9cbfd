"""Classifier of embeddings: one sample at a time.

Nothing is gained by batches: captures come one after the other, each takes tens of milliseconds and
its inference less than one, so that two of them never wait.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from veilcam_client.wire.captures import Prediction
from veilcam_server.errors import InferenceError
from veilcam_training.bundle import BundleError, LayerRecord, Network

Values = npt.NDArray[Any]


@dataclass(frozen=True, eq=False)
class Classifier:
    """A network and the names of what it gives."""

    labels: tuple[str, ...]
    network: Network = field(repr=False)

    @classmethod
    def load(
        cls,
        layers: Sequence[LayerRecord],
        weights: Mapping[str, Values],
        *,
        labels: tuple[str, ...],
        inputs: int,
    ) -> Self:
        """Build the network and run it once, so that the first capture is not slower.

        Raises:
            BundleError: it gives no numbers, even for a dark scene.
        """
        classifier = cls(labels, Network.load(layers, weights))
        try:
            classifier.classify(np.zeros((1, inputs), np.float32))
        except InferenceError:
            raise BundleError("a classifier gives NaN or infinity: train it again") from None
        return classifier

    def classify(self, inputs: Values) -> Prediction:
        """Classify one sample, (1, inputs) float32.

        Raises:
            InferenceError: the network gives NaN or infinity for it.
        """
        logits = self.logits(inputs)[0]
        powers = np.exp(logits - logits.max())
        scores = powers / powers.sum()
        best = int(scores.argmax())
        return Prediction(
            label=self.labels[best],
            confidence=float(scores[best]),
            scores=dict(zip(self.labels, scores.tolist(), strict=True)),
        )

    def logits(self, inputs: Values) -> npt.NDArray[np.float64]:
        """Return the outputs of the network, (batch, labels); raises as :meth:`classify`."""
        logits: npt.NDArray[np.float64] = self.network(inputs).astype(np.float64)
        if not np.isfinite(logits).all():
            raise InferenceError(
                "the classifier gave no probabilities for this measurement: train it again"
            )
        return logits
