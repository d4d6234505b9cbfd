"""The mask-independent frame: exact, stable, and for panels with faults."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors.torch
import torch
from tests.unit.optics.tensors import seeded, smooth_scenes
from torch import Tensor

from veilcam_optics.arrays import cholesky
from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Window
from veilcam_optics.camera.imperfections import NOMINAL, Conditions, Imperfections
from veilcam_optics.camera.masks import quantise, random_mask
from veilcam_optics.decoding import (
    DEFAULT_NOISE,
    Decoder,
    MeasurementNoise,
    Precision,
    SceneDecoding,
    SceneFrame,
    SceneStatistics,
    fit_statistics,
    read_frame,
    unknown_share,
    write_frame,
)
from veilcam_optics.decoding import decoder as decoder_module
from veilcam_optics.decoding.decoder import _factor
from veilcam_optics.decoding.frame import dump_frame
from veilcam_optics.effects import Model, Sampling
from veilcam_optics.errors import OpticsError
from veilcam_optics.keys.masks import MaskDistribution
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.simulation.operator import LightOperator
from veilcam_optics.transfer.operator import TransferOperator

CAMERA, SCENE = Camera(), Scene(9, 8)
PIXELS = SCENE.rows * SCENE.columns
DOUBLE = torch.float64

STATISTICS = fit_statistics([smooth_scenes(SCENE, 4000, 0)], PIXELS)


def coloured(count: int, seed: int) -> Tensor:
    """Smooth scenes whose colours resemble each other, (count, 3, rows, columns)."""
    gray, *own = (smooth_scenes(SCENE, count, 4 * seed + each) for each in range(4))
    return 0.7 * gray[:, None] + 0.3 * torch.stack(own, 1)


COLOURED = fit_statistics([coloured(2000, 10)], 3 * PIXELS)


def mask(seed: int = 0) -> Tensor:
    return random_mask(CAMERA, seeded(seed))


def make(
    embedding: Embedding,
    *,
    statistics: SceneStatistics = STATISTICS,
    noise: MeasurementNoise = DEFAULT_NOISE,
    precision: Precision = Precision.DOUBLE,
) -> SceneDecoding:
    dtype, colour = getattr(torch, precision.products), statistics.pixels > PIXELS
    operator = TransferOperator(CAMERA, SCENE, embedding, colour=colour, dtype=dtype)
    return SceneDecoding(operator, statistics, noise, precision=precision)


def response_of(decoding: SceneDecoding, weights: Tensor) -> Tensor:
    """A, (embedding values, scene values), whole: in colour a block for each."""
    transfer = decoding.operator(weights.double())
    planes = transfer if transfer.ndim == 3 else transfer[None]
    whole: Tensor = torch.block_diag(*planes).T  # type: ignore[no-untyped-call]
    return whole


def textbook(
    decoding: SceneDecoding, weights: Tensor, measurements: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Estimate, its covariance and the noise, by the formulas as they are written, in float64."""
    A, statistics = response_of(decoding, weights), decoding.statistics
    S, lost = statistics.basis @ statistics.basis.T, A.square() @ statistics.residual
    mean, spread = A @ statistics.mean, (A @ S @ A.T).diagonal() + lost
    N = decoding.noise.variance(mean, spread) + lost
    gain = S @ A.T @ torch.linalg.inv(A @ S @ A.T + torch.diag(N))
    estimate = statistics.mean + (measurements.double().flatten(1) - mean) @ gain.T
    return estimate, S - gain @ A @ S + torch.diag(statistics.residual), N


@pytest.mark.parametrize("shape", [(3, 4), (6, 8), (12, 16)])
@pytest.mark.parametrize("colour", [False, True])
def test_is_the_textbook_estimate(shape: tuple[int, int], *, colour: bool) -> None:
    """Both forms: few numbers factor E x E, many rank x rank."""
    decoding = make(Embedding(*shape), statistics=COLOURED if colour else STATISTICS)
    scenes = coloured(20, 1) if colour else smooth_scenes(SCENE, 20, 1)
    weights, generator = mask().double(), seeded(2)
    clean = scenes.double().flatten(1) @ response_of(decoding, weights).T
    measurements = shot_noise(clean, 40.0, generator)
    decoder = decoding.prepare(weights)
    wanted, covariance, _ = textbook(decoding, weights, measurements)
    planes = (3,) if colour else ()
    estimate = decoder(measurements.reshape(20, *planes, *shape))
    assert (decoder.channels, estimate.shape) == (3 if colour else 1, scenes.shape)
    assert float((estimate.flatten(1) - wanted).abs().max()) < 1e-7
    share = unknown_share(decoding.operator(weights), decoding.statistics)
    left = covariance.trace() / decoding.statistics.variance.sum()
    assert float(share) == pytest.approx(float(left), abs=1e-7)


@pytest.mark.parametrize("rank", [8, PIXELS])
def test_innovation_is_the_textbook_s_and_1_where_all_is_as_expected(rank: int) -> None:
    decoding = make(Embedding(6, 8), statistics=STATISTICS.truncate(rank))
    statistics, weights = decoding.statistics, mask().double()
    decoder, A = decoding.prepare(weights), decoding.operator(weights).T
    S = statistics.basis @ statistics.basis.T
    covariance = A @ S @ A.T + torch.diag(decoder.noise)
    generator = seeded(4)
    drawn = torch.randn(4000, 48, generator=generator, dtype=DOUBLE)
    told = drawn @ torch.linalg.cholesky(covariance).T
    found = decoder.innovation((A @ statistics.mean + told).reshape(-1, 6, 8))
    # Each is a chi-squared of 48 over 48.
    assert torch.allclose(found, drawn.square().mean(1), rtol=1e-6)
    assert float(found.mean()) == pytest.approx(1, abs=5 * math.sqrt(2 / 48 / 4000))
    assert float(decoder.innovation(decoder.mean_measurement[None])) == 0
    with pytest.raises(OpticsError, match=r"measurements\.shape"):
        decoder.innovation(torch.zeros(2, 47))


@pytest.mark.parametrize("known", [STATISTICS, COLOURED], ids=["gray", "colour"])
@pytest.mark.parametrize("rank", [8, 12, 60])
def test_low_rank_is_the_textbook_with_what_is_left_out_as_noise(
    rank: int, known: SceneStatistics
) -> None:
    """Fewer, as many and more components than the 12 numbers of a measurement, or its 36."""
    noise = MeasurementNoise(30.0, model_error=0.02)
    decoding = make(Embedding(3, 4), statistics=known.truncate(rank), noise=noise)
    weights, transfer = mask().double(), decoding.operator(mask().double())
    measurements = torch.rand(4, *transfer.shape[:-2], 3, 4, generator=seeded(3), dtype=DOUBLE)
    decoder = decoding.prepare(weights)
    wanted, covariance, N = textbook(decoding, weights, measurements)
    assert torch.allclose(decoder.noise, N, rtol=1e-9)
    # The matrices' condition is below 1e6, so ten digits of sixteen are left.
    assert torch.allclose(decoder(measurements).flatten(1), wanted, atol=1e-7)
    assert torch.equal(decoder(measurements.flatten(1)), decoder(measurements))
    left = float(covariance.trace() / decoding.statistics.variance.sum())
    share = unknown_share(transfer, decoding.statistics, noise)
    assert float(share) == pytest.approx(left, abs=1e-8)
    in_numpy = unknown_share(transfer.numpy(), decoding.statistics.in_numpy(), noise)
    assert float(in_numpy) == pytest.approx(left, abs=1e-8)
    assert torch.equal(decoding.prepare_transfer(transfer)(measurements), decoder(measurements))


@pytest.mark.parametrize(("rank", "size"), [(8, 8), (30, 12)])
def test_smaller_matrix_is_factored(monkeypatch: pytest.MonkeyPatch, rank: int, size: int) -> None:
    factored: list[torch.Size] = []

    def noted(matrix: Tensor) -> Tensor | None:
        factored.append(matrix.shape)
        return cholesky(matrix)

    monkeypatch.setattr(decoder_module, "cholesky", noted)
    make(Embedding(3, 4), statistics=STATISTICS.truncate(rank)).prepare(mask().double())
    assert factored == [(size, size)]


@pytest.mark.parametrize("scale", [0.01, 20.0])
def test_scenes_in_another_unit_are_decoded_in_that_unit(scale: float) -> None:
    scaled = SceneStatistics(
        STATISTICS.mean * scale, STATISTICS.basis * scale, STATISTICS.residual * scale**2
    )
    one, other = (
        make(Embedding(6, 8), statistics=statistics).prepare(mask().double())
        for statistics in (STATISTICS, scaled)
    )
    scenes = smooth_scenes(SCENE, 3, 1).double()
    measurements = make(Embedding(6, 8)).operator.embed(scenes, mask().double())
    found, wanted = other(scale * measurements), scale * one(measurements)
    # Statistics are float32: scaling rounds them by 6e-8, which 40 dB can amplify a hundredfold.
    assert float((found - wanted).norm() / wanted.norm()) < 1e-5


@pytest.mark.parametrize("shape", [(1, 1), (6, 8)])
def test_scene_that_never_changes_is_known(shape: tuple[int, int]) -> None:
    still = SceneStatistics(STATISTICS.mean, torch.zeros(PIXELS, 2), torch.zeros(PIXELS))
    decoding = make(Embedding(*shape), statistics=still)
    decoder = decoding.prepare(mask().double())
    estimate = decoder(torch.rand(2, *shape))
    assert torch.equal(estimate[1].flatten(), STATISTICS.mean.double())
    assert float(unknown_share(decoding.operator(mask().double()), decoding.statistics)) == 0


def test_jitter_grows_tenfold_until_the_matrix_can_be_factored(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    added: list[float] = []

    def failing(matrix: Tensor) -> Tensor | None:
        added.append(float(matrix[0, 0]) - 4)
        return None if len(added) < 4 else cholesky(matrix)

    monkeypatch.setattr(decoder_module, "cholesky", failing)
    found = _factor(3 * torch.eye(2, dtype=DOUBLE))
    eps = torch.finfo(DOUBLE).eps
    # Of 3 + 1 + jitter the jitter is read off to half a unit in the last place, 2 eps.
    assert added == [pytest.approx(4 * 10**k * eps, abs=2.001 * eps) for k in range(4)]
    assert torch.allclose(found @ found.T, 4 * torch.eye(2, dtype=DOUBLE), rtol=1e-11)


def test_response_that_is_not_finite_is_refused() -> None:
    decoding = make(Embedding(3, 4))
    transfer = decoding.operator(mask().double())
    transfer[5, 2] = math.nan
    with pytest.raises(OpticsError, match="holds NaN or infinity"):
        decoding.prepare_transfer(transfer)


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(6, 8), (24, 32)])
def test_precision_is_bounded(shape: tuple[int, int]) -> None:
    weights = quantise(mask(3), CAMERA.panel)
    exact = make(Embedding(*shape))
    scenes = smooth_scenes(SCENE, 50, 4).double()
    generator = seeded(2)
    measurements = shot_noise(exact.operator.embed(scenes, weights.double()), 40.0, generator)
    wanted = exact.prepare(weights)(measurements)

    def error(precision: Precision) -> float:
        estimate = make(Embedding(*shape), precision=precision).prepare(weights)(measurements)
        assert estimate.dtype == getattr(torch, precision.products)
        return float((estimate - wanted).norm() / wanted.norm())

    assert error(Precision.MIXED) < 1e-4
    assert error(Precision.MIXED) < error(Precision.SINGLE) < 0.1


@pytest.mark.parametrize("gain", [0.3, 7.0])
def test_gain_is_undone(gain: float) -> None:
    decoding = make(Embedding(6, 8))
    weights, scenes = mask().double(), smooth_scenes(SCENE, 10, 1).double()
    measurements = decoding.operator.embed(scenes, weights)
    wanted = decoding.prepare(weights)(measurements)
    assert torch.allclose(
        decoding.prepare(weights, gain=gain)(gain * measurements), wanted, atol=1e-9
    )
    per_pixel = torch.linspace(0.5, gain + 1, 48, dtype=DOUBLE)
    uneven = decoding.prepare(weights, gain=per_pixel)(measurements.flatten(1) * per_pixel)
    assert float((uneven - scenes).square().mean()) < 1.2 * float((wanted - scenes).square().mean())
    ignored = decoding.prepare(weights)(measurements.flatten(1) * per_pixel)
    assert float((ignored - scenes).square().mean()) > float((wanted - scenes).square().mean())


def test_model_error_makes_a_displaced_panel_bearable() -> None:
    embedding = Embedding(12, 16)
    displaced = replace(CAMERA, distance=CAMERA.distance + 600e-6)
    truth = TransferOperator(displaced, SCENE, embedding, dtype=DOUBLE)
    scenes, weights = smooth_scenes(SCENE, 100, 1).double(), mask().double()
    measurements = truth.embed(scenes, weights)
    trusting = make(embedding).prepare(weights)
    wary = make(embedding, noise=MeasurementNoise(model_error=0.03)).prepare(weights)
    assert bool((wary.noise > trusting.noise).all())
    transfer, known = make(embedding).operator(weights), STATISTICS.to("float64")
    shares = [unknown_share(transfer, known, MeasurementNoise(model_error=e)) for e in (0, 0.03)]
    assert shares[0] < shares[1]
    error = [float((d(measurements) - scenes).square().mean()) for d in (trusting, wary)]
    assert error[1] < error[0]


def test_expected_noise_is_the_noise_that_is_made() -> None:
    decoding = make(Embedding(6, 8), noise=MeasurementNoise(snr_db=20.0))
    scenes, weights = smooth_scenes(SCENE, 3000, 6).double(), mask().double()
    clean = decoding.operator.embed(scenes, weights).flatten(1)
    noisy = shot_noise(clean, 20.0, seeded(0))
    seen = (noisy - clean).square().mean(0)
    assert float((decoding.prepare(weights).noise / seen).log().abs().max()) < 0.25


def test_closed_mask_gives_the_mean_scene() -> None:
    decoding = make(Embedding(6, 8))
    decoder = decoding.prepare(torch.zeros(CAMERA.mask_shape, dtype=DOUBLE))
    estimate = decoder(torch.zeros(2, 6, 8))
    assert torch.allclose(estimate[0].flatten(), decoding.statistics.mean)
    dark = torch.zeros(PIXELS, 48, dtype=DOUBLE)
    assert float(unknown_share(dark, decoding.statistics)) == pytest.approx(1.0)


@pytest.mark.parametrize("known", [STATISTICS.truncate(8), COLOURED], ids=["gray", "colour"])
@pytest.mark.parametrize("what", ["estimate", "share"])
def test_gradients_reach_the_mask(what: str, known: SceneStatistics) -> None:
    """Both forms of the formula."""
    decoding = make(Embedding(3, 4), statistics=known)
    weights = mask().double().requires_grad_()
    measurements = torch.rand(3, 12 * known.pixels // PIXELS, generator=seeded(2), dtype=DOUBLE)

    def loss(values: Tensor) -> Tensor:
        if what == "estimate":
            found: Tensor = decoding.prepare(values)(measurements).square().sum()
        else:
            found = unknown_share(decoding.operator(values), decoding.statistics)
        return found

    (gradient,) = torch.autograd.grad(loss(weights), weights)
    assert bool(gradient.isfinite().all())
    direction = torch.randn(weights.shape, generator=seeded(1), dtype=DOUBLE)
    step = 1e-6
    with torch.no_grad():
        slope = (loss(weights + step * direction) - loss(weights - step * direction)) / (2 * step)
    assert float((gradient * direction).sum()) == pytest.approx(float(slope), rel=1e-4)


def test_decoder_shows_nothing_of_the_mask() -> None:
    decoder = make(Embedding(3, 4)).prepare(mask().double())
    assert isinstance(decoder, Decoder)
    assert "tensor" not in repr(decoder)
    with pytest.raises(OpticsError) as refused:
        make(Embedding(3, 4)).prepare(torch.full(CAMERA.mask_shape, math.nan, dtype=DOUBLE))
    assert "0." not in str(refused.value)


def test_statistics_are_mean_and_covariance() -> None:
    scenes = smooth_scenes(SCENE, 500, 8)
    flat = scenes.flatten(1).double()
    whole = fit_statistics([scenes], PIXELS)
    parts = fit_statistics(torch.split(scenes, 130), PIXELS)
    covariance = torch.cov(flat.T, correction=0)
    for statistics in (whole, parts):
        assert torch.allclose(statistics.mean.double(), flat.mean(0), atol=1e-6)
        assert torch.allclose(
            statistics.basis.double() @ statistics.basis.double().T, covariance, atol=1e-6
        )
        assert statistics.share == pytest.approx(1)
    low = whole.truncate(10)
    assert low.rank == 10
    assert 0.5 < low.share < 1
    assert torch.allclose(low.variance, whole.variance, atol=1e-6)
    assert torch.allclose(low.basis, fit_statistics([scenes], 10).basis.abs() * low.basis.sign())


def prepare(**options: Any) -> Decoder:
    return make(Embedding(3, 4)).prepare(mask().double(), **options)


@pytest.mark.parametrize(
    ("attempt", "message"),
    [
        *(
            (lambda shape=shape: prepare()(torch.zeros(shape)), r"measurements\.shape")
            for shape in ((2, 4, 3), (2, 5, 3, 4))
        ),
        (lambda: prepare(gain=torch.ones(11)), r"gain\.shape"),
        *(
            (lambda gain=gain: prepare(gain=gain), "gain is not valid")
            for gain in (0.0, -1.0, math.inf, math.nan, torch.tensor([math.inf, *[1.0] * 11]))
        ),
        (
            lambda: SceneDecoding(TransferOperator(CAMERA, Scene(5, 5), Embedding()), STATISTICS),
            r"statistics\.pixels",
        ),
        (
            lambda: SceneDecoding(
                make(Embedding()).operator, STATISTICS, precision=Precision.MIXED
            ),
            "dtype",
        ),
        (
            lambda: SceneDecoding(
                TransferOperator(CAMERA, SCENE, Embedding(), colour=True), STATISTICS
            ),
            "colour",
        ),
        (lambda: MeasurementNoise(math.inf), "snr_db"),
        (lambda: MeasurementNoise(model_error=-1), "model_error"),
        (lambda: fit_statistics([], 3), "at least two"),
        (lambda: fit_statistics([smooth_scenes(SCENE, 5, 0)], 0), "rank"),
        (lambda: fit_statistics([torch.zeros(3, 4, n) for n in (4, 5)], 2), "pixels each"),
        (lambda: STATISTICS.truncate(PIXELS + 1), "rank"),
        (
            lambda: SceneStatistics(torch.zeros(3), torch.zeros(3, 1), -torch.ones(3)),
            "negative variance",
        ),
        (
            lambda: SceneStatistics(torch.full((3,), math.nan), torch.zeros(3, 1), torch.zeros(3)),
            "NaN",
        ),
    ],
)
def test_what_does_not_fit_is_refused(attempt: Callable[[], object], message: str) -> None:
    with pytest.raises(OpticsError, match=message):
        attempt()


def make_frame() -> SceneFrame:
    return SceneFrame(
        replace(CAMERA, distance=3.9e-3),
        SCENE,
        Embedding(6, 8),
        STATISTICS.truncate(30),
        MeasurementNoise(35.0, 0.01),
        distribution=MaskDistribution.power(CAMERA, 3.0),
    )


def test_frame_file_round_trip(tmp_path: Path) -> None:
    frame, path = make_frame(), tmp_path / "scene.safetensors"
    write_frame(path, frame)
    again = read_frame(path)
    for name in ("camera", "scene", "embedding", "noise", "reach"):
        assert getattr(again, name) == getattr(frame, name)
    for name in ("mean", "basis", "residual"):
        found, wanted = getattr(again.statistics, name), getattr(frame.statistics, name)
        assert np.array_equal(found, wanted.numpy())
    for name in ("lowest", "highest", "curve"):
        one, other = (getattr(f.distribution, name) for f in (frame, again))
        assert np.array_equal(one, other)
    imperfections = Imperfections(shift_y=1e-6, gamma=1.2, dead_rows=(0, 3), stray_light=0.1)
    write_frame(path, replace(frame, distribution=None, imperfections=imperfections))
    assert read_frame(path).distribution is None
    assert read_frame(path).imperfections == imperfections
    write_frame(path, frame)
    assert path.read_bytes() == dump_frame(again)
    measurements = torch.rand(2, 6, 8)
    cheap = frame.decoding(rank=20).prepare(mask())
    in_numpy = again.decoding(rank=20).prepare(mask().numpy())
    same = torch.from_numpy(in_numpy(measurements.numpy()))
    assert torch.allclose(cheap(measurements), same, rtol=1e-3)
    assert not torch.allclose(
        cheap(measurements), frame.decoding().prepare(mask())(measurements), rtol=1e-3
    )


def test_frame_file_is_refused_whole(tmp_path: Path) -> None:
    path = tmp_path / "scene.safetensors"
    with pytest.raises(OpticsError, match="cannot be read"):
        read_frame(path)
    data = dump_frame(make_frame())
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(OpticsError, match="is damaged"):
        read_frame(path)
    path.write_bytes(data.replace(b"veilcam-frame", b"veilcam-tramp"))
    with pytest.raises(OpticsError, match="is not valid: format"):
        read_frame(path)
    safetensors.torch.save_file({"mean": torch.zeros(3)}, path)
    with pytest.raises(OpticsError, match="is not a frame file"):
        read_frame(path)
    for changes, message in (
        ({"scene": Scene(8, 8)}, "another scene"),
        ({"camera": replace(CAMERA, window=Window(5, 5))}, "another panel"),
    ):
        path.write_bytes(dump_frame(replace(make_frame(), **changes)))
        with pytest.raises(OpticsError, match=message):
            read_frame(path)


def test_decoders_and_effects_compute_the_same_imperfections() -> None:
    camera = Camera(window=Window(rows=9, columns=5))
    scene, embedding = Scene(rows=6, columns=6), Embedding(4, 5)
    imperfections = Imperfections(
        shift_y=20e-6,
        shift_x=-30e-6,
        rotation=2e-3,
        distance_error=50e-6,
        gamma=1.4,
        contrast_floor=0.1,
        dead_rows=(3,),
        dead_columns=(1,),
        dead_transmittance=0.7,
    )
    weights = random_mask(camera, seeded(2))
    conditions = Conditions(imperfections=imperfections)
    expected = LightOperator(Model(camera, scene, embedding, conditions, Sampling("transfer")))(
        weights
    )

    def transfer(known: Imperfections) -> torch.Tensor:
        operator = TransferOperator(camera, scene, embedding, imperfections=known)
        result: torch.Tensor = operator(known.shown(weights))
        return result

    assert torch.equal(transfer(imperfections), expected)
    nominal = transfer(NOMINAL)
    assert float((nominal - expected).norm() / expected.norm()) > 0.05
    assert torch.equal(nominal, TransferOperator(camera, scene, embedding)(weights))


@pytest.mark.parametrize("precision", list(Precision))
def test_parts_of_a_decoder_are_overwritten_unless_a_gradient_needs_them(
    precision: Precision,
) -> None:
    decoding = make(Embedding(4, 5), precision=precision)
    made: list[Tensor] = []
    decoding.operator.register_forward_hook(lambda _, __, transfer: made.append(transfer))
    decoder = decoding.prepare(mask())
    assert not bool(made[0].any())
    assert bool(decoder.estimator.any())
    assert bool(decoder.response.any())
    learned = mask().requires_grad_()
    decoding.prepare(learned).estimator.sum().backward()  # type: ignore[no-untyped-call]
    assert bool(made[1].any())
    assert learned.grad is not None
    assert bool(learned.grad.any())
    # One that the caller gave is the caller's.
    given = decoding.operator(mask().to(decoding.operator.dtype))
    again = decoding.prepare_transfer(given)
    assert bool(given.any())
    assert torch.equal(again.estimator, decoder.estimator)
