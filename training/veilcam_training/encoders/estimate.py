"""The best linear estimate of the scene behind the one mask of a camera.

It is what :mod:`veilcam_optics.decoding` decodes behind fresh masks, of a camera whose mask is
learned or fixed: an affine function of the measurement. Behind a mask that stays, it is one or two
fully connected layers like any other, and leaves as them.
"""

import math

import torch
from torch import Tensor, nn

from veilcam_optics.decoding import (
    Decoder,
    MeasurementNoise,
    SceneStatistics,
    prepare_decoder,
    unknown_share,
)
from veilcam_training.bundle.layers import Linear
from veilcam_training.encoders.base import LinearEncoder
from veilcam_training.encoders.fresh import pooled
from veilcam_training.encoders.masks import LearnedMask
from veilcam_training.errors import TrainingError, require

MASK_STEPS = 120
MASK_RATE = 0.05
"""Of Adam, at first; weights have a range of 1."""
MASK_RANK = 384
"""Principal components that a mask is learned for."""
SPARSE = 16.0
"""Power of the random weights that a mask without a bound on its copies is learned from: few open
sub-pixels keep contrast."""

MAX_VALUES = 4096
"""Of a scene, three for each pixel in colour: its covariance is a matrix of so many rows."""


class SceneEstimate(nn.Module):
    """Estimate of scenes from measurements.

    Nothing is known of scenes until :meth:`learn`: all of them are taken to be black.

    Args:
        encoder: the camera, with one grid. It is looked at, and no part of this module.
        snr_db: signal-to-noise ratio to expect of a measurement [dB]; None for no noise.
        rank: principal components of the scene, a dial of accuracy against time.
        pooling: side of a pixel of the estimate, in scene pixels.

    Raises:
        TrainingError: a pooling that does not divide the scene, or a scene that is too large.
    """

    mean: Tensor
    basis: Tensor
    residual: Tensor

    def __init__(
        self, encoder: LinearEncoder, snr_db: float | None, rank: int, pooling: int = 1
    ) -> None:
        super().__init__()
        setup = encoder.setup
        values = setup.channels * setup.scene.rows * setup.scene.columns
        require(
            values <= MAX_VALUES,
            f"a scene of {setup.scene.rows} x {setup.scene.columns} pixels is too large to "
            f"estimate: use pictures of at most {MAX_VALUES // setup.channels} pixels, or a "
            "classifier of measurements",
        )
        self.scene = pooled(setup.scene, pooling)
        self.channels, self.inputs = setup.channels, setup.outputs
        self.rank = min(rank, values)
        self._encoder = (encoder,)  # in a tuple, so that it is registered once alone
        # 200 dB is as good as none: a decoder takes a finite number.
        self._noise = MeasurementNoise(200.0 if snr_db is None else snr_db)
        self._pooling = pooling
        self._known: Decoder[Tensor] | None = None
        # Made again from the training images wherever a fit is taken up: no part of a checkpoint.
        black = torch.zeros(values)
        self.register_buffer("mean", black, persistent=False)
        self.register_buffer("basis", black[:, None].expand(-1, self.rank), persistent=False)
        self.register_buffer("residual", black.clone(), persistent=False)

    @property
    def outputs(self) -> int:
        """Number of values that it gives."""
        return self.channels * self.scene.rows * self.scene.columns

    @property
    def layers(self) -> tuple[Linear, ...]:
        """Records of the layers that :meth:`as_layers` gives."""
        if self._low_rank:
            first = Linear(inputs=self.inputs, outputs=self.rank)
            return first, Linear(inputs=self.rank, outputs=self.outputs)
        return (Linear(inputs=self.inputs, outputs=self.outputs),)

    @property
    def _low_rank(self) -> bool:
        """True where two layers take fewer products than one."""
        return self.rank * (self.inputs + self.outputs) < self.inputs * self.outputs

    def learn(self, statistics: SceneStatistics[Tensor]) -> None:
        """Take ``statistics`` of scenes, in pixels of the scene, to be what is known of them."""
        self.mean, self.basis, self.residual = (
            each.to(self.mean) for each in (statistics.mean, statistics.basis, statistics.residual)
        )
        self._known = None

    def forward(self, measurements: Tensor) -> Tensor:
        """(batch, ``outputs``) from measurements (batch, embedding values)."""
        mean, basis = self._shown
        estimate: Tensor = mean + self._decoder().coordinates(measurements) @ basis.T
        return estimate

    def learn_mask(self) -> float:
        """Learn the mask whose measurements leave least of the scenes unknown, without labels.

        What falls is the expected error of the estimate, a function of mask and statistics alone,
        and the penalty of the mask's encoder. No image is shown, so it takes less than a minute.

        Returns:
            The share of the scenes' variance that is left unknown, in [0, 1].

        Raises:
            TrainingError: an encoder that learns no mask.
        """
        (encoder,) = self._encoder
        if not isinstance(encoder, LearnedMask):
            raise TrainingError("this encoder learns no mask: use the encoder 'learned'")
        known = SceneStatistics(self.mean, self.basis, self.residual)
        known = known.truncate(min(MASK_RANK, self.rank))
        if not encoder.hidden:
            with torch.no_grad():
                encoder.weights.pow_(SPARSE)
        encoder.project()
        optimiser = torch.optim.Adam([encoder.weights], MASK_RATE)
        for step in range(MASK_STEPS):
            falling = (1 + math.cos(math.pi * step / MASK_STEPS)) / 2
            optimiser.param_groups[0]["lr"] = MASK_RATE * falling
            loss = unknown_share(encoder.transfer(), known, self._noise) + encoder.penalty()
            optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimiser.step()
            encoder.project()
        encoder.zero_grad()
        with torch.no_grad():
            return unknown_share(encoder.transfer(), known, self._noise).item()

    @torch.no_grad()
    def as_layers(self) -> list[nn.Linear]:
        """Return the same as fully connected layers, for the mask as it is now."""
        decoder, (mean, basis) = self._decoder(), self._shown
        offset = -decoder.estimator @ decoder.mean_measurement
        maps = [(decoder.estimator, offset), (basis, mean)]
        if not self._low_rank:
            maps = [(basis @ decoder.estimator, mean + basis @ offset)]
        layers = []
        for matrix, bias in maps:
            layer = nn.Linear(matrix.shape[1], matrix.shape[0], device=matrix.device)
            layer.weight.copy_(matrix)
            layer.bias.copy_(bias)
            layers.append(layer)
        return layers

    def _decoder(self) -> Decoder[Tensor]:
        """Return the decoder of the camera as it is now; made once for a constant camera."""
        (encoder,) = self._encoder
        if not encoder.constant:
            return self._prepare(encoder)
        if self._known is None or self._known.mean.device != self.mean.device:
            self._known = self._prepare(encoder)
        return self._known

    def _prepare(self, encoder: LinearEncoder) -> Decoder[Tensor]:
        return prepare_decoder(
            encoder.transfer(),
            SceneStatistics(self.mean, self.basis, self.residual),
            self._noise,
            scene=encoder.setup.scene,
            embedding=encoder.setup.embedding,
        )

    @property
    def _shown(self) -> tuple[Tensor, Tensor]:
        """Mean and basis in pixels of the estimate."""
        return self._pooled(self.mean), self._pooled(self.basis.T).T

    def _pooled(self, values: Tensor) -> Tensor:
        """Means over the scene's pixels, the last axis, within each pixel of the estimate."""
        (rows, columns), side = self.scene.shape, self._pooling
        parts = values.reshape(*values.shape[:-1], self.channels, rows, side, columns, side)
        means: Tensor = parts.mean((-3, -1)).flatten(-3)
        return means
