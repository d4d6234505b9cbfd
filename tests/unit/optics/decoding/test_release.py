"""White embeddings: a direction that is uniform whatever was seen, and no length."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
import torch
from scipy.stats import chi2
from tests.unit.optics.tensors import seeded, smooth_scenes
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.decoding import Decoder, Precision, SceneDecoding, fit_statistics
from veilcam_optics.decoding.release import ReleaseForm, Whitening
from veilcam_optics.errors import OpticsError
from veilcam_optics.keys.masks import draw_levels
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.transfer.operator import TransferOperator

CAMERA, SCENE, EMBEDDING = Camera(), Scene(10, 10), Embedding(4, 5)
SIZE = EMBEDDING.size


def key_of(name: str) -> bytes:
    return hashlib.sha256(name.encode()).digest()


def make_decoding(precision: Precision = Precision.MIXED) -> SceneDecoding:
    statistics = fit_statistics([smooth_scenes(SCENE, 3000, 0)], 60)
    operator = TransferOperator(CAMERA, SCENE, EMBEDDING, dtype=getattr(torch, precision.products))
    return SceneDecoding(operator, statistics, precision=precision)


@pytest.fixture(scope="module")
def decoding() -> SceneDecoding:
    return make_decoding()


def make(decoding: SceneDecoding, name: str, count: int = 400) -> tuple[Decoder, Tensor]:
    weights = torch.from_numpy(to_weights(draw_levels(key_of(name), camera=CAMERA), CAMERA.panel))
    decoder = decoding.prepare(weights)
    random = seeded(len(name))
    dtype = decoding.operator.dtype
    scenes = smooth_scenes(SCENE, count, 1000 + len(name)).to(dtype)
    measurements = decoding.operator.embed(scenes, weights.to(dtype)).float()
    return decoder, shot_noise(measurements, 40.0, random)


def require_length_one(white: Tensor) -> None:
    """Every value is rounded by at most half of 2^-23 of itself, so their length is, too."""
    assert white.dtype == torch.float32
    assert float((white.double().norm(dim=1) - 1).abs().max()) <= 2.0**-24 + 1e-15


@pytest.mark.parametrize("times", [1.0, 1e-20, 1e20])
def test_white_embedding_has_length_one_whatever_was_measured(
    decoding: SceneDecoding, times: float
) -> None:
    decoder, measurements = make(decoding, "a")
    white = Whitening(decoder, key_of("turn")).whiten(times * measurements)
    assert white.shape == (len(measurements), SIZE)
    require_length_one(white)


def test_white_embedding_is_the_whitened_measurement_turned_and_without_its_length(
    decoding: SceneDecoding,
) -> None:
    """By the formula, without a factor: angles are those that C^-1 gives."""
    decoder, measurements = make(decoding, "a", count=30)
    white = Whitening(decoder, key_of("turn")).whiten(measurements).double()
    response = decoder.response.double()
    covariance = response @ response.T + torch.diag(decoder.noise.double())
    centred = measurements.flatten(1).double() - decoder.mean_measurement.double()
    products = centred @ torch.linalg.solve(covariance, centred.T)
    lengths = products.diagonal().sqrt()
    assert torch.allclose(white @ white.T, products / torch.outer(lengths, lengths), atol=1e-6)


def test_rotation_is_the_key_s_alone(decoding: SceneDecoding) -> None:
    decoder, measurements = make(decoding, "a", count=3)
    first = Whitening(decoder, key_of("turn")).whiten(measurements)
    assert torch.equal(Whitening(decoder, bytearray(key_of("turn"))).whiten(measurements), first)
    other = Whitening(decoder, key_of("turned")).whiten(measurements)
    # Of 20 dimensions: two directions that are unrelated seldom have a product of 0.9.
    assert float((first * other).sum(1).abs().max()) < 0.9
    with pytest.raises(OpticsError, match="a key is not valid: use 32 bytes"):
        Whitening(decoder, key_of("turn")[:31])


def require_uniform(directions: Tensor) -> None:
    """Moments of directions, against those of the uniform distribution over the sphere.

    With n dimensions: E u = 0, E u u' = I / n, E u_i^2 u_j^2 = 1 / (n (n + 2)) and
    E u_i^4 = 3 / (n (n + 2)). Means of N of them are nearly normal, so sums of their squares, each
    over its variance, follow chi^2; each bound is passed by chance once in 10^9. The terms of the
    fourth moment are bounded by Bernstein's inequality at the same chance: sum u_i^4 lies in
    [1/n, 1] and its variance is below its mean square, (3 / (n + 2))^2.
    """
    u, count = directions.double(), len(directions)
    chance = 1e-9
    assert count * SIZE * float(u.mean(0).square().sum()) < chi2.isf(chance, SIZE)
    second = (u.T @ u) / count
    apart = second[np.triu_indices(SIZE, 1)]
    scaled = count * SIZE * (SIZE + 2) * float(apart.square().sum())
    assert scaled < chi2.isf(chance, len(apart))
    # Var u_i^2 = 2 (n - 1) / (n^2 (n + 2)); the n of them sum to 1, so n - 1 are free, and each
    # direction of those has variance 2 / (n (n + 2)).
    along = second.diagonal() - 1 / SIZE
    assert count * SIZE * (SIZE + 2) / 2 * float(along.square().sum()) < chi2.isf(chance, SIZE - 1)
    expected = 3 / (SIZE + 2)
    log = np.log(2 / chance)
    bound = np.sqrt(2 * expected**2 * log / count) + 2 * log / (3 * count)
    assert abs(float(u.pow(4).sum(1).mean()) - expected) < bound


@pytest.mark.slow
@pytest.mark.parametrize("what", ["scene", "dark", "nan"])
def test_over_fresh_rotations_a_direction_is_uniform_whatever_was_seen(
    decoding: SceneDecoding, what: str
) -> None:
    decoder, measurements = make(decoding, "a", count=1)
    seen = {
        "scene": measurements,
        "dark": torch.zeros_like(measurements),
        "nan": torch.full_like(measurements, torch.nan),
    }[what]
    directions = torch.cat(
        [Whitening(decoder, key_of(f"{what} {i}")).whiten(seen) for i in range(1000)]
    )
    require_length_one(directions)
    require_uniform(directions)


def test_bounds_of_uniformity_would_tell(decoding: SceneDecoding) -> None:
    """Without a rotation of its own, a measurement's directions are anything but uniform."""
    decoder, measurements = make(decoding, "a", count=3000)
    white = Whitening(decoder, key_of("turn")).whiten(measurements)
    with pytest.raises(AssertionError):
        require_uniform(white)
    random = seeded(1)
    drawn = torch.randn(3000, SIZE, generator=random)
    require_uniform(drawn / drawn.norm(dim=1, keepdim=True))
    with pytest.raises(AssertionError):  # the corners of a cube: the fourth moment alone differs
        require_uniform(drawn.sign() / SIZE**0.5)


@pytest.mark.parametrize("value", [torch.nan, torch.inf, -torch.inf])
def test_measurement_without_a_direction_gets_one_and_others_keep_theirs(
    decoding: SceneDecoding, value: float
) -> None:
    decoder, measurements = make(decoding, "a", count=4)
    whitening = Whitening(decoder, key_of("turn"))
    expected = whitening.whiten(measurements)
    broken = measurements.clone()
    broken[1, 2, 3] = value
    broken[2] = decoder.mean_measurement.reshape(EMBEDDING.shape)
    once, again = whitening.whiten(broken), whitening.whiten(broken)
    require_length_one(once)
    assert torch.allclose(once[[0, 3]], expected[[0, 3]], atol=1e-6)
    for row in (1, 2):
        assert not torch.allclose(once[row], again[row], atol=1e-3)
        assert not torch.allclose(once[row], expected[row], atol=1e-3)


def test_refuses_another_shape(decoding: SceneDecoding) -> None:
    decoder, measurements = make(decoding, "a", count=3)
    whitening = Whitening(decoder, key_of("turn"))
    with pytest.raises(OpticsError, match=r"measurements\.shape"):
        whitening.whiten(measurements[:, :3])
    assert whitening.whiten(measurements[:0]).shape == (0, SIZE)
    flat = whitening.whiten(measurements.flatten(1))
    assert torch.equal(flat, whitening.whiten(measurements))


def test_whitening_shows_nothing_of_the_mask(decoding: SceneDecoding) -> None:
    decoder, _ = make(decoding, "a", count=1)
    whitening = Whitening(decoder, key_of("turn"))
    assert repr(whitening) == "Whitening(embedding=4x5)"
    assert "tensor" not in repr(decoder)


@pytest.mark.parametrize("precision", list(Precision))
@pytest.mark.parametrize("inference", [True, False])
def test_erased_whitening_is_zeros_and_others_stay(precision: Precision, inference: bool) -> None:
    decoding = make_decoding(precision)
    with torch.inference_mode(inference):
        decoder, measurements = make(decoding, "a", count=2)
        whitening = Whitening(decoder, key_of("turn"))
        neighbour, seen = make(decoding, "another", count=2)
        expected = neighbour(seen)
    estimate = decoder(measurements)
    own = (whitening._factor, whitening._rotation, whitening._mean, whitening._deviation)
    assert all(bool(tensor.any()) for tensor in own)
    whitening.erase()
    assert not any(bool(tensor.any()) for tensor in own)
    assert torch.equal(decoder(measurements), estimate)  # the decoder is as it was
    known = (
        *(decoder.mean_measurement, decoder.estimator, decoder.noise),
        decoder.response,
    )
    assert all(bool(tensor.any()) for tensor in known)
    decoder.erase()
    assert not any(bool(tensor.any()) for tensor in known)
    assert torch.equal(neighbour(seen), expected)
    assert torch.equal(decoding.statistics.mean, decoder.mean)


def test_forms_have_the_names_of_the_wire() -> None:
    assert [form.value for form in ReleaseForm] == ["white", "raw"]


def test_with_the_key_all_but_the_length_comes_back(decoding: SceneDecoding) -> None:
    decoder, measurements = make(decoding, "restored")
    whitening = Whitening(decoder, key_of("rotation"))
    directions = whitening.whiten(measurements)
    restored = whitening.restore(directions)
    torch.testing.assert_close(whitening.whiten(restored), directions, rtol=0, atol=1e-4)
    # Apart from the mean, one is a multiple of the other.
    mean = decoder.mean_measurement
    cosines = torch.cosine_similarity(restored - mean, measurements.flatten(1) - mean)
    assert float(cosines.min()) > 0.999
    # Another key turns to anywhere: in 20 dimensions a cosine has a deviation of .22.
    other = whitening.whiten(Whitening(decoder, key_of("another")).restore(directions))
    assert float(torch.cosine_similarity(other, directions).abs().median()) < 0.7
