"""The estimated scene behind a mask is what the optics decode, and leaves as a plain layer."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Window
from veilcam_optics.camera.masks import random_mask
from veilcam_optics.decoding import (
    MeasurementNoise,
    Precision,
    fit_statistics,
    unknown_share,
)
from veilcam_optics.decoding.decoder import prepare_decoder
from veilcam_training.bundle import Network, classifier_inputs, read_bundle, write_bundle
from veilcam_training.config.recipes import SCENES
from veilcam_training.config.settings import FitSettings, FreshMasks
from veilcam_training.data import Source, open_source, split
from veilcam_training.encoders import LearnedMask, LinearEncoder, Setup, make_encoder
from veilcam_training.encoders.copies import Copies
from veilcam_training.encoders.estimate import SceneEstimate
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.fit import run_fit, run_fresh
from veilcam_training.experiments.keyring import as_bundle, as_fresh_bundle, check_pairs
from veilcam_training.experiments.model import make_model, prepare
from veilcam_training.seeding import stream

CAMERA = Camera(window=Window(rows=8, columns=4))
SCENE, EMBEDDING = Scene(rows=6, columns=8), Embedding(3, 4)
KNOWN = {
    colour: (scenes, fit_statistics([scenes], 20))
    for colour, planes in ((False, ()), (True, (3,)))
    for scenes in [torch.rand(60, *planes, 6, 8, generator=stream(0, "scenes"))]
}
"""Scenes and their statistics, gray and in colour."""


def camera(name: str = "learned", *, colour: bool = False) -> LinearEncoder:
    setup = Setup(CAMERA, SCENE, EMBEDDING, colour=colour)
    return make_encoder(name, setup, stream(0, "encoder"))


def estimate_of(encoder: LinearEncoder, rank: int = 20, pooling: int = 1) -> SceneEstimate:
    estimate = SceneEstimate(encoder, 40.0, rank, pooling)
    estimate.learn(KNOWN[encoder.setup.colour][1].truncate(rank))
    return estimate


def close(found: torch.Tensor, wanted: torch.Tensor) -> bool:
    # float32 throughout, but for the factor: sums of some tens of products of order 1, in another
    # order. A wrong term would show in the first digit or the second.
    return bool((found - wanted).abs().max() <= 1e-4 * wanted.abs().max())


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("snr_db", [40.0, 20.0])
def test_estimate_is_what_the_optics_decode(snr_db: float, *, colour: bool) -> None:
    encoder, (scenes, statistics) = camera(colour=colour), KNOWN[colour]
    estimate = SceneEstimate(encoder, snr_db, 20)
    estimate.learn(statistics)
    measurements, noise = encoder(scenes[:5]), MeasurementNoise(snr_db)
    decoder = prepare_decoder(
        encoder.transfer(), statistics, noise, scene=SCENE, embedding=EMBEDDING
    )
    assert close(estimate(measurements), decoder(measurements).flatten(1))
    clear = SceneEstimate(encoder, None, 20)
    clear.learn(statistics)
    assert bool(torch.isfinite(clear(measurements)).all())


@pytest.mark.parametrize("colour", [False, True])
def test_larger_pixels_are_means(*, colour: bool) -> None:
    encoder, planes = camera(colour=colour), 3 if colour else 1
    measurements = encoder(KNOWN[colour][0][:5])
    fine = estimate_of(encoder)(measurements).unflatten(1, (planes, 6, 8))
    coarse = estimate_of(encoder, pooling=2)(measurements).unflatten(1, (planes, 3, 4))
    assert close(coarse, torch.nn.functional.avg_pool2d(fine, 2))


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize(("rank", "pooling", "count"), [(5, 1, 2), (20, 2, 1), (5, 2, 2)])
def test_as_layers_it_gives_the_same(rank: int, pooling: int, count: int, *, colour: bool) -> None:
    """Two layers of few components, or one where that takes fewer products."""
    encoder = camera("fixed_simulated", colour=colour)
    estimate = estimate_of(encoder, rank=rank, pooling=pooling)
    measurements = encoder(KNOWN[colour][0][:5])
    layers = estimate.as_layers()
    assert [(each.inputs, each.outputs) for each in estimate.layers] == [
        (each.in_features, each.out_features) for each in layers
    ]
    assert len(layers) == count
    assert close(torch.nn.Sequential(*layers)(measurements), estimate(measurements))


def unknown(encoder: LinearEncoder) -> float:
    encoder.eval()
    _, known = KNOWN[encoder.setup.colour]
    with torch.no_grad():
        return float(unknown_share(encoder.transfer(), known))


@pytest.mark.slow
@pytest.mark.parametrize("colour", [False, True])
def test_learned_mask_leaves_less_unknown_than_any_at_random(*, colour: bool) -> None:
    encoder = camera(colour=colour)
    others = (make_encoder("learned", encoder.setup, stream(s, "")) for s in range(5))
    before = [unknown(each) for each in others]
    encoder.train()
    left = estimate_of(encoder).learn_mask()
    # What it says is what the panel's levels leave: training lifts closed sub-pixels by 0.3 levels.
    assert left == pytest.approx(unknown(encoder), rel=0.05)
    # Of such scenes, white noise, nobody sees much. It is 2 or 3 %, and random masks differ by 1 %.
    assert left < 0.985 * min(before)
    (weights,) = encoder.parameters()
    assert weights.grad is None
    with pytest.raises(TrainingError, match="learns no mask"):
        estimate_of(camera("fixed_simulated")).learn_mask()


@pytest.mark.slow
def test_hidden_mask_keeps_its_copies() -> None:
    """Of a window as large as the camera's; less is left unknown than behind a random one."""
    setup = Setup(Camera(), SCENE, Embedding(6, 8))
    random_one, hidden, visible = (make_encoder("learned", setup, stream(1, "")) for _ in range(3))
    copies, share = Copies(setup.camera, setup.scene, colour=False), 0.95
    assert isinstance(hidden, LearnedMask)
    hidden.hide(share)
    counts = []
    for encoder in (hidden, visible):
        assert isinstance(encoder, LearnedMask)
        estimate_of(encoder.train()).learn_mask()
        counts.append(float(copies.count(encoder.weights.detach()) / copies.random))
    # A penalty bends and does not break: it gives way by a few parts in a hundred.
    assert counts[1] < 0.8 * share < 0.9 * share < counts[0]
    assert unknown(visible) < unknown(hidden) < unknown(random_one)


def test_copies_are_counted() -> None:
    scene, generator = Scene(28, 28), torch.Generator().manual_seed(9)
    copies = Copies(Camera(), scene, colour=True)
    pinhole = torch.zeros(Camera().mask_shape)
    pinhole[10:13, 20] = 1
    assert bool((copies.count(pinhole) < 5).all())
    assert bool((copies.random > 30).all())
    drawn = random_mask(Camera(), generator)
    torch.testing.assert_close(copies.count(drawn), copies.random, rtol=0.3, atol=0)
    assert float(copies(drawn, 0.5)) == 0
    seen = (0.05 + pinhole).clamp_max(1).requires_grad_()
    penalty = copies(seen, 0.5)
    penalty.backward()
    assert float(penalty.detach()) > 0
    assert seen.grad is not None
    better = (seen - 1e-3 * seen.grad / seen.grad.abs().max()).detach()
    assert bool((copies.count(better) > copies.count(seen.detach())).any())
    assert float(copies(better, 0.5)) < float(penalty.detach())


def test_estimate_with_bad_settings_is_refused() -> None:
    with pytest.raises(TrainingError, match="pooling = 4 does not divide"):
        SceneEstimate(camera(), 40.0, 20, 4)
    setup = Setup(CAMERA, Scene(rows=100, columns=100), EMBEDDING)
    with pytest.raises(TrainingError, match="100 x 100 pixels is too large"):
        SceneEstimate(make_encoder("learned", setup, stream(0, "encoder")), 40.0, 20)


# --- at the head of a classifier

SMALL = {**SCENES, "epochs": 2, "batch": 30, "rate": 0.2, "rank": 40}


def settings(**changes: Any) -> FitSettings:
    chosen = FitSettings(embedding="6x8", classifier="Scene4")
    return chosen.model_copy(update={**SMALL, **changes})


@pytest.fixture(params=[False, True], ids=["gray", "colour"])
def data(request: pytest.FixtureRequest, source: Source, tmp_path: Path) -> Source:
    if not request.param:
        return source
    for name in ("cat", "dog"):
        (tmp_path / name).mkdir()
        for number in range(60):
            pixels = np.random.default_rng(number).integers(0, 256, (12, 16, 3), dtype=np.uint8)
            Image.fromarray(pixels).save(tmp_path / name / f"{number}.png")
    return open_source("image-folder", tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("encoder", ["learned", "fixed_simulated"])
def test_bundle_reads_without_it(data: Source, tmp_path: Path, encoder: str) -> None:
    """The daemon's network gives, from a bare measurement, what the fitted model gives."""
    check_pairs(settings(encoder=encoder), data, CAMERA)  # before anything is known of scenes
    result = run_fit(settings(encoder=encoder), data, CAMERA)
    write_bundle(tmp_path / "res.veilcam", as_bundle([result], data, CAMERA))
    bundle = read_bundle(tmp_path / "res.veilcam")
    (pair,), model = bundle.pairs, result.fit.model
    assert bundle.channels == model.encoder.setup.channels
    model.snr_db = None  # its noise would differ from none
    with torch.no_grad():
        measurements = model.encoder(data.test().scenes(slice(20)))
        wanted = model.read(measurements, stream(0, "noise")).numpy()
        reader = model.reader()(measurements).numpy()
    found = Network.load(pair.layers, pair.weights)(measurements.numpy())
    # Both compute the same layer in float32; only the first is formed in another order.
    scale = np.abs(wanted).max()
    assert np.abs(found - reader).max() <= 1e-5 * scale
    assert np.abs(reader - wanted).max() <= 1e-3 * scale


@pytest.mark.slow
def test_bundle_of_fresh_masks_reads_in_numpy(data: Source) -> None:
    chosen = settings(fresh=FreshMasks(masks=5, misalignment=None))
    result = run_fresh(chosen, data, CAMERA, masks=5)
    bundle = as_fresh_bundle(result, data, CAMERA)
    fresh, camera = bundle.fresh, result.camera
    assert fresh is not None
    levels = camera.draw_levels("a", 0)
    frame = fresh.frame(CAMERA, bundle.scene, bundle.embedding)
    decoder = frame.decoding(precision=Precision.DOUBLE).prepare(frame.shown(levels))
    mask = camera.prepare(
        camera.frame.in_torch().shown(levels), camera.panels("a"), torch.Generator()
    )
    with torch.no_grad():
        measurements = mask.embed(data.test().scenes(slice(20)))
        wanted = result.fit.model.classify(mask.decode(measurements)).argmax(1)
    inputs = classifier_inputs(decoder, measurements.numpy())
    found = Network.load(fresh.layers, fresh.weights)(inputs.astype(np.float32)).argmax(1)
    # Two scores may be as good as the same; a wrong order of colours would turn most of them.
    assert (found == wanted.numpy()).mean() >= 0.9


@pytest.mark.slow
def test_second_stage_changes_the_mask(source: Source) -> None:
    masks = []
    for end_to_end in (False, True):
        chosen = settings(end_to_end=end_to_end)
        encoder = run_fit(chosen, source, CAMERA).fit.model.encoder
        assert isinstance(encoder, LearnedMask)
        masks.append(encoder.levels())
    assert (masks[0] != masks[1]).any()
    with pytest.raises(TrainingError, match="only a Scene classifier has a second stage"):
        make_model(settings(classifier="LR", end_to_end=True), source, CAMERA)


def test_scenes_are_learned_from_the_training_part_alone(source: Source) -> None:
    chosen = settings(encoder="fixed_simulated")
    model = make_model(chosen, source, CAMERA)
    assert model.estimate is not None
    training = split(source.training()).training
    prepare(model, chosen, training)
    mean = training.scenes().mean(0).flatten()
    assert torch.allclose(model.estimate.mean, mean, atol=1e-5)
    assert model.estimate.basis.shape == (784, 40)


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"change": "rescale"}, "without change"),
        ({"normalisation": "white"}, "not with 'Scene4'"),
        ({"pooling": 3}, "pooling = 3 does not divide"),
    ],
)
def test_estimate_cannot_be_combined_with_other_options(
    source: Source, changes: dict[str, Any], reason: str
) -> None:
    with pytest.raises(TrainingError, match=reason):
        make_model(settings(**changes), source, CAMERA)
