"""What a classifier reads from released embeddings without any key: how well a form hides."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from veilcam_optics.camera.masks import to_levels
from veilcam_optics.decoding.release import ReleaseForm, Whitening, release
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_training.encoders.fresh import FreshCamera, PreparedMask
from veilcam_training.errors import TrainingError


@dataclass(frozen=True)
class ReleasedMask(PreparedMask):
    """A mask whose holder releases measurements; who sees them has no decoder."""

    form: ReleaseForm
    whitening: Whitening | None = field(repr=False)

    def decode(self, measurements: Tensor) -> Tensor:
        """The released form, (batch, E), each in units of its measurement's mean unless white."""
        released = release(measurements, self.form, self.decoder, self.whitening)
        if released is None:
            raise TrainingError("form = none releases nothing: use raw, flat or white")
        flat = released.flatten(1)
        if self.form is ReleaseForm.WHITE:
            return flat
        scale = (
            measurements if self.form is ReleaseForm.RAW else self.decoder.mean_measurement[None]
        )
        return flat / scale.mean(1, keepdim=True).clamp_min(torch.finfo(flat.dtype).tiny)


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
        """A mask behind one of ``panels``."""
        mask = super().prepare(weights, panels, choice)
        whitening = (
            Whitening(mask.decoder, to_levels(weights, self.setup.camera.panel))
            if self.form is ReleaseForm.WHITE
            else None
        )
        return ReleasedMask(mask.transfer, mask.decoder, self.form, whitening)
