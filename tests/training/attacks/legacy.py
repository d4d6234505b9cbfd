"""Forms in which embeddings once left, kept so that attacks have something to win against."""

from __future__ import annotations

from torch import Tensor

from veilcam_optics.arrays import Array, as_type, namespace, solve_triangular
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


def white_lengths(decoder: Decoder[Array], measurements: Array) -> Array:
    """Lengths of white measurements, (count,) float64: a rotation changes none."""
    xp = namespace(measurements)
    deviation = xp.sqrt(as_type(decoder.noise, "float64"))
    scaled = as_type(decoder.response, "float64") / deviation[:, None]
    factor = xp.linalg.cholesky(scaled @ scaled.T + xp.eye(scaled.shape[0], dtype=xp.float64))
    expected = as_type(decoder.mean_measurement, "float64")
    flat = xp.reshape(as_type(measurements, "float64"), (measurements.shape[0], -1))
    white = solve_triangular(factor, ((flat - expected) / deviation).T)
    lengths: Array = xp.linalg.vector_norm(white, axis=0)
    return lengths


def _decoder(mask: VictimMask) -> Decoder:
    assert mask.decoder is not None, "a victim of an old form knows scene statistics"
    return mask.decoder
