"""How much more of a mask is in captures than of masks that are not there.

The numbers in brackets are those of docs/proof.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from veilcam_optics.proof.marks import Mark
from veilcam_optics.proof.traces import Complex, Single, Trace

STRANGERS = 48
"""Masks that are not there, the same ones always: they say what chance scores in a capture."""
PICTURED = 12
"""So many of them say what chance makes of pictures, and what it scores of an open window."""
_SHARED = 0.3
"""Correlation of both scores of a mask that is not there."""
_INEXACT = 0.1
"""Share of a picture's score by which it may be off, as a camera is off its drawing."""
_LEAST = float(np.finfo(np.float32).tiny)


@dataclass(frozen=True)
class Scores:
    """What is in captures.

    Attributes:
        score: of each mask, by spectrum and picture (eq. 8), (masks, captures).
        ahead: by how much the first mask is ahead of each (eq. 9), (masks, captures).
        share: of its mark that the first mask left, (captures,).
        window: score of the open window (eq. 10), (captures,).
        ahead_of_window: by how much the first mask is ahead of it (eq. 11), (captures,).
    """

    score: Single
    ahead: Single
    share: Single
    window: Single
    ahead_of_window: Single


class Strangers:
    """Masks that are not there.

    Args:
        marks: of :data:`STRANGERS` masks.
    """

    def __init__(self, marks: Sequence[Mark]) -> None:
        some = marks[:PICTURED]
        self._weights = _rows([mark.weighed().texture for mark in marks])
        self._squares = np.square(self._weights)
        self._textures = _rows([mark.texture for mark in some])
        self._texture_squares = np.square(self._textures)
        self._phases = np.stack([mark.phases for mark in some])

    def scores(self, trace: Trace, marks: Sequence[Mark], window: Mark) -> Scores:
        """Those of some masks, and of the window without any.

        Args:
            trace: of the captures.
            marks: of the masks, weighed; the named one first.
            window: mark of the open window, as it is: bins and edges fill what is dark of its
                spectrum.
        """
        by_spectrum, ahead, share = self._spectra(trace, marks)
        pictures, ahead_in_pictures = self._pictures(trace, marks, window)
        texture = window.texture.reshape(1, -1)
        raw = _raw(trace, texture, np.square(texture))
        chance = _raw(trace, self._textures, self._texture_squares)
        by_texture, rare = _standardised(raw, chance), as_normal(pictures, PICTURED)
        # How far apart two are that are both there no more by chance, rarity does not tell.
        apart = combined(by_spectrum[0], pictures[1, 0]) - _opened(by_texture[0], pictures[0, -1])
        return Scores(
            combined(as_normal(by_spectrum, STRANGERS), rare[1, :-1]),
            (ahead + ahead_in_pictures) / np.float32(2**0.5),
            share,
            _opened(as_normal(by_texture, PICTURED)[0], rare[0, -1]),
            apart / np.float32(2**0.5),
        )

    def _spectra(self, trace: Trace, marks: Sequence[Mark]) -> tuple[Single, Single, Single]:
        """Scores by spectra (eq. 5), by how much the first is ahead, and the share it left."""
        weights = _rows([mark.texture for mark in marks])
        root: Single = np.sqrt(np.maximum(np.square(weights) @ trace.power.T, np.float32(_LEAST)))
        raw: Single = weights @ trace.power.T / root
        chance = _raw(trace, self._weights, self._squares)
        scores = _standardised(raw, chance)
        alike = (weights[0] * weights) @ trace.power.T / root[0] / root
        apart = np.sqrt(np.maximum(2 - 2 * alike, _LEAST))
        return scores, (scores[0] - scores) / apart, (raw[0] - chance.mean(0)) / root[0]

    def _pictures(self, trace: Trace, marks: Sequence[Mark], window: Mark) -> tuple[Single, Single]:
        """Scores of third and fourth moments (eq. 6), and by how much the first mask is ahead.

        Returns:
            (2, masks and the window, captures), and (masks, captures).
        """
        phases = np.stack([mark.phases for mark in (*marks, window)])
        every = np.concatenate([phases, self._phases])
        moments = np.stack([_moments(picture, every) for picture in trace.picture], 2)
        pictures = _standardised(moments[:, : len(phases)], moments[:, len(phases) :])
        scores = pictures[1, :-1]
        power = np.square(trace.picture.real) + np.square(trace.picture.imag)
        turned = (phases[0] * phases[:-1].conj()).real
        alike = np.einsum("myx,cyx->mc", turned, power) / np.maximum(power.sum((1, 2)), _LEAST)
        # Fourth powers of Gaussian numbers, apart from their squares, are correlated by this.
        alike = np.square(np.square(alike))
        off = _INEXACT * np.maximum(scores, scores[0])
        apart = np.sqrt(np.maximum(2 - 2 * alike, 0) + np.square(off) + _LEAST)
        return pictures, (scores[0] - scores) / apart


def _rows(textures: Sequence[Single]) -> Single:
    return np.stack([texture.ravel() for texture in textures])


def _raw(trace: Trace, weights: Single, squares: Single) -> Single:
    """How well spectra fit (eq. 5), (masks, captures)."""
    root = np.sqrt(np.maximum(squares @ trace.power.T, _LEAST))
    raw: Single = weights @ trace.power.T / root
    return raw


def _moments(picture: Complex, phases: Complex) -> Single:
    """Third and fourth moment of a capture's pictures, (2, masks).

    Args:
        picture: amplitudes of the capture.
        phases: of masks, (masks, *frequencies).
    """
    scenes = np.fft.irfft2(picture * phases).reshape(len(phases), -1)
    squares = np.square(scenes)
    # All of one power, as phases leave it.
    power = max(float(squares[-1].mean()), _LEAST**0.5)
    both: Single = np.stack(
        [
            (squares[:, None] @ each[..., None]).ravel() / (squares.shape[1] * power**order)
            for each, order in ((scenes, 1.5), (squares, 2))
        ]
    )
    return both


def _standardised(values: Single, chance: Single) -> Single:
    """How far values are from the mean of others, in standard deviations of these.

    Args:
        values: (..., masks, captures).
        chance: of the others, (..., strangers, captures).
    """
    several = chance.shape[-2]
    # Sums as products, which are faster where there are so few.
    ones = np.ones((1, several), np.float32)
    mean = ones @ chance / several
    variance = ones @ np.square(chance - mean) / (several - 1)
    scores: Single = (values - mean) / np.sqrt(np.maximum(variance, _LEAST))
    return scores


def as_normal(scores: Single, strangers: int) -> Single:
    """What a normal number would have to be to be as rare as scores are (eq. 7).

    Of few strangers, mean and deviation are known badly: what one more of them scores is
    distributed as Student's t. Wallace's approximation (Annals of Mathematical Statistics 30,
    1959), whose error is below 0.05 up to 6 for 12 strangers.

    Args:
        scores: in standard deviations of the strangers.
        strangers: how many gave their mean and deviation.
    """
    free = strangers - 1
    scale = ((8 * free + 1) / (8 * free + 3)) ** 2 * free
    logarithms = np.log1p(np.square(scores) * np.float32(1 / (free * (1 + 1 / strangers))))
    return np.copysign(np.sqrt(np.float32(scale) * logarithms), scores)


def _opened(by_texture: Single, skew: Single) -> Single:
    """Both scores of an open window together (eq. 10).

    Where something dark is in front of light, skewness is no sign of a window.
    """
    larger: Single = np.maximum(by_texture, (by_texture + skew) / np.float32(2**0.5))
    return larger


def combined(by_spectrum: Single, by_picture: Single) -> Single:
    """Both scores together (eq. 8), as normal numbers; where a picture says nothing, the spectrum.

    Their sum is the most powerful of what adds up if both tell equally well. The larger of sum and
    spectrum is as rare as either, since both are high in the same captures.
    """
    both = (by_spectrum + by_picture) / np.float32((2 + 2 * _SHARED) ** 0.5)
    larger: Single = np.maximum(both, by_spectrum)
    return larger
