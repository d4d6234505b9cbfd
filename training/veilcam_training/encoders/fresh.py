"""The camera whose mask changes all the time: masks from a distribution, and measurements decoded.

Small embeddings tell little apart behind a mask drawn uniformly. So the distribution itself may be
learned, before the classifier: not a mask, but where the key may draw. The ranges are public; each
mask is drawn within them, is used and forgotten.
"""

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Self

import numpy as np
import torch
from pydantic import BaseModel, Field
from torch import Tensor, nn
from torch.nn.functional import avg_pool2d

from veilcam_optics.camera.geometry import Camera, Scene
from veilcam_optics.camera.imperfections import Imperfections, Spreads
from veilcam_optics.camera.masks import quantise, to_weights
from veilcam_optics.decoding import (
    Decoder,
    SceneFrame,
    SceneStatistics,
    fit_statistics,
    unknown_share,
)
from veilcam_optics.keys.masks import KEY_BYTES, Levels, MaskDistribution, draw_levels
from veilcam_optics.simulation.operator import LightOperator
from veilcam_optics.transfer.regions import Region
from veilcam_training.bundle import classifier_inputs
from veilcam_training.data import Images
from veilcam_training.encoders.base import Encoder, Setup
from veilcam_training.encoders.imperfections import make_operators
from veilcam_training.errors import TrainingError, require
from veilcam_training.seeding import derive, stream
from veilcam_training.transforms.scene import Transform

STATISTICS_BATCH = 2000
STATISTICS_SCENES = 30_000
"""Scenes that the statistics are made from, at most; of colour, a third of them."""
RANGE_STEPS = 120
RANGE_RATE = 0.05
"""Of Adam, at first; the centres have a range of 1."""


class Misalignment(BaseModel, frozen=True, extra="forbid", strict=True):
    """Misalignment that calibration leaves: the decoder assumes the nominal geometry.

    Each mask is shown by a panel that is displaced by normal random amounts with these standard
    deviations.
    """

    shift: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 2e-6
    """Along y and along x [m]."""
    distance: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 5e-6
    """Between mask and sensor [m]."""
    panels: Annotated[int, Field(ge=1, le=1024)] = 16
    """How many displaced panels are made; each mask takes one at random."""


class LearnedRange(nn.Module):
    """Ranges of ``u`` in [0, 1], one for each sub-pixel; the panel shows ``u ** exponent``.

    Args:
        camera: window and panel.
        exponent: exponent of the curve.
        spread: half the length of a range, in (0, 1]; ranges end at 0 and 1.
        generator: draws the first centres, near 1/2.
    """

    def __init__(
        self, camera: Camera, exponent: float, spread: float, generator: torch.Generator
    ) -> None:
        super().__init__()
        self.camera, self.exponent, self.spread = camera, exponent, spread
        noise = torch.randn(camera.mask_shape, generator=generator)
        self.centre = nn.Parameter(0.5 + 0.02 * noise)

    def forward(self, generator: torch.Generator) -> Tensor:
        """One mask's weights, ``camera.mask_shape``, differentiable in the centres."""
        low, high = self._ends()
        drawn = low + (high - low) * torch.rand(low.shape, generator=generator).to(low.device)
        # Not quite 0: a power's slope there is 0, or infinite below an exponent of 1.
        return quantise(drawn.clamp_min(1e-4) ** self.exponent, self.camera.panel)

    def project(self) -> None:
        """Bring the centres back into [0, 1]."""
        with torch.no_grad():
            self.centre.clamp_(0, 1)

    def distribution(self) -> MaskDistribution:
        """Return the distribution to publish, in whole levels."""
        top = self.camera.panel.levels - 1
        low, high = (
            (end.detach() * top).round().to(torch.uint8).cpu().numpy().astype(np.uint8)
            for end in self._ends()
        )
        curve = MaskDistribution.power(self.camera, self.exponent).curve
        return MaskDistribution(low, high, curve)

    def _ends(self) -> tuple[Tensor, Tensor]:
        return (self.centre - self.spread).clamp_min(0), (self.centre + self.spread).clamp_max(1)


@dataclass(frozen=True)
class PreparedMask:
    """A mask as the camera has it: what it does to scenes, and how that is undone."""

    transfer: Tensor = field(repr=False)
    """Of the camera as it is, (scene pixels, embedding pixels), three of them in colour."""
    decoder: Decoder = field(repr=False)
    """Of the camera as it is thought to be."""

    def embed(self, scenes: Tensor) -> Tensor:
        """Noiseless measurements (batch, embedding values) of scenes.

        Args:
            scenes: (batch, rows, columns), or (batch, 3, rows, columns) in colour.
        """
        if self.transfer.ndim == 2:
            return scenes.flatten(1) @ self.transfer
        return torch.einsum("bcp,cpe->bce", scenes.flatten(2), self.transfer).flatten(1)

    def decode(self, measurements: Tensor) -> Tensor:
        """Input of the classifier, (batch, values of the decoded scene)."""
        return classifier_inputs(self.decoder, measurements)


@dataclass(frozen=True)
class MaskSchedule:
    """Schedule of masks."""

    seed: int
    """Of the keys that they come from, and of the panels that show them."""
    misalignment: Misalignment | None = None


class FreshCamera(Encoder):
    """A camera whose mask changes all the time.

    Args:
        frame: the camera, and what is publicly known of scenes and noise.
        source: source of masks; ranges are learned, and take the place of the frame's.
        setup: setup of the same camera; the frame's scene may have larger pixels than its own.
        schedule: schedule of masks.
    """

    def __init__(
        self,
        frame: SceneFrame,
        source: MaskDistribution | LearnedRange,
        setup: Setup,
        schedule: MaskSchedule,
    ) -> None:
        super().__init__(setup)
        self._frame, self.source, self.schedule = frame, source, schedule
        self.decoding = frame.decoding()
        # Held in a dictionary: kernels are constants of the camera and belong in no state_dict.
        self._panels: dict[str, tuple[LightOperator, ...]] = {"": make_operators(setup)}
        self.coming: Iterator[PreparedMask] = iter(())
        """Masks to come, one for each batch of scenes."""
        self._mask: PreparedMask | None = None

    @property
    def distribution(self) -> MaskDistribution:
        """Distribution that masks have to be drawn from."""
        if isinstance(self.source, LearnedRange):
            return self.source.distribution()
        return self.source

    @property
    def frame(self) -> SceneFrame:
        """All that decoding needs besides the key of a mask."""
        return replace(self._frame, distribution=self.distribution)

    def forward(self, scenes: Tensor, part: Region | None = None, grid: int = 0) -> Tensor:
        """Noiseless embeddings of whole scenes behind the next mask.

        Raises:
            TrainingError: a part or another grid.
        """
        if part is not None or grid:
            raise TrainingError("fresh masks take whole scenes on one grid: show them as they are")
        self._mask = next(self.coming)
        return self._mask.embed(scenes)

    def decode(self, measurements: Tensor) -> Tensor:
        """Input of the classifier, from measurements behind the mask of the last scenes."""
        if self._mask is None:
            raise TrainingError("no mask is shown yet: give scenes first")
        return self._mask.decode(measurements)

    def learn_range(self) -> None:
        """Learn the ranges that leave least of the scenes unknown, without labels or images.

        Each step draws a mask; what falls is the expected error of the estimate behind it.
        """
        if not isinstance(self.source, LearnedRange):
            return
        random = stream(self.schedule.seed, "range")
        optimiser = torch.optim.Adam(self.source.parameters(), RANGE_RATE)
        known = self.decoding
        for step in range(RANGE_STEPS):
            falling = (1 + math.cos(math.pi * step / RANGE_STEPS)) / 2
            optimiser.param_groups[0]["lr"] = RANGE_RATE * falling
            transfer = known.operator(self.source(random))
            loss = unknown_share(transfer, known.statistics, known.noise)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            self.source.project()
        self.source.requires_grad_(False)

    def panels(self, purpose: str) -> tuple[LightOperator, ...]:
        """Return the camera as it may be built: displaced panels, others per purpose."""
        misalignment = self.schedule.misalignment
        if misalignment is None:
            return self._panels[""]
        if purpose not in self._panels:
            random = stream(self.schedule.seed, "panels", purpose)
            spreads = Spreads(misalignment.shift, misalignment.distance, normal=True)
            self._panels[purpose] = tuple(
                make_operators(self.setup, Imperfections.sample(spreads, random))[0].to(
                    self._device
                )
                for _ in range(misalignment.panels)
            )
        return self._panels[purpose]

    @property
    def _device(self) -> torch.device:
        return next(self.decoding.operator.buffers()).device

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Self:
        """Take kernels and statistics along to another device."""
        super()._apply(fn, recurse)  # type: ignore[no-untyped-call]
        for operator in (self.decoding.operator, *itertools.chain(*self._panels.values())):
            # What nn.Module does to its own children.
            operator._apply(fn)  # type: ignore[no-untyped-call] # noqa: SLF001
        known = self.decoding.statistics
        self.decoding.statistics = SceneStatistics(
            fn(known.mean), fn(known.basis), fn(known.residual)
        )
        return self

    def draw_levels(self, *purpose: str | int) -> Levels:
        """Draw the mask for a purpose: its key comes from the schedule's seed."""
        key = np.random.default_rng(derive(self.schedule.seed, *purpose)).bytes(KEY_BYTES)
        return draw_levels(key, camera=self.setup.camera, distribution=self.distribution)

    @torch.no_grad()
    def masks(self, *purpose: str | int) -> Iterator[PreparedMask]:
        """Yield prepared masks without end, none twice; others for every ``purpose``."""
        panels = self.panels(str(purpose[0]))
        choice = stream(self.schedule.seed, "panel", *purpose)
        for number in itertools.count():
            weights = torch.from_numpy(
                to_weights(self.draw_levels(*purpose, number), self.setup.camera.panel)
            )
            yield self.prepare(weights.to(self._device), panels, choice)

    def prepare(
        self, weights: Tensor, panels: Sequence[LightOperator], choice: torch.Generator
    ) -> PreparedMask:
        """Prepare a mask behind one of ``panels``; differentiable in the weights."""
        panel = panels[int(torch.randint(len(panels), (), generator=choice))]
        transfer = panel(weights).to(weights.dtype)  # a small tolerance is planned in float64
        return PreparedMask(transfer, self.decoding.prepare(weights))

    def one_by_one(self, *purpose: str | int, wrong_key: bool = False) -> Iterator[PreparedMask]:
        """Yield a mask for each batch, none of them twice.

        Args:
            purpose: masks for one are never those for another.
            wrong_key: True has each mask's measurements decoded with the decoder of another one.
        """
        source = self.masks(*purpose)
        for mask in source:
            yield replace(mask, decoder=next(source).decoder) if wrong_key else mask


def pooled(scene: Scene, side: int) -> Scene:
    """Return the same scene in pixels ``side`` times as large."""
    require(
        scene.rows % side == 0 and scene.columns % side == 0,
        f"pooling = {side} does not divide the scene's {scene.rows} x {scene.columns} pixels: "
        "use a divisor of both",
    )
    return replace(scene, rows=scene.rows // side, columns=scene.columns // side)


def scene_statistics(
    training: Images,
    change: Transform,
    *,
    pooling: int,
    rank: int,
    seed: int,
    mirrored: bool = False,
) -> SceneStatistics:
    """Statistics of decoded scenes, from training images shown as they will be.

    Args:
        training: images.
        change: transform that shows the images.
        pooling: side of a pixel of the decoded scene, in scene pixels.
        rank: principal components to keep.
        seed: seed of the choice of images and of their places.
        mirrored: True takes each scene's mirror image for a scene, too.
    """
    places = stream(seed, "statistics")
    colour = training.pixels.ndim == 4
    most = STATISTICS_SCENES // 3 if colour else STATISTICS_SCENES
    order = torch.randperm(len(training), generator=places)[:most]

    def batches() -> Iterator[Tensor]:
        for chosen in torch.split(order, STATISTICS_BATCH):
            scenes = change(training.scenes(chosen), places)
            scenes = avg_pool2d(scenes if colour else scenes[:, None], pooling)
            yield scenes
            if mirrored:
                yield scenes.flip(-1)

    return fit_statistics(batches(), rank)
