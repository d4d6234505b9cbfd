"""Machine that has candidates: it recognises a scene from one measurement, the mask unknown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_training.hiding.pinholes import Kernel, pinhole_kernels
from veilcam_training.hiding.scenes import smoother

Values = npt.NDArray[Any]

_POWERS = ((1 / 3, 4 / 45), (0.1, 0.06), (0.03, 0.02))
"""Means and variances of the power that weights let through: uniform ones, sparse, holes."""
_ERROR = 0.02
"""Relative error of a measurement: noise, and light that interferes."""
FINEST = Embedding(12, 16)
"""Embedding that evidence is computed at; a finer one is averaged to it."""
_SMOOTH = 3 / 24
"""Standard deviation of the mean that the spectrum's high-pass subtracts, in sensor heights."""
_APART = 4
"""Rows and columns between the pinholes whose spectra are averaged."""


def power_spectra(measurements: Values, embedding: Embedding) -> Values:
    """Return log power spectra, each less its mean and of unit norm, float32 (count, numbers).

    Args:
        measurements: (count, channels * pixels).
        embedding: shape of the embedding.
    """
    power = _power(measurements.reshape(-1, embedding.size), embedding)
    return _logarithms(power).reshape(len(measurements), -1)


def averaging(size: int, parts: int) -> Values:
    """Return the matrix that averages an axis of pixels over equal boxes, (parts, size)."""
    edges, places = np.arange(parts + 1) * (size / parts), np.arange(size)
    inside = np.minimum(edges[1:, None], places + 1) - np.maximum(edges[:-1, None], places)
    matrix: Values = (np.clip(inside, 0, None) * (parts / size)).astype(np.float32)
    return matrix


def recognised(
    camera: Camera,
    scene: Scene,
    embedding: Embedding,
    candidates: Values,
    measurements: Sequence[Values],
) -> list[float]:
    """Return the share of scenes that are picked out of all candidates, for each mask.

    It is the better of two attackers: power spectra that are alike, and the evidence for a scene
    behind a mask of independent weights.

    Args:
        camera: geometry.
        scene: before it.
        embedding: shape of the embedding.
        candidates: (count, channels, rows, columns) in [0, 1].
        measurements: measurements of the candidates behind each mask, (count, channels * pixels).
    """
    channels = candidates.shape[1]
    kernels = list(pinhole_kernels(camera, scene, embedding, channels))
    apart = np.stack(measurements).reshape(-1, channels, embedding.size)
    spectra, evidence = [], []
    for channel in range(channels):
        own = [kernel for kernel in kernels if kernel[0] == channel]
        scenes, values = candidates[:, channel], apart[:, channel]
        spectra.append(_by_spectrum(own, scenes, values, embedding))
        evidence.append(_by_evidence(own, scenes, values, embedding))
    shape = (len(measurements), len(candidates), len(candidates))
    right = [
        (np.sum(scores, axis=0).reshape(shape).argmax(2) == np.arange(shape[1])).mean(1)
        for scores in (spectra, evidence)
    ]
    found: list[float] = np.maximum(*right).tolist()
    return found


def _by_spectrum(
    kernels: Sequence[Kernel], scenes: Values, values: Values, embedding: Embedding
) -> Values:
    """Correlations of log power spectra, (measurements, scenes)."""
    powers = []
    for scene in scenes:
        shown = [_pictures(y[::_APART], x[::_APART], scene) for _, y, x in kernels]
        powers.append(_power(np.concatenate(shown), embedding).mean(0))
    scores: Values = _logarithms(_power(values, embedding)) @ _logarithms(np.array(powers)).T
    return scores


def _by_evidence(
    kernels: Sequence[Kernel], scenes: Values, values: Values, embedding: Embedding
) -> Values:
    """Log likelihoods under a Gaussian of independent sub-pixel powers, (measurements, scenes)."""
    down, across = (
        averaging(size, min(size, finest))
        for size, finest in zip(embedding.shape, FINEST.shape, strict=True)
    )
    coarse = (down @ values.reshape(-1, *embedding.shape) @ across.T).reshape(len(values), -1)
    coarse = coarse.astype(np.float64)
    scores = []
    for scene in scenes:
        shown = np.concatenate([_pictures(y @ down.T, x @ across.T, scene) for _, y, x in kernels])
        gram = torch.from_numpy(shown.T @ shown).double()
        powers, modes = torch.linalg.eigh(gram)
        likelihoods = _log_likelihoods(
            coarse @ modes.numpy(), shown.sum(0) @ modes.numpy(), powers.clamp_min(0).numpy()
        )
        scores.append(likelihoods.max(1))
    return np.stack(scores, axis=1)


def _log_likelihoods(values: Values, total: Values, powers: Values) -> Values:
    """Log likelihoods under Gaussians of all weights and noise, (measurements, kinds of weights).

    Args:
        values: measurements in the modes of the pictures' Gram matrix, (count, modes).
        total: sum of the pictures in them.
        powers: eigenvalues of the modes.
    """
    means, variances = np.array(_POWERS).T[:, :, None]
    spread = variances * powers
    noise = _ERROR**2 * (np.square(means * total) + spread).mean(1, keepdims=True)
    spread += noise
    # |values - mean|^2 in units of the spread, without an array for each kind.
    off = np.square(values) @ (1 / spread).T - 2 * values @ (means * total / spread).T
    off += (np.square(means * total) / spread).sum(1)
    found: Values = -(off + np.log(spread).sum(1)) / 2
    return found


def _pictures(y: Values, x: Values, scene: Values) -> Values:
    """Pictures that the sub-pixels of rows ``y`` and columns ``x`` show, (places, pixels)."""
    shown = (y.transpose(0, 2, 1) @ scene)[:, None] @ x
    return shown.reshape(len(y) * len(x), -1)


def _power(values: Values, embedding: Embedding) -> Values:
    """Power spectra of high-passed measurements (count, pixels) that fade to their edges."""
    images = values.reshape(-1, *embedding.shape)
    sigma = _SMOOTH * embedding.rows
    down, across = (smoother(size, sigma) for size in embedding.shape)
    rows, columns = (np.hanning(size + 2)[1:-1] for size in embedding.shape)
    images = (images - down @ images @ across.T) * np.outer(rows, columns)
    power: Values = np.square(np.abs(np.fft.rfft2(images))).reshape(len(images), -1)
    return power


def _logarithms(power: Values) -> Values:
    """Logarithms of the shares of power, less their mean and of unit norm, float32."""
    shares = power / np.maximum(power.sum(1, keepdims=True), 1e-30)
    values = np.log(shares + 1e-5 / power.shape[1])
    values -= values.mean(1, keepdims=True)
    values /= np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-12)
    found: Values = values.astype(np.float32)
    return found
