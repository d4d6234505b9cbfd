"""The simulated camera of a fit: masks from a distribution, readings, and what is made of them."""

from __future__ import annotations

import functools
import itertools
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.decoding import (
    Decoder,
    ReadingNoise,
    SceneFrame,
    SceneStatistics,
    fit_statistics,
)
from veilcam_optics.keys.masks import SECRET_BYTES, Levels, MaskDistribution, Secret, epoch_levels
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.transfer.operator import TransferOperator, Variables
from veilcam_training.bundle.fresh import FEATURES, classifier_inputs
from veilcam_training.config.fresh import FreshSettings, Misalignment
from veilcam_training.data import Images
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.fit import parse_embedding
from veilcam_training.seeding import derive, stream
from veilcam_training.transforms.scene import Anywhere, Identity, Transform

STATISTICS_BATCH = 2000
STATISTICS_SCENES = 30_000
"""How many scenes the statistics are made from, at most."""
CHANNELS = len(FEATURES)
"""Of the classifier's input, each as large as the decoded scene."""


@dataclass(frozen=True)
class PreparedMask:
    """A mask as the camera has it: what it does to scenes, and how that is undone."""

    transfer: Tensor = field(repr=False)
    """Of the camera as it is, (scene pixels, embedding pixels)."""
    decoder: Decoder = field(repr=False)
    """Of the camera as it is thought to be."""
    snr_db: float

    def read(self, scenes: Tensor, noise: torch.Generator) -> Tensor:
        """Noisy readings (batch, embedding pixels) of scenes (batch, rows, columns)."""
        return shot_noise(scenes.flatten(1) @ self.transfer, self.snr_db, noise)

    def decode(self, readings: Tensor) -> Tensor:
        """Input of the classifier, (batch, CHANNELS x pixels of the decoded scene)."""
        return classifier_inputs(self.decoder, readings)


class FreshCamera:
    """A camera whose mask changes all the time.

    Args:
        settings: of the fit.
        camera: the device.
        image: how large and how far away the images are shown.
        statistics: of the decoded scenes, public; see :func:`scene_statistics`.

    Raises:
        TrainingError: settings that do not fit one another.
    """

    def __init__(
        self, settings: FreshSettings, camera: Camera, image: Scene, statistics: SceneStatistics
    ) -> None:
        if settings.masks % settings.renewed or settings.batch % settings.masks:
            raise TrainingError(
                f"batch = {settings.batch}, masks = {settings.masks}, "
                f"renewed = {settings.renewed}: use numbers that divide one another"
            )
        self.settings, self.camera = settings, camera
        self.embedding: Embedding = parse_embedding(settings.embedding)
        self.placement = make_placement(settings, camera, image)
        self.scene = pooled(self.placement.scene, settings.pooling)
        self.statistics = statistics
        self.distribution = MaskDistribution.power(camera, settings.exponent)
        """What masks are drawn from; a fit that learns it replaces it."""
        self.decoding = self.frame.decoding()
        self._nominal = TransferOperator(camera, self.placement.scene, self.embedding)

    @property
    def frame(self) -> SceneFrame:
        """All that decoding needs besides a secret."""
        return SceneFrame(
            self.camera,
            self.scene,
            self.embedding,
            self.statistics,
            ReadingNoise(self.settings.snr_db, self.settings.model_error),
            distribution=self.distribution,
        )

    @functools.cache  # noqa: B019 - a fit has one camera, and makes few sets of panels
    def panels(self, purpose: str) -> tuple[TransferOperator, ...]:
        """The camera as it may be built: displaced panels, other ones for another purpose."""
        misalignment = self.settings.misalignment
        if misalignment is None:
            return (self._nominal,)
        random = stream(self.settings.seed, "panels", purpose)
        return tuple(self._displaced(misalignment, random) for _ in range(misalignment.panels))

    def _displaced(self, misalignment: Misalignment, random: torch.Generator) -> TransferOperator:
        amounts = torch.randn(3, generator=random, dtype=torch.float64)
        return TransferOperator(
            replace(
                self.camera,
                distance=self.camera.distance + float(amounts[2]) * misalignment.distance,
            ),
            self.placement.scene,
            self.embedding,
            variables=Variables(
                shift_y=amounts[0] * misalignment.shift, shift_x=amounts[1] * misalignment.shift
            ),
        )

    def draw_levels(self, *purpose: str | int) -> Levels:
        """A mask of the key for a purpose, ``purpose[:-1]``, at the epoch ``purpose[-1]``."""
        *name, epoch = purpose
        return epoch_levels(
            self._secret(*name),
            "simulated",
            int(epoch),
            camera=self.camera,
            distribution=self.distribution,
        )

    def _secret(self, *purpose: str | int) -> Secret:
        seed = derive(self.settings.seed, *purpose)
        return Secret(np.random.default_rng(seed).bytes(SECRET_BYTES))

    @torch.no_grad()
    def masks(self, *purpose: str | int) -> Iterator[PreparedMask]:
        """Prepared masks without end, one per epoch of a key, another key for every ``purpose``."""
        panels = self.panels(str(purpose[0]))
        choice = stream(self.settings.seed, "panel", *purpose)
        for epoch in itertools.count():
            weights = to_weights(self.draw_levels(*purpose, epoch), self.camera.panel)
            yield self.prepare(weights, panels, choice)

    def prepare(
        self, weights: Tensor, panels: Sequence[TransferOperator], choice: torch.Generator
    ) -> PreparedMask:
        """A mask behind one of ``panels``; differentiable in the weights."""
        panel = panels[int(torch.randint(len(panels), (), generator=choice))]
        return PreparedMask(panel(weights), self.decoding.prepare(weights), self.settings.snr_db)

    def rings(self, *purpose: str | int) -> Iterator[tuple[PreparedMask, ...]]:
        """The masks in use at each step; the oldest are replaced, so each serves a few steps."""
        source = self.masks(*purpose)
        ring = deque((next(source) for _ in range(self.settings.masks)), self.settings.masks)
        while True:
            yield tuple(ring)
            ring.extend(next(source) for _ in range(self.settings.renewed))


def pooled(scene: Scene, side: int) -> Scene:
    """The same scene in pixels ``side`` times as large."""
    if scene.rows % side or scene.columns % side:
        raise TrainingError(
            f"pooling = {side} does not divide the scene's {scene.rows} x {scene.columns} pixels: "
            "use a divisor of both"
        )
    return replace(scene, rows=scene.rows // side, columns=scene.columns // side)


def make_placement(settings: FreshSettings, camera: Camera, image: Scene) -> Transform:
    """Where images are shown."""
    if settings.placement == "centred":
        return Identity(image)
    return Anywhere(image, camera, settings.pooling)


def scene_statistics(
    settings: FreshSettings, camera: Camera, image: Scene, training: Images
) -> SceneStatistics:
    """Statistics of decoded scenes, from training images placed as they will be."""
    placement = make_placement(settings, camera, image)
    places = stream(settings.seed, "statistics")
    order = torch.randperm(len(training), generator=places)[:STATISTICS_SCENES]

    def batches() -> Iterator[Tensor]:
        for chosen in torch.split(order, STATISTICS_BATCH):
            scenes = placement(training.scenes(chosen), places)
            yield avg_pool2d(scenes[:, None], settings.pooling)[:, 0]

    return fit_statistics(batches(), settings.rank)
