"""Forms in which embeddings once left, kept so that attacks have something to win against."""

from __future__ import annotations

import torch
from torch import Tensor

from veilcam_optics.decoding import Decoder
from veilcam_optics.decoding.release import Whitening
from veilcam_training.attacks.mask_recovery import Form
from veilcam_training.attacks.victim import VictimMask


class Flat(Form):
    """As bright as the mean scene would be, and without what the mean scene gives."""

    def scale(self, measurements: Tensor, mean: Tensor) -> Tensor:
        """The mean scene's light over each one's own."""
        return mean.sum() / measurements.sum(1, keepdim=True)

    def offset(self, mean: Tensor) -> Tensor:
        """What the mean scene gives."""
        return mean


FLAT = Flat()


def flat(mask: VictimMask, measurements: Tensor) -> Tensor:
    """``flat``, by the mask's holder."""
    return FLAT.release(measurements, _decoder(mask).mean_measurement)


def white_with_length(mask: VictimMask, measurements: Tensor) -> Tensor:
    """``white`` as it was while it kept the length of what it turns; of variance 1."""
    decoder = _decoder(mask)
    directions = Whitening(decoder, mask.key).whiten(measurements)
    return directions * white_lengths(decoder, measurements)[:, None].float()


def white_lengths(decoder: Decoder, measurements: Tensor) -> Tensor:
    """Lengths of white measurements, (count,) float64: a rotation changes none."""
    deviation = decoder.noise.double().sqrt()
    scaled = decoder.response.double() / deviation[:, None]
    covariance = scaled @ scaled.T
    covariance.diagonal().add_(1.0)
    centred = (measurements.flatten(1).double() - decoder.mean_measurement.double()) / deviation
    factor = torch.linalg.cholesky(covariance)
    white: Tensor = torch.linalg.solve_triangular(factor, centred.T, upper=False)
    lengths: Tensor = torch.linalg.vector_norm(white, dim=0)
    return lengths


def _decoder(mask: VictimMask) -> Decoder:
    assert mask.decoder is not None, "a victim of an old form knows scene statistics"
    return mask.decoder
