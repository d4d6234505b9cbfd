"""What a classifier reads from released embeddings without any key: how well a form hides."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from veilcam_optics.decoding.release import ReleaseForm, Whitening
from veilcam_optics.keys.masks import KEY_BYTES
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_training.encoders.fresh import FreshCamera, PreparedMask


@dataclass(frozen=True)
class ReleasedMask(PreparedMask):
    """A mask whose holder releases measurements; who sees them has no decoder."""

    whitening: Whitening | None = field(repr=False)
    """None: they leave raw."""

    def decode(self, measurements: Tensor) -> Tensor:
        """What leaves, (batch, E): white times sqrt(E), or raw in units of each one's mean."""
        if self.whitening is not None:
            # Of variance 1, as a network likes its inputs.
            return self.whitening.whiten(measurements) * math.sqrt(measurements[0].numel())
        scale = measurements.mean(1, keepdim=True)
        return measurements / scale.clamp_min(torch.finfo(measurements.dtype).tiny)


class KeylessCamera(FreshCamera):
    """A camera that changes its mask all the time, seen by someone who has no key.

    Args:
        camera: with which one would have it.
        form: in which embeddings are released.
    """

    def __init__(self, camera: FreshCamera, form: ReleaseForm) -> None:
        super().__init__(camera.frame, camera.source, camera.setup.scene, camera.schedule)
        self.form = form

    def prepare(
        self, weights: Tensor, panels: Sequence[TransferOperator], choice: torch.Generator
    ) -> ReleasedMask:
        """A mask behind one of ``panels``, and a rotation of its own."""
        mask, whitening = super().prepare(weights, panels, choice), None
        if self.form is ReleaseForm.WHITE:
            key = torch.randint(256, (KEY_BYTES,), generator=choice, dtype=torch.uint8)
            whitening = Whitening(mask.decoder, key.numpy().tobytes())
        return ReleasedMask(mask.transfer, mask.decoder, whitening)
