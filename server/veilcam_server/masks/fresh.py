"""Masks drawn from a key, one for every epoch, and one classifier that reads behind all of them."""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field, replace

import torch

from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.wire.captures import Prediction, Release
from veilcam_optics.arrays import overwrite
from veilcam_optics.camera.imperfections import NOMINAL, Imperfections
from veilcam_optics.decoding import Decoder
from veilcam_optics.decoding.release import Whitening
from veilcam_optics.errors import OpticsError
from veilcam_optics.keys.masks import KEY_BYTES, draw_levels
from veilcam_server.devices.base import Levels, Measurement
from veilcam_server.errors import StartError
from veilcam_server.masks.classifier import Classifier
from veilcam_server.masks.source import Mask
from veilcam_training.bundle import Bundle, Fresh, classifier_inputs


@dataclass(frozen=True, eq=False, slots=True)
class FreshReader:
    """Decodes what was read behind one mask and gives it to the classifier of all masks."""

    fresh: Fresh = field(repr=False)
    classifier: Classifier = field(repr=False)
    decoder: Decoder = field(repr=False)
    whitening: Whitening | None = field(repr=False)
    """Made only where embeddings leave white: it takes longer than the decoder."""

    def classify(self, measurement: Measurement) -> Prediction:
        """Decode and classify one embedding."""
        with torch.inference_mode():
            inputs = classifier_inputs(
                self.decoder, torch.from_numpy(measurement)[None], self.fresh.features
            )
        return self.classifier.classify(inputs)

    def whiten(self, measurement: Measurement) -> Measurement:
        """Return the direction of one embedding, of the same shape and of length 1."""
        if self.whitening is None:
            raise ValueError("nothing was prepared to whiten with: make the mask for white")
        with torch.inference_mode():
            white = self.whitening.whiten(torch.from_numpy(measurement)[None])
        return white[0].reshape(measurement.shape).numpy()

    def erase(self) -> None:
        """Overwrite decoder and whitening: behind this mask nothing is read any more."""
        self.decoder.erase()
        if self.whitening is not None:
            self.whitening.erase()


class FreshSource:
    """Draws masks and prepares their decoders.

    Args:
        bundle: of mode ``fresh``, read from a file and checked.
        wrong_decoder: read every mask with the decoder of another key's mask, to show that labels
            come from the mask and not in spite of it.
        imperfections: how the camera departs from the bundle's; decoders are prepared for them.

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
            self._decoding = self._frame.decoding()
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

    def make(self, key: EpochKey, form: Release, avoid: frozenset[str]) -> Mask:  # noqa: ARG002 - none comes twice
        """Draw the mask of an epoch and prepare what reads behind it."""
        drawn, turned = key.levels(), key.rotation()
        try:
            levels = self._levels(drawn)
            read = self._levels(secrets.token_bytes(KEY_BYTES)) if self._wrong else levels
            decoder = self._prepare(read)
            with torch.inference_mode():
                whitening = Whitening(decoder, turned) if form == "white" else None
        finally:
            drawn[:] = turned[:] = bytes(KEY_BYTES)
        return Mask(levels, FreshReader(self._fresh, self._classifier, decoder, whitening))

    def _levels(self, key: bytes | bytearray) -> Levels:
        return draw_levels(key, camera=self._camera, distribution=self._fresh.distribution)

    def _prepare(self, levels: Levels) -> Decoder:
        with torch.inference_mode():
            shown = self._frame.shown(levels)
            decoder = self._decoding.prepare(shown)
            overwrite(shown)
        return decoder
