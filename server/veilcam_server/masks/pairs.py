"""Masks trained beforehand, each with a classifier of its own."""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Sequence
from dataclasses import dataclass, field

from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.wire.captures import Prediction
from veilcam_server.devices.base import Measurement
from veilcam_server.errors import StartError
from veilcam_server.masks.classifier import Classifier
from veilcam_server.masks.source import Evidence, Mask, transmittance
from veilcam_training.bundle import Bundle, Pair

_MARKS = b"veilcam stored masks, marks, version 1"


@dataclass(frozen=True, eq=False, slots=True)
class PairReader:
    """The classifier that was trained for one mask."""

    classifier: Classifier = field(repr=False)
    transmittance: float = field(repr=False)
    """Mean of the mask's, which is not 0."""

    def classify(self, measurement: Measurement) -> Prediction:
        """Classify one embedding of any shape."""
        return self.classifier.classify(measurement.reshape(1, -1))

    def evidence(self, measurement: Measurement) -> Evidence:
        """Return the evidence of one embedding; no statistics tell what is novel."""
        return Evidence(
            self.classifier.labels,
            tuple(self.classifier.logits(measurement.reshape(1, -1))[0].tolist()),
            light=float(measurement.mean()) / self.transmittance,
            novelty=None,
        )

    def erase(self) -> None:
        """Nothing: all of it stands in the bundle."""


class PairSource:
    """Pairs in an order that cannot be predicted from the network.

    Args:
        bundle: SHA-256 of its file.
        masks: one or more, with marks that differ.
    """

    def __init__(self, bundle: str, masks: Sequence[Mask]) -> None:
        self.bundle = bundle
        """SHA-256 of its file."""
        self._masks = tuple(masks)
        self._random = secrets.SystemRandom()

    @property
    def renewable(self) -> bool:
        """True where there are two pairs or more."""
        return len(self._masks) > 1

    @property
    def marks(self) -> frozenset[str]:
        """Return the levels of all pairs."""
        return frozenset(mask.mark for mask in self._masks)

    def make(self, key: EpochKey, avoid: frozenset[str]) -> Mask:  # noqa: ARG002 - chance decides
        """Return any pair but those to avoid, or any at all if no other is left."""
        others = [mask for mask in self._masks if mask.mark not in avoid]
        return self._random.choice(others or self._masks)


def load_pairs(bundle: Bundle, *, wrong_classifier: bool = False) -> PairSource:
    """Build every classifier of ``bundle``.

    Args:
        bundle: bundle of mode ``pairs``, read and checked.
        wrong_classifier: give every mask the classifier of another pair, to show that labels
            come from the mask and not in spite of it.

    Raises:
        StartError: the bundle cannot be served.
    """
    if wrong_classifier and len(bundle.pairs) < 2:
        raise StartError("the wrong classifier needs a bundle with two or more pairs")
    readers = [
        PairReader(
            Classifier.load(pair.layers, pair.weights, labels=bundle.labels, inputs=bundle.inputs),
            transmittance(pair.levels, bundle.camera.panel.levels),
        )
        for pair in bundle.pairs
    ]
    if wrong_classifier:
        readers = readers[1:] + readers[:1]
    return PairSource(
        bundle.digest,
        [
            Mask(pair.levels, reader, _mark(pair))
            for pair, reader in zip(bundle.pairs, readers, strict=True)
        ],
    )


def _mark(pair: Pair) -> str:
    """Return a digest of a mask for this use alone: its budget is one in all bundles."""
    return hmac.new(_MARKS, pair.levels.tobytes(), "sha256").hexdigest()[:32]
