"""Forms in which embeddings leave a camera in the clear: as they were read, or whitened.

Embeddings of one mask resemble each other: their mean gives the mask away as a label, without any
key. And all masks pass light at the same places, so a coarse shadow of the scene shows behind any
of them. ``white`` takes out mean, covariance and length, and turns what is left by a rotation that
only the key of the mask gives. The rotation holds for one measurement: of two behind one mask, the
angle between them shows. ``raw`` is the measurement itself.
"""

from __future__ import annotations

import os
from enum import Enum
from typing import Generic

import numpy as np

from veilcam_optics.arrays import (
    Array,
    as_type,
    cholesky,
    device,
    namespace,
    overwrite,
    solve_triangular,
)
from veilcam_optics.decoding.decoder import Decoder
from veilcam_optics.decoding.normal import Values, normal
from veilcam_optics.errors import OpticsError
from veilcam_optics.keys.masks import KeyStream


class ReleaseForm(Enum):
    """Form of an embedding that is released in the clear."""

    WHITE = "white"
    """A direction alone: decorrelated, turned in secret and of length 1."""
    RAW = "raw"
    """As it was read."""


class Whitening(Generic[Array]):
    """Mean, covariance and rotation of one mask's measurements, made once; as secret as the mask.

    The covariance of measurements is ``C = A S A^T + N = L L^T``. White measurements are the
    direction of ``Q L^-1 (v - A mu)``. The rotation Q is drawn uniformly (QR factors of a Gaussian
    matrix, Stewart 1980) from a key stream of its own, so that whoever finds the mask has no
    rotation yet. With it drawn once and used once, the direction is uniform over the sphere
    whatever was seen. C has eigenvalues as far apart as signal and noise, so it is scaled by N and
    factored in float64.

    Args:
        decoder: decoder of the mask.
        key: key of the rotation, 32 bytes, used for nothing else and never again.

    Raises:
        OpticsError: a key of another length, or a decoder that is not finite.
    """

    def __init__(self, decoder: Decoder[Array], key: bytes | bytearray) -> None:
        xp, place = namespace(decoder.noise), device(decoder.noise)
        deviation = xp.sqrt(as_type(decoder.noise, "float64"))
        size = deviation.shape[0]
        scaled = as_type(decoder.response, "float64") / deviation[:, None]
        covariance = scaled @ scaled.T + xp.eye(size, dtype=xp.float64, device=place)
        factor = cholesky(covariance)
        overwrite(scaled, covariance)
        if factor is None:
            raise OpticsError("the decoder cannot be whitened with: it holds NaN or infinity")
        self._factor, self._deviation = factor, deviation
        self._decoder: Decoder[Array] = decoder
        self._rotation = xp.asarray(_rotation(key, size), device=place)
        # A copy, also where the decoder is of this type: each overwrites what is its own.
        self._mean = xp.astype(decoder.mean_measurement, xp.float64, copy=True)

    def __repr__(self) -> str:
        return f"Whitening(embedding={self._decoder.embedding})"

    def whiten(self, measurements: Array) -> Array:
        """Directions, (batch, E) float32 of length 1 within rounding.

        A measurement that has no direction, because it is the mean itself or not finite, gives one
        that the kernel draws, uniform as all others are: nothing tells it from them.

        Args:
            measurements: (batch, rows, columns) of the embedding, or (batch, E).

        Raises:
            OpticsError: measurements of another shape.
        """
        xp = namespace(measurements)
        flat = as_type(self._decoder.flatten(measurements), "float64")
        with np.errstate(invalid="ignore"):  # of what is not finite; torch says nothing
            scaled = ((flat - self._mean) / self._deviation).T
            white = (self._rotation @ solve_triangular(self._factor, scaled)).T
        length = xp.linalg.vector_norm(white, axis=1, keepdims=True)
        found = (length > 0) & xp.isfinite(length)
        if not bool(xp.all(found)):
            drawn = normal(np.frombuffer(os.urandom(8 * found.shape[0] * white.shape[1]), np.uint8))
            others = xp.asarray(drawn.reshape(white.shape), device=device(white))
            white = xp.where(found, white, others)
            length = xp.linalg.vector_norm(white, axis=1, keepdims=True)
        directions: Array = white / length
        return as_type(directions, "float32")

    def restore(self, directions: Array) -> Array:
        """Measurements that give these directions, with the length that is expected of one.

        What whoever has mask and key makes of a white embedding: all but its length comes back,
        and that is nearly the same for all scenes.

        Args:
            directions: (batch, E).

        Returns:
            (batch, E) float32.
        """
        white = as_type(directions, "float64") * self._mean.shape[0] ** 0.5
        scaled = (white @ self._rotation) @ self._factor.T
        restored: Array = self._mean + scaled * self._deviation
        return as_type(restored, "float32")

    def erase(self) -> None:
        """Overwrite all that is the mask's, as well as Python lets us; the decoder stays."""
        overwrite(self._factor, self._rotation, self._mean, self._deviation)


def _rotation(key: bytes | bytearray, size: int) -> Values:
    """Orthogonal (size, size), uniform over all of them under the key; the same wherever it is."""
    drawn = normal(KeyStream(key).read(8 * size * size)).reshape(size, size)
    orthogonal: Values
    orthogonal, triangular = np.linalg.qr(drawn)
    orthogonal *= np.sign(triangular.diagonal())
    overwrite(drawn, triangular)
    return orthogonal
