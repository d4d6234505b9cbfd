"""Forms in which embeddings leave a camera in the clear: as they were read, or whitened.

Embeddings of one mask resemble each other: their mean gives the mask away as a label, without any
key. And all masks pass light at the same places, so a coarse shadow of the scene shows behind any
of them. ``white`` takes out mean, covariance and length, and turns what is left by a rotation that
only the key of the mask gives. The rotation holds for one measurement: of two behind one mask, the
angle between them shows. ``raw`` is the measurement itself.
"""

import os
from enum import Enum

import numpy as np
import numpy.typing as npt
import torch
from scipy.special import ndtri
from torch import Tensor

from veilcam_optics.decoding.decoder import Decoder, overwrite
from veilcam_optics.keys.masks import KeyStream


class ReleaseForm(Enum):
    """How much of an embedding is released in the clear."""

    WHITE = "white"
    """A direction alone: decorrelated, turned in secret and of length 1."""
    RAW = "raw"
    """As it was read."""


class Whitening:
    """Mean, covariance and rotation of one mask's measurements, made once; as secret as the mask.

    The covariance of measurements is ``C = A S A^T + N = L L^T``. White measurements are the
    direction of ``Q L^-1 (v - A mu)``. The rotation Q is drawn uniformly (QR factors of a Gaussian
    matrix, Stewart 1980) from a key stream of its own, so that whoever finds the mask has no
    rotation yet. With it drawn once and used once, the direction is uniform over the sphere
    whatever was seen. C has eigenvalues as far apart as signal and noise, so it is scaled by N and
    factored in float64.

    Args:
        decoder: of the mask.
        key: of the rotation, 32 bytes, used for nothing else and never again.

    Raises:
        OpticsError: a key of another length.
    """

    def __init__(self, decoder: Decoder, key: bytes | bytearray) -> None:
        deviation = decoder.noise.double().sqrt()
        scaled = decoder.response.double() / deviation[:, None]
        covariance = scaled @ scaled.T
        covariance.diagonal().add_(1.0)
        self._factor = torch.linalg.cholesky(covariance)
        self._rotation = _rotation(key, len(deviation)).to(deviation.device)
        # A copy, also where the decoder is of this type: each overwrites what is its own.
        self._mean = decoder.mean_measurement.to(torch.float64, copy=True)
        self._deviation, self._decoder = deviation, decoder
        overwrite(scaled, covariance)

    def __repr__(self) -> str:
        return f"Whitening(embedding={self._decoder.embedding})"

    def whiten(self, measurements: Tensor) -> Tensor:
        """Directions, (batch, E) float32 of length 1 within rounding.

        A measurement that has no direction, because it is the mean itself or not finite, gives one
        that the kernel draws, uniform as all others are: nothing tells it from them.

        Args:
            measurements: (batch, rows, columns) of the embedding, or (batch, E).

        Raises:
            OpticsError: measurements of another shape.
        """
        flat = self._decoder.flatten(measurements).double()
        scaled = ((flat - self._mean) / self._deviation).T
        solved = torch.linalg.solve_triangular(self._factor, scaled, upper=False)
        white = (self._rotation @ solved).T
        length = torch.linalg.vector_norm(white, dim=1, keepdim=True)
        found = (length > 0) & length.isfinite()
        if not bool(found.all()):
            drawn = _normal(np.frombuffer(os.urandom(8 * white.numel()), np.uint8))
            white = torch.where(found, white, drawn.reshape(white.shape).to(white.device))
            length = torch.linalg.vector_norm(white, dim=1, keepdim=True)
        directions: Tensor = (white / length).float()
        return directions

    def restore(self, directions: Tensor) -> Tensor:
        """Measurements that give these directions, with the length that is expected of one.

        What whoever has mask and key makes of a white embedding: all but its length comes back,
        and that is nearly the same for all scenes.

        Args:
            directions: (batch, E).

        Returns:
            (batch, E) float32.
        """
        white = directions.double() * len(self._mean) ** 0.5
        scaled = (white @ self._rotation) @ self._factor.T
        restored: Tensor = (self._mean + scaled * self._deviation).float()
        return restored

    def erase(self) -> None:
        """Overwrite all that is the mask's, as well as Python lets us; the decoder stays."""
        overwrite(self._factor, self._rotation, self._mean, self._deviation)


def _rotation(key: bytes | bytearray, size: int) -> Tensor:
    """Orthogonal (size, size), float64, uniform over all of them under the key."""
    normal = _normal(KeyStream(key).read(8 * size * size)).reshape(size, size)
    orthogonal: Tensor
    orthogonal, triangular = torch.linalg.qr(normal)
    orthogonal *= triangular.diagonal().sign()
    overwrite(normal, triangular)
    return orthogonal


def _normal(drawn: npt.NDArray[np.uint8]) -> Tensor:
    """Normal numbers, float64, one from every 8 uniform bytes."""
    words = drawn.view("<u8") >> np.uint64(11)
    normal: npt.NDArray[np.float64] = ndtri((words + 0.5) * 2.0**-53)
    return torch.from_numpy(normal)
