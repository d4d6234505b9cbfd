"""Forms in which an embedding may leave the device, and the way back for whoever has the key.

Embeddings of one mask resemble each other: their mean gives the mask away as a label, without any
key. And all masks pass light at the same places, so a coarse shadow of the scene shows behind any
of them. ``flat`` takes the mask's mean response and the exposure out, and hides nothing else.
``white`` takes out mean and covariance and then turns the rest by a rotation that only the mask's
holder knows; the length of a measurement stays, is nearly the same behind every mask, and tells
much of the scene. ``raw`` is the measurement itself. What each form gives away is in
docs/fresh-masks.md.
"""

from enum import Enum

import numpy as np
import numpy.typing as npt
import torch
from scipy.special import ndtri
from torch import Tensor

from veilcam_optics.decoding import Decoder, SceneFrame
from veilcam_optics.errors import OpticsError
from veilcam_optics.keys.epoch_names import EpochNames
from veilcam_optics.keys.masks import KeyStream, Secret, derived_key, epoch_levels

CONTEXT = b"veilcam release rotation, version 1"


class ReleaseForm(Enum):
    """How much of an embedding is released."""

    NONE = "none"
    """Nothing."""
    FLAT = "flat"
    """Scaled to the exposure that the mean scene gives, and without the mean response."""
    WHITE = "white"
    """Decorrelated to mean 0 and variance 1 under the scene statistics, and turned in secret."""
    RAW = "raw"
    """As it was read."""


class Whitening:
    """Mean, covariance and rotation of one mask's measurements, made once; as secret as the mask.

    The covariance of measurements is ``C = A S A^T + N = L L^T``. White measurements are
    ``Q L^-1 (v - A mu)``, whose covariance is I. The rotation Q is drawn uniformly (QR factors of a
    Gaussian matrix, Stewart 1980) from a key stream under a key made from the mask's levels.
    Without it, white measurements would still be in the order of the sensor's pixels, and another
    mask's whitening would bring back a coarse picture. C has eigenvalues as far apart as signal
    and noise, so it is scaled by N and factored in float64.

    Args:
        decoder: of the mask.
        levels: of the mask, uint8: what the rotation is made from.
    """

    def __init__(self, decoder: Decoder, levels: npt.NDArray[np.uint8]) -> None:
        deviation = decoder.noise.double().sqrt()
        scaled = decoder.response.double() / deviation[:, None]
        covariance = scaled @ scaled.T
        covariance.diagonal().add_(1.0)
        self._factor = torch.linalg.cholesky(covariance)
        self._rotation = _rotation(levels, len(deviation))
        self._mean, self._deviation = decoder.mean_measurement.double(), deviation
        self._decoder = decoder

    def __repr__(self) -> str:
        return f"Whitening(embedding={self._decoder.embedding})"

    def whiten(self, measurements: Tensor) -> Tensor:
        """(batch, E) float32 of mean 0 and covariance I under the scene statistics."""
        flat = self._decoder.flatten(measurements).double()
        scaled = ((flat - self._mean) / self._deviation).T
        white: Tensor = torch.linalg.solve_triangular(self._factor, scaled, upper=False)
        return (self._rotation @ white).T.float()

    def restore(self, white: Tensor) -> Tensor:
        """The measurements again, (batch, E)."""
        flat = self._decoder.flatten(white).double() @ self._rotation
        measurements = flat @ self._factor.T * self._deviation + self._mean
        restored: Tensor = measurements.to(self._decoder.mean_measurement.dtype)
        return restored


def _rotation(levels: npt.NDArray[np.uint8], size: int) -> Tensor:
    """Orthogonal (size, size), float64, uniform over all of them under the mask's key."""
    stream = KeyStream(derived_key(np.ascontiguousarray(levels).tobytes(), CONTEXT))
    words = stream.read(8 * size * size).view("<u8") >> np.uint64(11)
    normal = ndtri((words + 0.5) * 2.0**-53).reshape(size, size)
    orthogonal, triangular = torch.linalg.qr(torch.from_numpy(normal))
    turned: Tensor = orthogonal * triangular.diagonal().sign()
    return turned


def release(
    measurements: Tensor, form: ReleaseForm, decoder: Decoder, whitening: Whitening | None = None
) -> Tensor | None:
    """Bring measurements into the form in which they may leave.

    Args:
        measurements: (batch, rows, columns) of the embedding, or (batch, E).
        form: how much to release.
        decoder: of the mask that was shown.
        whitening: of that mask; ``WHITE`` needs it.

    Returns:
        (batch, rows, columns), or None for ``NONE``.

    Raises:
        OpticsError: measurements of another shape, ``WHITE`` without a whitening, or ``FLAT`` of a
            measurement without light.
    """
    flat = decoder.flatten(measurements)
    if form is ReleaseForm.NONE:
        return None
    if form is ReleaseForm.FLAT:
        exposure = flat.sum(1, keepdim=True) / decoder.mean_measurement.sum()
        if not bool((exposure > 0).all()):
            raise OpticsError("a measurement holds no light: it has no exposure to remove")
        flat = flat / exposure - decoder.mean_measurement
    elif form is ReleaseForm.WHITE:
        flat = _needed(whitening).whiten(flat)
    return flat.reshape(-1, *decoder.embedding.shape)


def recover(
    released: Tensor, form: ReleaseForm, decoder: Decoder, whitening: Whitening | None = None
) -> Tensor:
    """Measurements from a released form; :func:`release` of the same mask undone.

    ``RAW`` and ``WHITE`` come back up to rounding. ``FLAT`` comes back at the exposure of the mean
    scene: the exposure itself was left out on purpose. With another mask's decoder something else
    comes back than the measurement, and nothing says so.

    Args:
        released: (batch, rows, columns) of the embedding, or (batch, E).
        form: that they are in.
        decoder: of the mask that was shown.
        whitening: of that mask; ``WHITE`` needs it.

    Returns:
        (batch, rows, columns).

    Raises:
        OpticsError: another shape, ``WHITE`` without a whitening, or ``NONE``, which holds nothing.
    """
    if form is ReleaseForm.NONE:
        raise OpticsError("form = none holds nothing to recover: use flat, white or raw")
    flat = decoder.flatten(released)
    if form is ReleaseForm.FLAT:
        flat = flat + decoder.mean_measurement
    elif form is ReleaseForm.WHITE:
        flat = _needed(whitening).restore(flat)
    return flat.reshape(-1, *decoder.embedding.shape)


def _needed(whitening: Whitening | None) -> Whitening:
    if whitening is None:
        raise OpticsError(
            "form = white needs the mask's whitening: make Whitening(decoder, levels)"
        )
    return whitening


def decode_released(
    released: Tensor,
    form: ReleaseForm,
    frame: SceneFrame,
    *,
    secret: Secret,
    device: str,
    epoch: int | str,
    gain: float | Tensor = 1.0,
) -> Tensor:
    """Scenes from released embeddings, away from the device, for whoever shares its secret.

    Args:
        released: (batch, rows, columns) of the embedding, all of one epoch.
        form: that they were released in; ``FLAT`` decodes at the exposure of the mean scene.
        frame: what is public about camera and scenes.
        secret: of the device. Another one gives something else, and nothing says so.
        device: its name in the key schedule.
        epoch: in which the embeddings were read: its number, or the name that came with them.
        gain: measurement per unit of irradiance.

    Returns:
        (batch, rows, columns) of the scene.

    Raises:
        OpticsError: embeddings of another shape, a form that holds nothing, or no epoch's name.
    """
    number = EpochNames(secret, device).counter(epoch) if isinstance(epoch, str) else epoch
    levels = epoch_levels(
        secret, device, number, camera=frame.camera, distribution=frame.distribution
    )
    decoder = frame.decoding().prepare(frame.shown(levels), gain=gain)
    whitening = Whitening(decoder, levels) if form is ReleaseForm.WHITE else None
    return decoder(recover(released, form, decoder, whitening))
