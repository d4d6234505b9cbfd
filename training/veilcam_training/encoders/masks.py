"""The programmable mask: learned together with the classifier, or fixed."""

from collections.abc import Callable
from itertools import chain
from typing import Self

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn

from veilcam_optics.camera.masks import quantise, random_mask, to_levels, to_weights
from veilcam_optics.transfer.regions import Region
from veilcam_training.encoders.base import LinearEncoder, Setup
from veilcam_training.encoders.copies import Copies
from veilcam_training.encoders.imperfections import PanelErrors, make_places

NO_ERRORS = PanelErrors()
GROUND = 0.05
"""Largest amplitude around a pinhole: closed sub-pixels would have next to no gradient."""


class Mask(LinearEncoder):
    """A mask on the panel, which is ideal in evaluation and errs in training as ``errors`` says."""

    def __init__(self, setup: Setup, generator: torch.Generator, errors: PanelErrors) -> None:
        super().__init__(setup)
        self._drawn = random_mask(setup.camera, generator)
        self.errors = errors
        # Held in a tuple: kernels are constants of the camera and belong in no state_dict.
        self._operators = make_places(setup, errors, generator)

    def _transfer(self, shown: Tensor, part: Region | None, grid: int) -> Tensor:
        """T of the mask that an ideal panel would show."""
        place = 0
        if self.training and self.errors.any:
            shown = self.errors.shown(shown)
            if self.errors.moves:
                place = int(torch.randint(1, len(self._operators), (1,)))
        transfer: Tensor = self._operators[place][grid](shown, part)
        return transfer.to(shown.dtype)  # a plan for a small tolerance is in float64

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Self:
        """Take the operators along to another device."""
        super()._apply(fn, recurse)  # type: ignore[no-untyped-call]
        for operator in chain.from_iterable(self._operators):
            # What nn.Module does to its own children.
            operator._apply(fn)  # type: ignore[no-untyped-call] # noqa: SLF001
        return self

    def levels(self) -> npt.NDArray[np.uint8]:
        """Return the levels for the panel, uint8, ``camera.mask_shape``."""
        raise NotImplementedError


class LearnedMask(Mask):
    """A mask that is learned, by the amplitude that each of its sub-pixels transmits.

    Weights stay in [0, 1] by projection after every step, and what is propagated is those weights
    rounded to the panel's levels (straight-through). No sub-pixel dies: clamping in the forward
    pass would leave no gradient beyond the bounds, and at exactly 0 there is none either, because
    light grows as the weight squared. So the projection stops just short of 0, at ``closed``, which
    the panel shows, and evaluation takes, as opaque.

    Learning intensities instead would pull dark sub-pixels as hard as open ones. Weights are
    better: their gradient fades as they close, so masks grow sparse and keep the contrast that
    few large pixels need.

    Args:
        setup: camera, scene and measurement; the masks are those of ``setup.camera.panel``.
        generator: draws the mask that training starts from.
        errors: errors of the panel, in training.
    """

    trainable = True

    def __init__(
        self, setup: Setup, generator: torch.Generator, errors: PanelErrors = NO_ERRORS
    ) -> None:
        super().__init__(setup, generator, errors)
        self.weights = nn.Parameter(self._drawn.clone())
        self.closed = 0.3 / (setup.camera.panel.levels - 1)
        self._least = 0.0
        self._copies: tuple[Copies, ...] = ()

    def start_from_pinhole(self) -> None:
        """Open one pixel, a sub-pixel of each colour, at the middle; dim all others to ``GROUND``.

        This mask forms an image from the first step on, where a random one lays hundreds over each
        other: training finds its way faster where an object may be anywhere.
        """
        rows, columns = self.setup.camera.mask_shape
        top = max(0, rows // 2 - 1)
        with torch.no_grad():
            self.weights.mul_(GROUND)
            self.weights[top : top + 3, (columns - 1) // 2] = 1
        self.project()

    def transfer(self, part: Region | None = None, grid: int = 0) -> Tensor:
        """T of the mask as the panel shows it, differentiable in the weights."""
        shown = quantise(self.weights, self.setup.camera.panel)
        if self.training and not self.constant:
            # Lifted without touching the gradient, which a plain clamp would cut.
            shown = shown + (self.closed - shown).clamp_min(0).detach()
        return self._transfer(shown, part, grid)

    def hold(self, *, held: bool = True) -> None:
        """Keep the mask as it is now: what follows learns to read behind it.

        Args:
            held: False lets it be learned again.
        """
        self.weights.requires_grad_(not held)
        self.constant = held and not self.errors.any

    def hide(self, least: float) -> None:
        """Have a fit keep the scene's copies many, so that no eye sees one.

        Args:
            least: least count of copies, as a share of that of random masks; 0 asks for none.
        """
        self._least = least
        if least and not self._copies:  # in a tuple: they are constants, and in no state_dict
            setup = self.setup
            copies = Copies(setup.camera, setup.scene, colour=setup.colour)
            self._copies = (copies.to(self.weights.device),)

    @property
    def hidden(self) -> bool:
        """True where the copies are kept many."""
        return self._least > 0

    def penalty(self) -> Tensor | float:
        """Return the penalty of too few copies, a scalar."""
        if not self.hidden:
            return 0.0
        (copies,) = self._copies
        penalty: Tensor = copies(self.weights, self._least)
        return penalty

    def project(self) -> None:
        """Bring the weights back into [closed, 1]."""
        with torch.no_grad():
            self.weights.clamp_(self.closed, 1)

    def levels(self) -> npt.NDArray[np.uint8]:
        """Return the levels for the panel, uint8, ``camera.mask_shape``."""
        return to_levels(self.weights.detach(), self.setup.camera.panel)


class FixedMask(Mask):
    """A mask drawn at random once.

    Args:
        setup: camera, scene and measurement; the masks are those of ``setup.camera.panel``.
        generator: draws the mask.
        errors: errors of the panel, in training.
    """

    shown: Tensor

    def __init__(
        self, setup: Setup, generator: torch.Generator, errors: PanelErrors = NO_ERRORS
    ) -> None:
        super().__init__(setup, generator, errors)
        panel = setup.camera.panel
        levels = to_levels(self._drawn, panel)
        self.constant = not errors.any
        self.register_buffer("shown", torch.from_numpy(levels))
        for grid, operator in enumerate(self._operators[0]):
            weights = torch.from_numpy(to_weights(levels, panel))
            self.register_buffer(f"matrix_{grid}", operator(weights).to(weights.dtype))

    def transfer(self, part: Region | None = None, grid: int = 0) -> Tensor:
        """T, a constant as long as the panel does not err."""
        if self.training and self.errors.any:
            panel = self.setup.camera.panel
            shown = torch.from_numpy(to_weights(self.levels(), panel)).to(self.shown.device)
            return self._transfer(shown, part, grid)
        return self._of_part(self.get_buffer(f"matrix_{grid}"), part, grid)

    def levels(self) -> npt.NDArray[np.uint8]:
        """Return the levels for the panel, uint8, ``camera.mask_shape``."""
        levels: npt.NDArray[np.uint8] = self.shown.cpu().numpy()
        return levels
