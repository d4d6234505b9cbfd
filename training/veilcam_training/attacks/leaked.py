"""With the key, or with a list of masks one of which it must be: what optics alone still hide."""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn.functional import mse_loss

from veilcam_optics.decoding import MeasurementNoise, SceneDecoding
from veilcam_training.attacks.networks import TRIALS, Progress, Trial
from veilcam_training.bundle import classifier_inputs
from veilcam_training.errors import require
from veilcam_training.seeding import seeded

DOUBTS = (0.0, 0.003, 0.01, 0.03, 0.1)
"""Relative errors of a transfer matrix to choose from."""
_BATCH = 128


@dataclass(frozen=True)
class KnownCaptures:
    """Captures behind one mask, whose scenes are known to the attacker."""

    weights: Tensor
    """The mask as the attacker has it, ``camera.mask_shape``."""
    measurements: Tensor
    """(count, E)."""
    scenes: Tensor
    """(count, rows, columns)."""


def estimates(decoding: SceneDecoding, weights: Tensor, measurements: Tensor) -> Tensor:
    """Linear minimum-mean-square-error estimates of scenes, (count, rows, columns)."""
    with torch.no_grad():
        return decoding.prepare(weights)(measurements)


def read_behind(decoding: SceneDecoding, weights: Tensor, measurements: Tensor) -> Tensor:
    """Return the input of a network that reads decoded scenes, with ``weights`` as the mask.

    Args:
        decoding: public; its noise says how far weights and decoder are to be trusted.
        weights: leaked, or found.
        measurements: (count, E).

    Returns:
        (count, 2 x scene pixels): estimates, and their deviations.
    """
    with torch.no_grad():
        return classifier_inputs(decoding.prepare(weights), measurements).float()


def doubting(decoding: SceneDecoding, model_error: float) -> SceneDecoding:
    """Decode in the same way, with the transfer matrix known up to a relative error."""
    return SceneDecoding(
        decoding.operator,
        decoding.statistics,
        MeasurementNoise(decoding.noise.snr_db, model_error),
        precision=decoding.precision,
    )


def tuned(decoding: SceneDecoding, tune: Sequence[KnownCaptures]) -> SceneDecoding:
    """Choose the doubt in the transfer matrix that has the least error on captures set apart."""

    def error(doubt: float) -> float:
        candidate = doubting(decoding, doubt)
        return sum(
            float(mse_loss(estimates(candidate, each.weights, each.measurements), each.scenes))
            for each in tune
        )

    require(len(tune) > 0, "nothing to tune on: set some captures apart")
    return doubting(decoding, min(DOUBTS, key=error))


def log_likelihoods(measurements: Tensor, mean: Tensor, response: Tensor, noise: Tensor) -> Tensor:
    """Return the likelihood of measurements with covariance ``response response^T + diag(noise)``.

    Args:
        measurements: (count, E).
        mean: (E,).
        response: (E, rank).
        noise: (E,), positive.

    Returns:
        float64 (count,), up to a constant that all masks share; differentiable.
    """
    root = noise.rsqrt()
    scaled, errors = response * root[:, None], (measurements - mean) * root
    gram = (scaled.T @ scaled).double()
    factor = torch.linalg.cholesky(gram + torch.eye(len(gram), dtype=gram.dtype))
    known = torch.linalg.solve_triangular(factor, (errors @ scaled).T.double(), upper=False)
    # By Woodbury's identity, and the determinant lemma that goes with it.
    squares = errors.square().sum(1).double() - known.square().sum(0)
    size = 2 * factor.diagonal().log().sum() + noise.double().log().sum()
    found: Tensor = -(squares + size) / 2
    return found


def mask_likelihoods(
    decoding: SceneDecoding, masks: Sequence[Tensor], measurements: Tensor
) -> Tensor:
    """Return the log-likelihood of each capture behind each mask of a leaked list.

    Args:
        decoding: public.
        masks: the list, each ``camera.mask_shape``.
        measurements: (count, E).

    Returns:
        float64 (count, masks), up to a constant of each capture. Captures of one epoch share a
        mask: their rows may be added.
    """
    found = []
    with torch.no_grad():
        for weights in masks:
            decoder = decoding.prepare(weights)
            found.append(
                log_likelihoods(
                    measurements, decoder.mean_measurement, decoder.response, decoder.noise
                )
            )
    return torch.stack(found, dim=1)


def identify(decoding: SceneDecoding, masks: Sequence[Tensor], measurements: Tensor) -> Tensor:
    """Return the mask of the list behind each capture, int64 (count,); arguments as above."""
    return mask_likelihoods(decoding, masks, measurements).argmax(1)


def read_by_list(decoding: SceneDecoding, masks: Sequence[Tensor], measurements: Tensor) -> Tensor:
    """Identify the mask of each capture, then decode: (count, 2 x scene pixels).

    Estimates and their deviations, as a network that reads decoded scenes wants them.
    """
    behind = identify(decoding, masks, measurements)
    read = measurements.new_zeros(len(measurements), 2 * decoding.statistics.pixels)
    for place in sorted(set(behind.tolist())):
        chosen = behind == place
        read[chosen] = read_behind(decoding, masks[place], measurements[chosen])
    return read


class LearnedDecoder(nn.Module):
    """A network that corrects linear estimates, told how sure each of their pixels is.

    Both are what the transfer matrix of the mask makes of a capture: so the network is conditioned
    on it, and serves masks that it has never seen.

    Args:
        shape: rows and columns of a scene.
        width: channels of a layer.
    """

    def __init__(self, shape: tuple[int, int], width: int = 24) -> None:
        super().__init__()
        last = nn.Conv2d(width, 1, 3, padding=1)
        for parameter in last.parameters():  # it starts at the linear estimate
            nn.init.zeros_(parameter)
        self.layers = nn.Sequential(
            nn.Unflatten(1, (2, *shape)),
            *(nn.Conv2d(2, width, 5, padding=2), nn.GELU()),
            *(nn.Conv2d(width, width, 3, padding=2, dilation=2), nn.GELU()),
            *(nn.Conv2d(width, width, 3, padding=2, dilation=2), nn.GELU()),
            last,
        )
        self.shape = shape

    def forward(self, read: Tensor) -> Tensor:
        """Scenes (count, rows, columns) from estimates and deviations (count, 2 x pixels)."""
        linear = read[:, : read.shape[1] // 2].reshape(-1, *self.shape)
        corrected: Tensor = linear + self.layers(read)[:, 0]
        return corrected


@dataclass(frozen=True)
class DecodedFrames:
    """Decoded captures, (count, 2 x pixels), and their scenes, (count, rows, columns)."""

    read: Tensor
    scenes: Tensor

    @classmethod
    def of(cls, decoding: SceneDecoding, seen: Sequence[KnownCaptures]) -> "DecodedFrames":
        """Decode captures of many masks."""
        read = [read_behind(decoding, each.weights, each.measurements) for each in seen]
        return cls(torch.cat(read), torch.cat([each.scenes for each in seen]))


def fit_decoder(
    learned: DecodedFrames,
    check: DecodedFrames,
    *,
    trials: Sequence[Trial] = TRIALS,
    epochs: int = 8,
    progress: Progress | None = None,
) -> LearnedDecoder:
    """Fit decoders by Adam; the one, and the epoch, with the least error on ``check`` counts.

    Args:
        learned: captures behind masks of the attacker's own.
        check: the same, of other masks and scenes.
        trials: seeds and settings.
        epochs: number of epochs of each trial.
        progress: called with epochs done and to do.
    """
    shape = (learned.scenes.shape[1], learned.scenes.shape[2])
    found: list[tuple[float, LearnedDecoder]] = []
    for number, trial in enumerate(trials):
        with seeded(trial.seed, "decoder"):
            decoder = LearnedDecoder(shape)
            optimiser = torch.optim.AdamW(
                decoder.parameters(), trial.rate, weight_decay=trial.decay
            )
            best, kept = decoder_error(decoder, check), decoder.state_dict()
            kept = {name: value.clone() for name, value in kept.items()}
            for epoch in range(epochs):
                for part in torch.split(torch.randperm(len(learned.read)), _BATCH):
                    optimiser.zero_grad()
                    loss = mse_loss(decoder(learned.read[part]), learned.scenes[part])
                    loss.backward()  # type: ignore[no-untyped-call]
                    optimiser.step()
                error = decoder_error(decoder, check)
                if error < best:
                    best, kept = error, deepcopy(decoder.state_dict())
                if progress is not None:
                    progress(number * epochs + epoch + 1, len(trials) * epochs)
        decoder.load_state_dict(kept)
        found.append((best, decoder.eval()))
    return min(found, key=lambda each: each[0])[1]


def decoder_error(decoder: LearnedDecoder, frames: DecodedFrames) -> float:
    """Mean squared error of a decoder."""
    with torch.no_grad():
        decoded = torch.cat([decoder(part) for part in torch.split(frames.read, 1024)])
        return float(mse_loss(decoded, frames.scenes))
