"""The best linear estimate of the scene behind the one mask of a camera, and how sure it is.

It is what :mod:`veilcam_optics.decoding` decodes behind fresh masks, of a camera whose mask is
learned or fixed: an affine function of the measurement that follows the mask as it is learned.
Behind a mask that stays, it is a fully connected layer like any other, and leaves as one.
"""

import math

import torch
from torch import Tensor, nn

from veilcam_optics.decoding import Decoder, MeasurementNoise, SceneStatistics
from veilcam_optics.decoding.decoder import prepare_decoder
from veilcam_training.bundle.fresh import FEATURES, classifier_inputs
from veilcam_training.encoders.base import LinearEncoder
from veilcam_training.encoders.fresh import pooled
from veilcam_training.encoders.masks import LearnedMask
from veilcam_training.errors import TrainingError, require

SHARPENING_STEPS = 60
SHARPENING_RATE = 0.05
"""Of Adam, at first; weights have a range of 1."""
SPARSE = 16.0
"""Power of the random weights that a mask is sharpened from: few open sub-pixels keep contrast."""

MAX_PIXELS = 4096
"""Of a scene: its covariance is a matrix of so many rows, and fitted in a minute."""


class SceneEstimate(nn.Module):
    """Estimate of scenes from measurements, with the posterior deviation, one after the other.

    Nothing is known of scenes until :meth:`learn`: all of them are taken to be black.

    Args:
        encoder: the camera, gray, with one grid. It is looked at, and no part of this module.
        snr_db: signal-to-noise ratio to expect of a measurement [dB]; None for no noise.
        pooling: side of a pixel of the estimate, in scene pixels.

    Raises:
        TrainingError: a pooling that does not divide the scene, or a scene that is too large.
    """

    mean: Tensor
    basis: Tensor
    residual: Tensor

    def __init__(self, encoder: LinearEncoder, snr_db: float | None, pooling: int = 1) -> None:
        super().__init__()
        scene = encoder.setup.scene
        pixels = scene.rows * scene.columns
        require(
            pixels <= MAX_PIXELS,
            f"a scene of {scene.rows} x {scene.columns} pixels is too large to estimate: use "
            f"pictures of at most {MAX_PIXELS} pixels, or a classifier of measurements",
        )
        self.scene = pooled(scene, pooling)
        self._encoder = (encoder,)  # in a tuple, so that it is registered once alone
        # 200 dB is as good as none: a decoder takes a finite number.
        self._noise = MeasurementNoise(200.0 if snr_db is None else snr_db)
        self._pooling = pooling
        self._known: Decoder[Tensor] | None = None
        # Made again from the training images wherever a fit is taken up: no part of a checkpoint.
        self.register_buffer("mean", torch.zeros(pixels), persistent=False)
        self.register_buffer("basis", torch.zeros(pixels, 1), persistent=False)
        self.register_buffer("residual", torch.zeros(pixels), persistent=False)

    @property
    def outputs(self) -> int:
        """Number of values that it gives."""
        return len(FEATURES) * self.scene.rows * self.scene.columns

    def learn(self, statistics: SceneStatistics[Tensor]) -> None:
        """Take ``statistics`` of scenes, in pixels of the scene, to be what is known of them."""
        self.mean, self.basis, self.residual = (
            each.to(self.mean) for each in (statistics.mean, statistics.basis, statistics.residual)
        )
        self._known = None

    def forward(self, measurements: Tensor) -> Tensor:
        """(batch, ``outputs``) from measurements (batch, embedding pixels)."""
        return classifier_inputs(self._decoder(), measurements)

    def sharpen(self) -> float:
        """Learn the mask whose measurements leave least of the scenes unknown, without labels.

        What falls is the expected error of the estimate, a function of mask and statistics alone:
        no image is shown, so it takes seconds.

        Returns:
            The share of the estimate's variance that is left unknown, in [0, 1].

        Raises:
            TrainingError: an encoder that learns no mask.
        """
        (encoder,) = self._encoder
        if not isinstance(encoder, LearnedMask):
            raise TrainingError(
                "only a mask that is learned can be sharpened: leave out mask_start"
            )
        with torch.no_grad():
            encoder.weights.pow_(SPARSE)
        encoder.project()
        optimiser = torch.optim.Adam([encoder.weights], SHARPENING_RATE)
        for step in range(SHARPENING_STEPS):
            falling = (1 + math.cos(math.pi * step / SHARPENING_STEPS)) / 2
            optimiser.param_groups[0]["lr"] = SHARPENING_RATE * falling
            loss = self._unknown(encoder)
            optimiser.zero_grad()
            loss.backward()  # type: ignore[no-untyped-call]
            optimiser.step()
            encoder.project()
        encoder.zero_grad()
        with torch.no_grad():
            return self._unknown(encoder).item()

    def _unknown(self, encoder: LinearEncoder) -> Tensor:
        variance = self._pooled(self.basis.T).square().sum() + self._shown_residual.sum()
        return self._prepare(encoder).deviation.square().sum() / variance

    @torch.no_grad()
    def as_linear(self) -> nn.Linear:
        """Return the same as a fully connected layer, for the mask as it is now."""
        decoder = self._decoder()
        matrix = decoder.basis @ decoder.estimator
        layer = nn.Linear(matrix.shape[1], self.outputs, device=matrix.device)
        layer.weight.copy_(torch.cat([matrix, torch.zeros_like(matrix)]))
        offset = decoder.mean - matrix @ decoder.mean_measurement
        layer.bias.copy_(torch.cat([offset, decoder.deviation.flatten()]))
        return layer

    def _decoder(self) -> Decoder[Tensor]:
        """Return the decoder of the camera as it is now; made once for a constant camera."""
        (encoder,) = self._encoder
        if not encoder.constant:
            return self._prepare(encoder)
        if self._known is None or self._known.mean.device != self.mean.device:
            self._known = self._prepare(encoder)
        return self._known

    def _prepare(self, encoder: LinearEncoder) -> Decoder[Tensor]:
        whole = SceneStatistics(self.mean, self.basis, self.residual)
        shown = SceneStatistics(
            self._pooled(self.mean),
            self._pooled(self.basis.T).T,
            self._shown_residual,
        )
        return prepare_decoder(
            encoder.transfer(),
            whole,
            self._noise,
            scene=self.scene,
            embedding=encoder.setup.embedding,
            wanted=shown,
        )

    @property
    def _shown_residual(self) -> Tensor:
        """Return the residual: the basis leaves each pixel independent of its neighbours."""
        return self._pooled(self.residual) / self._pooling**2

    def _pooled(self, values: Tensor) -> Tensor:
        """Means over the scene's pixels, the last axis, within each pixel of the estimate."""
        (rows, columns), side = self.scene.shape, self._pooling
        parts = values.reshape(*values.shape[:-1], rows, side, columns, side)
        means: Tensor = parts.mean((-3, -1)).flatten(-2)
        return means
