"""The camera whose mask changes all the time: masks from a distribution, and measurements decoded.

Small embeddings tell little apart behind a mask drawn uniformly. So the distribution itself may be
learned, together with the classifier: not a mask, but where the key may draw. The ranges are
public; each mask is drawn within them, is used and forgotten.
"""

import itertools
from collections import deque
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
from veilcam_optics.decoding import Decoder, SceneFrame, SceneStatistics, fit_statistics
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
"""How many scenes the statistics are made from, at most."""


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
    """Of the camera as it is, (scene pixels, embedding pixels)."""
    decoder: Decoder = field(repr=False)
    """Of the camera as it is thought to be."""

    def embed(self, scenes: Tensor) -> Tensor:
        """Noiseless measurements (batch, embedding pixels) of scenes (batch, rows, columns)."""
        return scenes.flatten(1) @ self.transfer

    def decode(self, measurements: Tensor) -> Tensor:
        """Input of the classifier, (batch, features x pixels of the decoded scene)."""
        return classifier_inputs(self.decoder, measurements)


@dataclass(frozen=True)
class MaskSchedule:
    """Schedule of masks."""

    seed: int
    """Of the keys that they come from, and of the panels that show them."""
    masks: int = 1
    """In use at a time, in a fit; a batch is spread evenly over them."""
    renewed: int = 1
    """How many of them are replaced before every step of a fit."""
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
        self.trainable = isinstance(source, LearnedRange)
        self.decoding = frame.decoding()
        # Held in a dictionary: kernels are constants of the camera and belong in no state_dict.
        self._panels: dict[str, tuple[LightOperator, ...]] = {"": make_operators(setup)}
        self.coming: Iterator[tuple[PreparedMask, ...]] = iter(())
        """Masks of the steps to come, e.g. of :meth:`rings`."""
        self._ring: tuple[PreparedMask, ...] = ()

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
        """Noiseless embeddings of whole scenes, spread evenly over the masks of the next step.

        Raises:
            TrainingError: a part or another grid, or scenes that cannot be spread evenly.
        """
        if part is not None or grid:
            raise TrainingError("fresh masks take whole scenes on one grid: show them as they are")
        self._ring = next(self.coming)
        require(
            len(scenes) % len(self._ring) == 0,
            f"{len(scenes)} images cannot be spread evenly over {len(self._ring)} masks: use a "
            "batch that masks, times processes, divide",
        )
        return self._each(PreparedMask.embed, scenes)

    def decode(self, measurements: Tensor) -> Tensor:
        """Input of the classifier, from measurements behind the masks of the last scenes."""
        return self._each(lambda mask, part: mask.decode(part), measurements)

    def _each(self, act: Callable[[PreparedMask, Tensor], Tensor], values: Tensor) -> Tensor:
        parts = values.chunk(len(self._ring))
        return torch.cat([act(*pair) for pair in zip(self._ring, parts, strict=True)])

    def project(self) -> None:
        """Bring what is learned back into what the panel can show."""
        if isinstance(self.source, LearnedRange):
            self.source.project()

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

    def rings(self, *purpose: str | int) -> Iterator[tuple[PreparedMask, ...]]:
        """Yield the masks in use at each step; the oldest are replaced after a few steps."""
        count, renewed = self.schedule.masks, self.schedule.renewed
        if isinstance(self.source, LearnedRange):
            # All of them: a gradient cannot pass through a step that is over.
            source, renewed = self._learned_masks(self.source, *purpose), count
        else:
            source = self.masks(*purpose)
        ring = deque(itertools.islice(source, count), count)
        while True:
            yield tuple(ring)
            ring.extend(itertools.islice(source, renewed))

    def _learned_masks(self, ranges: LearnedRange, *purpose: str | int) -> Iterator[PreparedMask]:
        panels, random = self.panels(str(purpose[0])), stream(self.schedule.seed, *purpose)
        while True:
            yield self.prepare(ranges(random), panels, random)

    def one_by_one(
        self, *purpose: str | int, wrong_key: bool = False
    ) -> Iterator[tuple[PreparedMask, ...]]:
        """One mask at each step, none of them twice.

        Args:
            purpose: masks for one are never those for another.
            wrong_key: True has each mask's measurements decoded with the decoder of another one.
        """
        source = self.masks(*purpose)
        for mask in source:
            yield (replace(mask, decoder=next(source).decoder) if wrong_key else mask,)


def pooled(scene: Scene, side: int) -> Scene:
    """Return the same scene in pixels ``side`` times as large."""
    require(
        scene.rows % side == 0 and scene.columns % side == 0,
        f"pooling = {side} does not divide the scene's {scene.rows} x {scene.columns} pixels: "
        "use a divisor of both",
    )
    return replace(scene, rows=scene.rows // side, columns=scene.columns // side)


def scene_statistics(
    training: Images, change: Transform, *, pooling: int, rank: int, seed: int
) -> SceneStatistics:
    """Statistics of decoded scenes, from training images shown as they will be.

    Args:
        training: images.
        change: transform that shows the images.
        pooling: side of a pixel of the decoded scene, in scene pixels.
        rank: principal components to keep.
        seed: seed of the choice of images and of their places.
    """
    places = stream(seed, "statistics")
    order = torch.randperm(len(training), generator=places)[:STATISTICS_SCENES]

    def batches() -> Iterator[Tensor]:
        for chosen in torch.split(order, STATISTICS_BATCH):
            scenes = change(training.scenes(chosen), places)
            yield avg_pool2d(scenes[:, None], pooling)[:, 0]

    return fit_statistics(batches(), rank)
