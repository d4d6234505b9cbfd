"""Masks drawn from a key, one for every epoch, and one classifier that reads behind all of them."""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.wire.captures import Prediction
from veilcam_optics.arrays import overwrite
from veilcam_optics.camera.imperfections import NOMINAL, Imperfections
from veilcam_optics.decoding import Decoder, Precision
from veilcam_optics.errors import OpticsError
from veilcam_optics.keys.masks import KEY_BYTES, draw_levels
from veilcam_server.devices.base import Levels, Measurement
from veilcam_server.errors import StartError
from veilcam_server.masks.classifier import Classifier
from veilcam_server.masks.source import Evidence, Mask, transmittance
from veilcam_training.bundle import Bundle, classifier_inputs

Values = npt.NDArray[Any]


@dataclass(frozen=True, eq=False, slots=True)
class FreshReader:
    """Decodes what was read behind one mask and gives it to the classifier of all masks."""

    classifier: Classifier = field(repr=False)
    decoder: Decoder[Values] = field(repr=False)
    transmittance: float = field(repr=False)
    """Mean of the mask's, which is not 0."""

    def classify(self, measurement: Measurement) -> Prediction:
        """Decode and classify one embedding."""
        inputs = self._inputs(measurement[None])
        try:
            return self.classifier.classify(inputs)
        finally:
            overwrite(inputs)

    def evidence(self, measurement: Measurement) -> Evidence:
        """Return what one embedding tells beside its label."""
        [told] = self.evidence_of(measurement[None])
        return told

    def evidence_of(self, measurements: Values) -> list[Evidence]:
        """Return what each of several embeddings tells, (batch, *shape of one).

        Raises:
            InferenceError: the network gives NaN or infinity for one.
        """
        novelty = self.decoder.novelty(measurements)
        inputs = self._inputs(measurements)
        moved = _moved(inputs, self.decoder.scene.shape)
        logits = np.mean([self.classifier.logits(each) for each in moved], axis=0)
        overwrite(inputs, *moved)
        light = measurements.reshape(len(measurements), -1).mean(axis=1) / self.transmittance
        return [
            Evidence(self.classifier.labels, tuple(scores), brightness, far)
            for scores, brightness, far in zip(
                logits.tolist(), light.tolist(), novelty.tolist(), strict=True
            )
        ]

    def _inputs(self, measurements: Values) -> Values:
        scenes = classifier_inputs(self.decoder, measurements)
        inputs = scenes.astype(np.float32)  # as it was fitted
        overwrite(scenes)
        return inputs

    def erase(self) -> None:
        """Overwrite the decoder: behind this mask nothing is read any more."""
        self.decoder.erase()


def _moved(inputs: Values, shape: tuple[int, int]) -> list[Values]:
    """Return a scene's inputs as they are, and moved by a pixel each way.

    What is read the same way five times is read rightly a little more often.
    """
    rows, columns = shape
    images = inputs.reshape(len(inputs), -1, rows, columns)
    framed = np.pad(images, ((0, 0), (0, 0), (1, 1), (1, 1)), mode="edge")
    corners = ((1, 1), (0, 1), (2, 1), (1, 0), (1, 2))
    moved = [framed[:, :, y : y + rows, x : x + columns] for y, x in corners]
    return [each.reshape(inputs.shape) for each in moved]


class FreshSource:
    """Draws masks and prepares their decoders.

    Args:
        bundle: bundle of mode ``fresh``, read from a file and checked.
        wrong_decoder: read every mask with the decoder of another key's mask, to show that labels
            come from the mask and not in spite of it.
        imperfections: imperfections of the camera, for which decoders are prepared.

    Raises:
        StartError: the imperfections are of another panel, or the bundle's numbers give no decoder.
    """

    def __init__(
        self,
        bundle: Bundle,
        *,
        wrong_decoder: bool = False,
        imperfections: Imperfections = NOMINAL,
    ) -> None:
        if bundle.fresh is None:
            raise ValueError(f"a bundle of mode {bundle.mode!r} has no key policy")
        self.bundle = bundle.digest
        """SHA-256 of its file."""
        self._camera, self._fresh, self._wrong = bundle.camera, bundle.fresh, wrong_decoder
        frame = bundle.fresh.frame(bundle.camera, bundle.scene, bundle.embedding)
        self._frame = replace(frame, imperfections=imperfections)
        self._classifier = Classifier.load(
            bundle.fresh.layers, bundle.fresh.weights, labels=bundle.labels, inputs=bundle.inputs
        )
        try:
            # In float32 the novelty would differ with the library; a mask takes a tenth longer.
            self._decoding = self._frame.decoding(precision=Precision.DOUBLE)
            # A mask that is never shown: what cannot be decoded is found now, and not on the way.
            self._prepare(self._levels(bytes(KEY_BYTES)))
        except OpticsError as error:
            raise StartError(str(error)) from None

    @property
    def renewable(self) -> bool:
        """Always."""
        return True

    @property
    def marks(self) -> frozenset[str]:
        """None: no mask comes twice."""
        return frozenset()

    def make(self, key: EpochKey, avoid: frozenset[str]) -> Mask:  # noqa: ARG002 - none comes twice
        """Draw the mask of an epoch and prepare what reads behind it."""
        drawn = key.levels()
        try:
            levels = self._levels(drawn)
            read = self._levels(secrets.token_bytes(KEY_BYTES)) if self._wrong else levels
            decoder = self._prepare(read)
        finally:
            drawn[:] = bytes(KEY_BYTES)
        passes = transmittance(levels, self._camera.panel.levels)
        return Mask(levels, FreshReader(self._classifier, decoder, passes))

    def _levels(self, key: bytes | bytearray) -> Levels:
        return draw_levels(key, camera=self._camera, distribution=self._fresh.distribution)

    def _prepare(self, levels: Levels) -> Decoder[Values]:
        shown = self._frame.shown(levels)
        decoder: Decoder[Values] = self._decoding.prepare(shown)
        overwrite(shown)
        return decoder
