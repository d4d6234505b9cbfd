"""The estimated scene behind a mask is what the optics decode, and leaves as a plain layer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Window
from veilcam_optics.decoding import MeasurementNoise, fit_statistics
from veilcam_optics.decoding.decoder import prepare_decoder
from veilcam_training.bundle import Network, read_bundle, write_bundle
from veilcam_training.config.recipes import Recipe
from veilcam_training.config.settings import Settings
from veilcam_training.data import Source, open_source, split
from veilcam_training.encoders import LearnedMask, LinearEncoder, Setup, make_encoder
from veilcam_training.encoders.estimate import SceneEstimate
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.fit import run_fit
from veilcam_training.experiments.keyring import as_bundle, check_pairs
from veilcam_training.experiments.model import make_model, prepare
from veilcam_training.seeding import stream

CAMERA = Camera(window=Window(rows=8, columns=4))
SCENE, EMBEDDING = Scene(rows=6, columns=8), Embedding(3, 4)
SCENES = torch.rand(60, 6, 8, generator=stream(0, "scenes"))
STATISTICS = fit_statistics([SCENES], 20)


def camera(name: str = "learned") -> LinearEncoder:
    return make_encoder(name, Setup(CAMERA, SCENE, EMBEDDING), stream(0, "encoder"))


def estimate_of(encoder: LinearEncoder, **options: Any) -> SceneEstimate:
    estimate = SceneEstimate(encoder, 40.0, **options)
    estimate.learn(STATISTICS)
    return estimate


def close(found: torch.Tensor, wanted: torch.Tensor) -> bool:
    # float32 throughout, but for the factor: sums of some tens of products of order 1, in another
    # order. A wrong term would show in the first digit or the second.
    return bool((found - wanted).abs().max() <= 1e-4 * wanted.abs().max())


@pytest.mark.parametrize("snr_db", [40.0, 20.0])
def test_estimate_is_what_the_optics_decode(snr_db: float) -> None:
    encoder = camera()
    estimate = SceneEstimate(encoder, snr_db)
    estimate.learn(STATISTICS)
    measurements = encoder(SCENES[:5])
    transfer, noise = encoder.transfer(), MeasurementNoise(snr_db)
    decoder = prepare_decoder(transfer, STATISTICS, noise, scene=SCENE, embedding=EMBEDDING)
    scenes, deviation = estimate(measurements).unflatten(1, (2, 6, 8)).unbind(1)
    assert close(scenes, decoder(measurements))
    assert close(deviation, decoder.deviation.expand(5, 6, 8))
    clear = SceneEstimate(encoder, None)
    clear.learn(STATISTICS)
    assert bool(torch.isfinite(clear(measurements)).all())


def test_larger_pixels_are_means() -> None:
    encoder = camera()
    measurements = encoder(SCENES[:5])
    fine = estimate_of(encoder)(measurements).unflatten(1, (2, 6, 8))
    coarse = estimate_of(encoder, pooling=2)(measurements).unflatten(1, (2, 3, 4))
    means = torch.nn.functional.avg_pool2d(fine, 2)
    assert close(coarse[:, 0], means[:, 0])
    # Neighbours do not err together, so their mean errs less than they do in the mean.
    assert bool((coarse[:, 1] < means[:, 1]).all())


@pytest.mark.parametrize("pooling", [1, 2])
def test_as_a_layer_it_gives_the_same(pooling: int) -> None:
    encoder = camera("fixed_simulated")
    estimate = estimate_of(encoder, pooling=pooling)
    measurements = encoder(SCENES[:5])
    assert close(estimate.as_linear()(measurements), estimate(measurements))


def test_mask_learns_through_it() -> None:
    encoder = camera()
    estimate = estimate_of(encoder)
    estimate(encoder(SCENES[:5])).square().sum().backward()
    (weights,) = encoder.parameters()
    assert weights.grad is not None
    assert float(weights.grad.abs().max()) > 0
    assert not list(estimate.parameters())
    assert not estimate.state_dict()


def test_sharp_mask_leaves_less_unknown_than_any_at_random() -> None:
    def unknown(encoder: LinearEncoder) -> float:
        decoder = prepare_decoder(encoder.transfer(), STATISTICS, scene=SCENE, embedding=EMBEDDING)
        return decoder.remaining

    encoder = camera()
    before = [unknown(make_encoder("learned", encoder.setup, stream(s, ""))) for s in range(5)]
    left = estimate_of(encoder).sharpen()
    encoder.eval()
    # What it says is what the panel's levels leave: training lifts closed sub-pixels by 0.3 levels.
    assert left == pytest.approx(unknown(encoder), rel=0.05)
    # Of such scenes, white noise, nobody sees much. It is 3 %, where masks at random differ by 1 %.
    assert left < 0.98 * min(before)
    (weights,) = encoder.parameters()
    assert weights.grad is None
    with pytest.raises(TrainingError, match="leave out mask_start"):
        estimate_of(camera("fixed_simulated")).sharpen()


def test_estimate_with_bad_settings_is_refused() -> None:
    with pytest.raises(TrainingError, match="pooling = 4 does not divide"):
        SceneEstimate(camera(), 40.0, 4)
    setup = Setup(CAMERA, Scene(rows=100, columns=100), EMBEDDING)
    with pytest.raises(TrainingError, match="100 x 100 pixels is too large"):
        SceneEstimate(make_encoder("learned", setup, stream(0, "encoder")), 40.0)


# --- at the head of a classifier

RECIPE = Recipe(epochs=1, batch=90, pooling=2, rank=40)


def settings(**changes: Any) -> Settings:
    chosen = Settings(embedding="6x8", classifier="ResNet2", recipe=RECIPE)
    return chosen.model_copy(update=changes)


@pytest.mark.parametrize("encoder", ["learned", "fixed_simulated"])
def test_bundle_reads_without_it(source: Source, tmp_path: Path, encoder: str) -> None:
    """The daemon's network gives, from a bare measurement, what the fitted model gives."""
    check_pairs(settings(encoder=encoder), source, CAMERA)  # before anything is known of scenes
    result = run_fit(settings(encoder=encoder), source, CAMERA)
    write_bundle(tmp_path / "res.veilcam", as_bundle([result], source, CAMERA))
    (pair,) = read_bundle(tmp_path / "res.veilcam").pairs
    model = result.fit.model
    model.snr_db = None  # its noise would differ from none
    with torch.no_grad():
        measurements = model.encoder(source.test().scenes(slice(20)))
        wanted = model.read(measurements, stream(0, "noise")).numpy()
        reader = model.reader()(measurements).numpy()
    found = Network.load(pair.layers, pair.weights)(measurements.numpy())
    # Both compute the same layer in float32; only the first is formed in another order.
    scale = np.abs(wanted).max()
    assert np.abs(found - reader).max() <= 1e-5 * scale
    assert np.abs(reader - wanted).max() <= 1e-3 * scale


@pytest.mark.parametrize("start", ["random", "sharp"])
def test_mask_that_stays(source: Source, start: str) -> None:
    recipe = RECIPE.model_copy(update={"mask_rate": 0.0, "mask_start": start})
    chosen = settings(recipe=recipe)
    model = make_model(chosen, source, CAMERA)
    prepare(model, chosen, split(source.training()).training)
    fitted = run_fit(chosen, source, CAMERA).fit.model.encoder
    assert isinstance(fitted, LearnedMask)
    assert isinstance(model.encoder, LearnedMask)
    assert np.array_equal(fitted.levels(), model.encoder.levels())
    assert fitted.constant
    assert fitted.trainable


def test_scenes_are_learned_from_the_training_part_alone(source: Source) -> None:
    model, chosen = make_model(settings(), source, CAMERA), settings()
    assert model.estimate is not None
    training = split(source.training()).training
    prepare(model, chosen, training)
    mean = training.scenes().mean(0).flatten()
    assert torch.allclose(model.estimate.mean, mean, atol=1e-5)
    assert model.estimate.basis.shape == (784, 40)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"change": "rescale"}, "without colour and change"),
        ({"recipe": Recipe(exposure="automatic")}, "exposure 'automatic'"),
        ({"recipe": Recipe(normalisation="white")}, "not with 'ResNet2'"),
        ({"recipe": Recipe(pooling=3)}, "pooling = 3 does not divide"),
        ({"classifier": "LR", "recipe": Recipe(mask_start="sharp")}, "use ResNet<width>"),
    ],
)
def test_estimate_cannot_be_combined_with_other_options(
    source: Source,
    cifar_files: Callable[[Path], Path],
    tmp_path: Path,
    changes: dict[str, Any],
    reason: str,
) -> None:
    with pytest.raises(TrainingError, match=reason):
        make_model(settings(**changes), source, CAMERA)
    colour = open_source("cifar10", cifar_files(tmp_path))
    with pytest.raises(TrainingError, match="without colour"):
        make_model(settings(data="cifar10"), colour, CAMERA)
