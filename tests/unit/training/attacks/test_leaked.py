"""With the key scenes are read, with a list of masks behind any of them; directions never are."""

from __future__ import annotations

import math

import pytest
import torch
from scipy.stats import binom
from tests.unit.training.attacks.optics import (
    hits,
    luck,
    make_decoding,
    make_victim,
    most,
    pictures,
)
from torch import Tensor
from torch.nn.functional import mse_loss

from veilcam_optics.decoding import SceneDecoding
from veilcam_training.attacks.leaked import (
    DOUBTS,
    DecodedFrames,
    KnownCaptures,
    decoder_error,
    doubting,
    estimates,
    fit_decoder,
    identify,
    log_likelihoods,
    mask_likelihoods,
    read_behind,
    read_by_list,
    tuned,
)
from veilcam_training.attacks.networks import TRIALS, Trial
from veilcam_training.attacks.victim import FORMS, StoredMasks, raw
from veilcam_training.errors import TrainingError

COUNT = 400
MASKS = 8


@pytest.fixture(scope="module")
def decoding() -> SceneDecoding:
    """What is public."""
    return make_decoding()


def seen(decoding: SceneDecoding, masks: int, captures: int, seed: int) -> list[KnownCaptures]:
    """Captures of masks of the attacker's own."""
    victim = make_victim(decoding, raw, masks=masks, seed=seed)
    assert isinstance(victim.source, StoredMasks)
    found = []
    for number in range(masks):
        mask = victim.mask()
        scenes = pictures(captures, seed=1000 * seed + number)
        found.append(KnownCaptures(mask.weights, victim.measure(mask, scenes), scenes))
    return found


def test_the_key_reads_and_another_one_does_not(decoding: SceneDecoding) -> None:
    victim = make_victim(decoding, raw, masks=50)
    mask, other = victim.mask(), victim.mask()
    scenes = pictures(COUNT, seed=3)
    measurements = victim.capture(mask, scenes)
    assert mask.place != other.place
    right = read_behind(decoding, mask.weights, measurements)
    assert hits(right, scenes) > most(COUNT)
    linear = estimates(decoding, mask.weights, measurements)
    assert torch.equal(right[:, :64], linear.flatten(1))
    wrong = estimates(decoding, other.weights, measurements)
    mean = decoding.statistics.mean.reshape(1, 8, 8).expand_as(scenes)
    assert float(mse_loss(linear, scenes)) < float(mse_loss(mean, scenes)) / 2
    assert float(mse_loss(wrong, scenes)) > float(mse_loss(mean, scenes))


def test_the_key_of_a_mask_does_not_read_directions(decoding: SceneDecoding) -> None:
    victim = make_victim(decoding, FORMS["white"])
    mask = victim.mask()
    scenes = pictures(COUNT, seed=3)
    read = read_behind(decoding, mask.weights, victim.capture(mask, scenes))
    assert hits(read, scenes) <= luck(COUNT)


def test_doubt_is_chosen_on_captures_set_apart(decoding: SceneDecoding) -> None:
    exact = seen(decoding, masks=3, captures=50, seed=7)
    assert tuned(decoding, exact).noise.model_error <= 0.003
    generator = torch.Generator().manual_seed(0)

    def blurred(weights: Tensor) -> Tensor:
        return (weights + 0.2 * torch.randn(weights.shape, generator=generator)).clamp(0, 1)

    doubtful = [
        KnownCaptures(blurred(each.weights), each.measurements, each.scenes) for each in exact
    ]
    assert tuned(decoding, doubtful).noise.model_error == max(DOUBTS)
    assert doubting(decoding, 0.5).noise.snr_db == decoding.noise.snr_db
    with pytest.raises(TrainingError, match="nothing to tune on"):
        tuned(decoding, [])


def test_likelihoods_are_those_of_the_normal_law() -> None:
    generator = torch.Generator().manual_seed(0)
    response, mean = torch.randn(6, 2, generator=generator), torch.randn(6, generator=generator)
    noise = 0.5 + torch.rand(6, generator=generator)
    values = torch.randn(4, 6, generator=generator)
    found = log_likelihoods(values, mean, response, noise)
    covariance = (response @ response.T + noise.diag()).double()
    law = torch.distributions.MultivariateNormal(mean.double(), covariance)
    expected = law.log_prob(values.double())  # type: ignore[no-untyped-call]
    constant = expected - found
    # Factors in float32; the constant is that of six dimensions.
    assert torch.allclose(constant, torch.full_like(constant, -3 * 1.8378770664), atol=1e-4)


def test_a_leaked_list_says_which_mask_it_was(decoding: SceneDecoding) -> None:
    victim = make_victim(decoding, raw, masks=MASKS)
    assert isinstance(victim.source, StoredMasks)
    scenes = pictures(COUNT, seed=3)
    masks = [victim.mask() for _ in range(COUNT // 20)]
    parts = torch.split(scenes, 20)
    measurements = torch.cat(
        [victim.capture(mask, part) for mask, part in zip(masks, parts, strict=True)]
    )
    places = torch.tensor([mask.place for mask in masks]).repeat_interleave(20)
    known = victim.source.weights
    # Whoever always names one mask has that mask's share. An epoch may be named as a whole: its 20
    # captures count as one.
    named = int((identify(decoding, known, measurements) == places).sum())
    share = float(torch.bincount(places).max()) / COUNT
    assert named > 20 * binom.isf(1e-6, COUNT // 20, share)
    assert hits(read_by_list(decoding, known, measurements), scenes) > most(COUNT)
    # Captures of an epoch together leave no doubt.
    together = mask_likelihoods(decoding, known, measurements).reshape(-1, 20, MASKS).sum(1)
    assert torch.equal(together.argmax(1), places[::20])


@pytest.mark.slow
def test_a_leaked_list_says_nothing_of_directions(decoding: SceneDecoding) -> None:
    victim = make_victim(decoding, FORMS["white"], masks=MASKS)
    assert isinstance(victim.source, StoredMasks)
    masks = [victim.mask() for _ in range(COUNT)]
    scenes = pictures(COUNT, seed=3)
    released = torch.cat(
        [victim.capture(mask, scene[None]) for mask, scene in zip(masks, scenes, strict=True)]
    )
    places = torch.tensor([mask.place for mask in masks])
    named = int((identify(decoding, victim.source.weights, released) == places).sum())
    # Whoever always names one mask has that mask's share of them, at most the largest.
    share = float(torch.bincount(places).max()) / COUNT
    assert named <= binom.isf(1e-4, COUNT, share)


@pytest.mark.thorough
def test_a_learned_decoder_sees_more_than_a_linear_one(decoding: SceneDecoding) -> None:
    learned = DecodedFrames.of(decoding, seen(decoding, masks=20, captures=60, seed=11))
    check = DecodedFrames.of(decoding, seen(decoding, masks=4, captures=60, seed=12))
    test = DecodedFrames.of(decoding, seen(decoding, masks=4, captures=60, seed=13))
    said: list[tuple[int, int]] = []
    decoder = fit_decoder(
        learned,
        check,
        trials=(Trial(1, 1e-9, 0.0), Trial(2, 3e-3, 1e-4)),
        epochs=6,
        progress=lambda done, total: said.append((done, total)),
    )
    linear = (test.read[:, :64].reshape(-1, 8, 8) - test.scenes).square().mean((1, 2))
    with torch.no_grad():
        found = (decoder(test.read) - test.scenes).square().mean((1, 2))
    assert decoder_error(decoder, test) == pytest.approx(float(found.mean()), rel=1e-5)
    # Picture by picture: five standard errors come by chance once in three million times.
    gain = linear - found
    assert float(gain.mean()) > 5 * float(gain.std()) / math.sqrt(len(gain))
    assert said[-1] == (12, 12)


@pytest.mark.thorough
def test_a_learned_decoder_learns_nothing_from_directions(decoding: SceneDecoding) -> None:
    victim = make_victim(decoding, FORMS["white"], masks=1000)

    def frames(count: int, seed: int) -> DecodedFrames:
        found = []
        for scene in pictures(count, seed=seed):
            mask = victim.mask()
            released = victim.capture(mask, scene[None])
            # As bright as a measurement, so that the mean scene comes out of it.
            released = released + decoding.prepare(mask.weights).mean_measurement
            found.append(KnownCaptures(mask.weights, released, scene[None]))
        return DecodedFrames.of(decoding, found)

    learned, check, test = frames(200, 21), frames(60, 22), frames(COUNT // 2, 23)
    decoder = fit_decoder(learned, check, trials=TRIALS[1:2], epochs=3)
    with torch.no_grad():
        decoded = decoder(test.read)
    assert hits(decoded.flatten(1), test.scenes) <= luck(len(decoded))
