"""Released forms: what they hide, that they come back with the key, and only with it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor
from typer.testing import CliRunner

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.masks import random_mask, to_levels, to_weights
from veilcam_optics.cli.main import app
from veilcam_optics.decoding import Decoder, SceneDecoding, SceneFrame, fit_statistics, write_frame
from veilcam_optics.decoding.release import ReleaseForm, Whitening, recover, release
from veilcam_optics.errors import OpticsError
from veilcam_optics.keys.epoch_names import EpochNames
from veilcam_optics.keys.masks import MaskDistribution, Secret, epoch_levels
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.transfer.operator import TransferOperator

CAMERA, SCENE, EMBEDDING = Camera(), Scene(10, 10), Embedding(6, 8)


def smooth_scenes(count: int, seed: int) -> Tensor:
    """Sums of a few random blobs, in [0, 1]."""
    generator = torch.Generator().manual_seed(seed)
    centres = 10 * torch.rand(count, 3, 2, generator=generator)
    grid = torch.arange(10.0)
    y = torch.exp(-((grid[:, None] - centres[..., None, None, 0]) ** 2) / 4)
    x = torch.exp(-((grid - centres[..., None, None, 1]) ** 2) / 4)
    return (y * x).sum(1).clamp(0, 1)


@pytest.fixture(scope="module")
def decoding() -> SceneDecoding:
    statistics = fit_statistics([smooth_scenes(3000, 0)], 60)
    return SceneDecoding(TransferOperator(CAMERA, SCENE, EMBEDDING), statistics)


def make(
    decoding: SceneDecoding, seed: int, count: int = 400
) -> tuple[Decoder, Whitening, Tensor, Tensor]:
    """Decoder and whitening of a random mask, scenes, and measurements of them behind that mask."""
    generator = torch.Generator().manual_seed(seed)
    levels = to_levels(random_mask(CAMERA, generator), CAMERA.panel)
    weights = to_weights(levels, CAMERA.panel)
    scenes = smooth_scenes(count, seed + 1000)
    measurements = shot_noise(decoding.operator.embed(scenes, weights), 40.0, generator)
    decoder = decoding.prepare(weights)
    return decoder, Whitening(decoder, levels), scenes, measurements


def test_none_releases_nothing(decoding: SceneDecoding) -> None:
    decoder, _whitening, _, measurements = make(decoding, 1)
    assert release(measurements, ReleaseForm.NONE, decoder) is None


def test_raw_is_the_measurement(decoding: SceneDecoding) -> None:
    decoder, _whitening, _, measurements = make(decoding, 1)
    raw = release(measurements, ReleaseForm.RAW, decoder)
    assert raw is not None
    assert torch.equal(raw, measurements)
    assert torch.equal(recover(raw, ReleaseForm.RAW, decoder), measurements)


def test_flat_has_neither_exposure_nor_mean(decoding: SceneDecoding) -> None:
    decoder, _whitening, _, measurements = make(decoding, 2)
    flat = release(measurements, ReleaseForm.FLAT, decoder)
    brighter = release(3 * measurements, ReleaseForm.FLAT, decoder)
    assert flat is not None
    assert brighter is not None
    assert torch.allclose(flat, brighter, atol=1e-6 * float(measurements.max()))
    assert float(flat.sum((1, 2)).abs().max()) < 1e-5 * float(measurements.sum((1, 2)).mean())
    assert float(flat.mean(0).norm()) < 0.2 * float(measurements.mean(0).norm())


def test_flat_comes_back_at_the_mean_exposure(decoding: SceneDecoding) -> None:
    decoder, _whitening, _, measurements = make(decoding, 2)
    flat = release(measurements, ReleaseForm.FLAT, decoder)
    assert flat is not None
    restored = recover(flat, ReleaseForm.FLAT, decoder)
    exposure = measurements.sum((1, 2), keepdim=True) / decoder.mean_measurement.sum()
    assert torch.allclose(restored, measurements / exposure, rtol=1e-5, atol=1e-7)


def test_white_is_white(decoding: SceneDecoding) -> None:
    decoder, whitening, _, measurements = make(decoding, 3, count=20_000)
    white = release(measurements, ReleaseForm.WHITE, decoder, whitening)
    assert white is not None
    flat = white.flatten(1).double()
    covariance = flat.T @ flat / len(flat)
    assert float(flat.mean(0).abs().max()) < 0.1
    assert float((covariance - torch.eye(EMBEDDING.size)).abs().max()) < 0.25
    # The raw measurements of the same mask are anything but.
    raw = measurements.flatten(1).double()
    correlation = torch.corrcoef(raw.T) - torch.eye(EMBEDDING.size)
    assert float(correlation.abs().max()) > 0.9


@pytest.mark.parametrize("form", [ReleaseForm.WHITE, ReleaseForm.RAW, ReleaseForm.FLAT])
def test_decodes_with_the_key_and_is_noise_without(
    decoding: SceneDecoding, form: ReleaseForm
) -> None:
    decoder, whitening, scenes, measurements = make(decoding, 4)
    other, other_whitening, _, _ = make(decoding, 5)
    released = release(measurements, form, decoder, whitening)
    assert released is not None
    exposure = measurements.sum((1, 2), keepdim=True) / decoder.mean_measurement.sum()
    wanted = scenes / exposure if form is ReleaseForm.FLAT else scenes
    right = decoder(recover(released, form, decoder, whitening))
    wrong = other(recover(released, form, other, other_whitening))
    spread = (wanted - decoder.mean.reshape(SCENE.shape)).square().mean()
    assert float((right - wanted).square().mean() / spread) < 0.2
    assert float((wrong - wanted).square().mean() / spread) > 0.8  # the mean scene has 1
    direct = (
        decoder(measurements) if form is not ReleaseForm.FLAT else decoder(measurements / exposure)
    )
    assert torch.allclose(right, direct, atol=2e-3)


def test_white_comes_back(decoding: SceneDecoding) -> None:
    decoder, whitening, _, measurements = make(decoding, 6)
    white = release(measurements, ReleaseForm.WHITE, decoder, whitening)
    assert white is not None
    restored = recover(white, ReleaseForm.WHITE, decoder, whitening)
    error = (restored - measurements).norm() / measurements.norm()
    assert float(error) < 1e-5
    again = release(measurements, ReleaseForm.WHITE, decoder, whitening)
    assert again is not None
    assert torch.allclose(white, again, atol=1e-5)


def test_mean_of_each_mask_is_gone(decoding: SceneDecoding) -> None:
    """Between masks, raw means differ by far more than the scatter; white ones do not."""
    means: dict[ReleaseForm, list[Tensor]] = {ReleaseForm.RAW: [], ReleaseForm.WHITE: []}
    scatter: dict[ReleaseForm, list[float]] = {ReleaseForm.RAW: [], ReleaseForm.WHITE: []}
    for seed in range(10, 16):
        decoder, whitening, _, measurements = make(decoding, seed)
        exposed = measurements / measurements.sum((1, 2), keepdim=True)
        for form, values in ((ReleaseForm.RAW, exposed), (ReleaseForm.WHITE, measurements)):
            released = release(values, form, decoder, whitening)
            assert released is not None
            means[form].append(released.mean(0).flatten())
            error = released.var(0).sum() / len(released)
            scatter[form].append(math.sqrt(float(error)))
    ratio = {
        form: float(torch.stack(means[form]).std(0).norm()) / max(scatter[form]) for form in means
    }
    assert ratio[ReleaseForm.RAW] > 5
    assert ratio[ReleaseForm.WHITE] < 1.5


def test_refuses_what_cannot_be_released(decoding: SceneDecoding) -> None:
    decoder, _whitening, _, measurements = make(decoding, 7, count=3)
    with pytest.raises(OpticsError, match=r"measurements\.shape"):
        release(measurements[:, :5], ReleaseForm.RAW, decoder)
    dark = torch.zeros_like(measurements)
    with pytest.raises(OpticsError, match="holds no light"):
        release(dark, ReleaseForm.FLAT, decoder)
    assert release(measurements[:0], ReleaseForm.FLAT, decoder) is not None
    with pytest.raises(OpticsError, match="needs the mask's whitening"):
        release(measurements, ReleaseForm.WHITE, decoder)
    with pytest.raises(OpticsError, match="needs the mask's whitening"):
        recover(measurements, ReleaseForm.WHITE, decoder)
    with pytest.raises(OpticsError, match="holds nothing to recover"):
        recover(measurements, ReleaseForm.NONE, decoder)


def test_whitening_shows_nothing_of_the_mask(decoding: SceneDecoding) -> None:
    decoder, whitening, _, _ = make(decoding, 8)
    assert repr(whitening) == "Whitening(embedding=Embedding(rows=6, columns=8))"
    assert "tensor" not in repr(decoder)


def make_frame(distribution: MaskDistribution | None) -> SceneFrame:
    return SceneFrame(
        CAMERA,
        SCENE,
        EMBEDDING,
        fit_statistics([smooth_scenes(3000, 0)], 60),
        distribution=distribution,
    )


@pytest.mark.slow
@pytest.mark.parametrize("exponent", [None, 4.0])
@pytest.mark.parametrize("form", ["white", "raw", "flat"])
def test_decode_on_the_command_line(
    decoding: SceneDecoding, tmp_path: Path, form: str, exponent: float | None
) -> None:
    distribution = None if exponent is None else MaskDistribution.power(CAMERA, exponent)
    frame, secret = make_frame(distribution), Secret.generate()
    write_frame(tmp_path / "frame.safetensors", frame)
    (tmp_path / "secret").write_text(secret.reveal().hex())
    (tmp_path / "secret").chmod(0o600)
    levels = epoch_levels(secret, "cam", 5, camera=CAMERA, distribution=distribution)
    weights = to_weights(levels, CAMERA.panel)
    scenes = smooth_scenes(60, 77)
    exposed = frame.decoding().prepare(weights)
    measurements = decoding.operator.embed(scenes, weights)
    wanted = scenes
    if form == "flat":
        wanted = scenes * exposed.mean_measurement.sum() / measurements.sum((1, 2), keepdim=True)
    released = release(measurements, ReleaseForm(form), exposed, Whitening(exposed, levels))
    assert released is not None
    np.save(tmp_path / "in.npy", released.numpy())

    def decoded(device: str, epoch: int | str) -> Tensor:
        command = [
            *("decode", str(tmp_path / "in.npy"), str(tmp_path / "out.npy"), "--form", form),
            *("--frame", str(tmp_path / "frame.safetensors"), "--device", device),
            *("--secret", str(tmp_path / "secret"), "--epoch", str(epoch)),
        ]
        result = CliRunner().invoke(app, command)
        assert result.exit_code == 0, result.output
        assert secret.reveal().hex()[:16] not in result.output
        return torch.from_numpy(np.load(tmp_path / "out.npy"))

    spread = (wanted - wanted.mean(0)).square().mean()
    assert float((decoded("cam", 5) - wanted).square().mean() / spread) < 0.2
    name = EpochNames(Secret.read(tmp_path / "secret"), "cam").name(5)
    assert torch.equal(decoded("cam", name), decoded("cam", 5))
    for device, epoch in (("cam", 6), ("other", 5), ("other", name)):
        assert float((decoded(device, epoch) - wanted).square().mean() / spread) > 0.8


def test_decode_says_what_is_wrong(tmp_path: Path) -> None:
    write_frame(tmp_path / "frame", make_frame(None))
    (tmp_path / "secret").write_text("0" * 64)
    (tmp_path / "secret").chmod(0o600)
    np.save(tmp_path / "good.npy", np.zeros((6, 8)))
    np.save(tmp_path / "bad.npy", np.full((6, 8), np.nan))
    np.save(tmp_path / "words.npy", np.array(["a"]))
    (tmp_path / "text.npy").write_text("no array")

    def run(released: str, **changes: str) -> str:
        options = {"frame": "frame", "secret": "secret", **changes}
        paths = {name: str(tmp_path / options.pop(name)) for name in ("frame", "secret")}
        options = {"device": "cam", "epoch": "1", **paths, **options}
        flat = [part for name, value in options.items() for part in (f"--{name}", value)]
        result = CliRunner().invoke(
            app, ["decode", str(tmp_path / released), str(tmp_path / "out.npy"), *flat]
        )
        assert result.exit_code != 0
        assert not (tmp_path / "out.npy").exists()
        return result.output

    assert "cannot be read" in run("missing.npy")
    assert "is not an array" in run("text.npy")
    assert "does not hold numbers" in run("words.npy")
    assert "holds NaN" in run("bad.npy")
    assert "form = whit is not valid: use white, flat or raw" in run("good.npy", form="whit")
    assert "holds nothing" in run("good.npy", form="none")
    assert "cannot be read" in run("good.npy", frame="nothing")
    (tmp_path / "secret").chmod(0o644)
    assert "chmod 600" in run("good.npy")
