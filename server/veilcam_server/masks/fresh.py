"""Masks drawn from a key, one for every epoch, and one classifier that reads behind all of them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import torch

from veilcam_client.wire.captures import Form, Prediction, Release
from veilcam_optics.camera.imperfections import NOMINAL, Imperfections
from veilcam_optics.decoding import Decoder
from veilcam_optics.decoding.release import ReleaseForm, Whitening, release
from veilcam_optics.errors import OpticsError
from veilcam_optics.keys.epoch_names import EpochNames
from veilcam_optics.keys.masks import Secret, epoch_levels
from veilcam_server.devices.base import Levels, Measurement
from veilcam_server.devices.errors import SensorError
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

    def classify(self, embedding: Measurement) -> Prediction:
        """Decode and classify one embedding."""
        with torch.inference_mode():
            inputs = classifier_inputs(
                self.decoder, torch.from_numpy(embedding)[None], self.fresh.features
            )
        return self.classifier.classify(inputs)

    def release(self, embedding: Measurement, form: Form) -> Measurement:
        """Bring one embedding into ``form``; white only if this was made to release white."""
        if form == "white" and self.whitening is None:
            raise ValueError("nothing was prepared to whiten with: make the source for white")
        try:
            with torch.inference_mode():
                released = release(
                    torch.from_numpy(embedding)[None],
                    ReleaseForm(form),
                    self.decoder,
                    self.whitening,
                )
        except OpticsError as error:
            raise SensorError(str(error)) from None
        assert released is not None  # noqa: S101 - 'none' is no form
        return released[0].numpy()


class FreshSource:
    """Draws masks and prepares their decoders.

    Args:
        bundle: of mode ``fresh``, read and checked.
        secret: 256 bits that masks are derived from.
        device: label of this camera; the bundle's if None.
        form: in which embeddings leave.
        wrong_decoder: read every mask with the decoder of another one, to show that labels come
            from the mask and not in spite of it.
        imperfections: how the camera departs from the bundle's; decoders are prepared for them.

    Raises:
        StartError: the label is not valid, the imperfections are of another panel, or the bundle's
            numbers give no decoder.
    """

    def __init__(
        self,
        bundle: Bundle,
        secret: Secret,
        *,
        device: str | None = None,
        form: Release = "none",
        wrong_decoder: bool = False,
        imperfections: Imperfections = NOMINAL,
    ) -> None:
        if bundle.fresh is None:
            raise ValueError(f"a bundle of mode {bundle.mode!r} has no key policy")
        self._camera, self._fresh, self._secret = bundle.camera, bundle.fresh, secret
        self._device = bundle.fresh.device if device is None else device
        self._whiten = form == "white"
        self._other = Secret.generate() if wrong_decoder else None
        frame = bundle.fresh.frame(bundle.camera, bundle.scene, bundle.embedding)
        self._frame = replace(frame, imperfections=imperfections)
        self._classifier = Classifier.load(
            bundle.fresh.layers, bundle.fresh.weights, labels=bundle.labels, inputs=bundle.inputs
        )
        try:
            self._decoding = self._frame.decoding()
            # A mask that is never shown: what cannot be decoded is found now, and not on the way.
            self.make(0, "")
        except OpticsError as error:
            raise StartError(str(error)) from None
        self._names = EpochNames(secret, self._device)

    @property
    def renewable(self) -> bool:
        """Always."""
        return True

    def name(self, counter: int) -> str:
        """Return the enciphered counter."""
        return self._names.name(counter)

    def make(self, counter: int, last_mark: str) -> Mask:  # noqa: ARG002 - none comes twice
        """Draw the mask of epoch ``counter`` and prepare its decoder."""
        levels = self._levels(self._secret, counter)
        read = levels if self._other is None else self._levels(self._other, counter)
        with torch.inference_mode():
            decoder = self._decoding.prepare(self._frame.shown(read))
            whitening = Whitening(decoder, read) if self._whiten else None
        return Mask(levels, FreshReader(self._fresh, self._classifier, decoder, whitening))

    def _levels(self, secret: Secret, counter: int) -> Levels:
        return epoch_levels(
            secret,
            self._device,
            counter,
            camera=self._camera,
            distribution=self._fresh.distribution,
        )
