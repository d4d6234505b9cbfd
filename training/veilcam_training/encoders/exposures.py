"""Several exposures of one scene, each through a mask of its own, read as one embedding."""

from dataclasses import replace

import torch
from torch import Tensor, nn

from veilcam_optics.transfer.regions import Region
from veilcam_training.encoders.base import LinearEncoder, Setup
from veilcam_training.encoders.imperfections import PanelErrors
from veilcam_training.encoders.masks import NO_ERRORS, FixedMask, LearnedMask, Mask


class Exposures(LinearEncoder):
    """A panel that shows ``setup.exposures`` masks one after the other, while the scene stays.

    Each exposure is as long as that of a camera with one mask. Their values stand behind each
    other, those of a colour together.

    Args:
        mask: how each mask comes about.
        setup: camera, scene and measurement.
        generator: draws the masks, all different.
        errors: of the panel, in training; each mask has its own.
    """

    def __init__(
        self,
        mask: type[LearnedMask | FixedMask],
        setup: Setup,
        generator: torch.Generator,
        errors: PanelErrors = NO_ERRORS,
    ) -> None:
        super().__init__(setup)
        single = replace(setup, exposures=1)
        self._masks = nn.ModuleList(mask(single, generator, errors) for _ in range(setup.exposures))
        self.trainable = mask.trainable
        self.constant = all(each.constant for each in self.masks)

    @property
    def masks(self) -> tuple[Mask, ...]:
        """In the order in which they are shown."""
        return tuple(each for each in self._masks if isinstance(each, Mask))

    def transfer(self, part: Region | None = None, grid: int = 0) -> Tensor:
        """T of all exposures side by side, see :meth:`LinearEncoder.transfer`."""
        return torch.cat([each.transfer(part, grid) for each in self.masks], dim=-1)

    def project(self) -> None:
        """Bring the parameters of every mask back into what the device can show."""
        for each in self.masks:
            each.project()
