"""Every encoder is linear, noisy after the optics, and shows only what its device can."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from tests.pictures.samples import make_samples

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.errors import OpticsError
from veilcam_optics.transfer.grid import GridLight
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.regions import Region
from veilcam_training.encoders import (
    ENCODERS,
    FixedMask,
    LearnedMask,
    LinearEncoder,
    Psf,
    PsfEncoder,
    PsfFile,
    Setup,
    make_encoder,
    read_psf,
)
from veilcam_training.encoders.baselines import LENS_DISTANCE
from veilcam_training.errors import TrainingError
from veilcam_training.seeding import stream

# A part of the real sensor, so that the PSFs of the baselines are computed in no time.
CAMERA = Camera(sensor=Sensor(rows=760, columns=1014))
SCENE, EMBEDDING = Scene(rows=7, columns=9), Embedding(3, 4)
SETUP = Setup(CAMERA, SCENE, EMBEDDING)
CHOSEN_AT_RANDOM = {"diffuser", "fixed_simulated", "learned", "digital"}


@pytest.fixture(scope="module")
def psf_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("psf") / "psf.npz"
    psf = torch.rand(3, 60, 80, generator=stream(0, "psf")).numpy()
    np.savez(path, psf=psf, pitch=20e-6)
    return path


def fresh(
    name: str, psf: Path | None, seed: int = 0, *, colour: bool = False, point: bool = False
) -> LinearEncoder:
    setup = Setup(CAMERA, SCENE, EMBEDDING, colour=colour, point_binning=point)
    file = None if psf is None or name != "fixed_measured" else PsfFile(psf)
    return make_encoder(name, setup, stream(seed, "encoder"), psf=file)


make = cache(fresh)  # for tests that do not change it


def scenes(colour: bool) -> torch.Tensor:
    shape = (5, 3, 7, 9) if colour else (5, 7, 9)
    return torch.rand(shape, generator=stream(1, "scenes"))


@pytest.mark.thorough
@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("name", ENCODERS)
def test_contract(name: str, colour: bool, psf_file: Path) -> None:
    encoder, x = make(name, psf_file, colour=colour), scenes(colour)
    v = encoder(x)
    assert v.shape == (5, encoder.setup.outputs)
    assert encoder.setup.outputs == (36 if colour else 12)
    assert encoder.transfer().shape == encoder.setup.matrix_shape
    torch.testing.assert_close(encoder(0.5 * x), 0.5 * v)  # linear
    assert encoder.trainable == (sum(p.numel() for p in encoder.parameters()) > 0)
    if name != "digital":
        assert float(v.detach().min()) >= 0
    # The same seed gives the same camera, another seed another one, where there is a choice.
    torch.testing.assert_close(fresh(name, psf_file, colour=colour)(x), v, rtol=0, atol=0)
    other = fresh(name, psf_file, 1, colour=colour)
    assert torch.equal(other(x), v) != (name in CHOSEN_AT_RANDOM)
    # A state that is saved and loaded is the same camera.
    other.load_state_dict(encoder.state_dict())
    torch.testing.assert_close(other(x), v, rtol=0, atol=0)


@pytest.mark.slow
@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("name", ENCODERS)
def test_part_of_the_scene(name: str, colour: bool, psf_file: Path) -> None:
    encoder = make(name, psf_file, colour=colour)
    whole = torch.zeros_like(scenes(colour))
    whole[..., 2:6, 3:8] = scenes(colour)[..., 2:6, 3:8]
    part = Region(2, 3, 4, 5)
    inside = whole[..., 2:6, 3:8]
    torch.testing.assert_close(encoder(inside, part), encoder(whole))
    with pytest.raises(OpticsError, match="a part of the scene's 7 x 9 pixels"):
        encoder.transfer(Region(4, 3, 4, 5))
    with pytest.raises(OpticsError, match="a part of the scene's"):
        encoder.transfer(Region(-1, 3, 4, 5))


@pytest.mark.parametrize("name", ENCODERS)
@pytest.mark.parametrize("snr_db", [10.0, 40.0])
def test_noise_has_its_ratio_after_the_optics(name: str, snr_db: float, psf_file: Path) -> None:
    encoder = make(name, psf_file)
    v = encoder(scenes(colour=False)).detach()
    generator = stream(0, "noise")
    copies = v.repeat(4000, 1)
    draws = (encoder.add_noise(copies, snr_db, generator) - copies).reshape(4000, *v.shape)
    delivered = 10 * torch.log10(v.square().sum(1) / draws.square().sum(2).mean(0))
    torch.testing.assert_close(delivered, torch.full_like(delivered, snr_db), rtol=0, atol=0.3)
    # Not on the scene: every pixel that has light has noise of its own.
    lit = v[0] != 0
    relation = torch.corrcoef(draws[:, 0, lit].T) - torch.eye(int(lit.sum()))
    assert float(relation.abs().max()) < 0.1


@pytest.mark.parametrize("name", [name for name in ENCODERS if name != "digital"])
def test_point_binning_is_another_measurement(name: str, psf_file: Path) -> None:
    with torch.no_grad():
        area = make(name, psf_file).transfer()
        point = make(name, psf_file, point=True).transfer()
        assert area.shape == point.shape
        assert float((area - point).norm() / area.norm()) > 0.02


@pytest.mark.parametrize("name", ["learned", "fixed_simulated"])
def test_masks_transfer_what_the_panel_shows(name: str) -> None:
    encoder = make(name, None)
    assert isinstance(encoder, LearnedMask | FixedMask)
    levels = encoder.levels()
    assert levels.dtype == np.uint8
    assert levels.shape == CAMERA.mask_shape
    assert len(np.unique(levels)) == CAMERA.panel.levels
    shown = TransferOperator(CAMERA, SCENE, EMBEDDING)(
        torch.from_numpy(to_weights(levels, CAMERA.panel))
    )
    torch.testing.assert_close(encoder.transfer(), shown)


def test_mask_that_starts_from_a_pinhole_forms_an_image() -> None:
    setup = Setup(Camera(), Scene(), Embedding())
    scene = torch.zeros(2, 28, 28)
    scene[0, :4, :4], scene[1, -4:, -4:] = 1, 1
    encoder = make_encoder("learned", setup, stream(0, "encoder"), pinhole=True)
    assert isinstance(encoder, LearnedMask)
    assert np.max(encoder.levels()) == CAMERA.panel.levels - 1
    assert float(encoder.weights.detach().min()) >= encoder.closed
    first, second = encoder(scene).detach().reshape(2, 24, 32)
    # The other way up and round, as any pinhole shows it.
    assert divmod(int(first.argmax()), 32) > divmod(int(second.argmax()), 32)
    assert float((first * second).sum() / (first.norm() * second.norm())) < 0.5
    with pytest.raises(TrainingError, match="learns no mask: leave out mask_start"):
        make_encoder("fixed_simulated", setup, stream(0, "encoder"), pinhole=True)


def test_no_weight_dies() -> None:
    """Weights driven far out of range come back to it, and every one still has a gradient."""
    encoder = fresh("learned", None)
    assert isinstance(encoder, LearnedMask)
    values = encoder.weights
    with torch.no_grad():
        values.add_(torch.randn(values.shape, generator=stream(0, "change")) * 5)
    encoder.project()
    low, high = values == encoder.closed, values == 1
    assert int(low.sum()) > 200
    assert int(high.sum()) > 200
    signs = torch.randn(5, 12, generator=stream(0, "signs"))
    (encoder(scenes(colour=False)) * signs).sum().backward()
    gradient = values.grad
    assert gradient is not None
    assert bool((gradient != 0).all())
    with torch.no_grad():
        values.sub_(1e-2 * gradient.sign())
    encoder.project()
    for bound, leaves in ((low, gradient < 0), (high, gradient > 0)):
        moved = (values > encoder.closed) & (values < 1)
        assert bool((moved[bound] == leaves[bound]).all())
        assert bool(moved[bound].any())


def test_gradient_is_the_slope_of_the_unrounded_mask() -> None:
    """Straight-through: what rounding hides is seen by a panel with very many levels."""
    fine = Camera(sensor=CAMERA.sensor, panel=Panel(levels=256))
    gradients = []
    for camera in (CAMERA, fine):
        encoder = LearnedMask(Setup(camera, SCENE, EMBEDDING), stream(0, "encoder"))
        (encoder(scenes(colour=False)) * torch.arange(12)).sum().backward()
        assert encoder.weights.grad is not None
        gradients.append(encoder.weights.grad)
    assert float((gradients[0] - gradients[1]).norm() / gradients[1].norm()) < 0.03
    # And that slope is what a finite difference gives.
    step, values = 0.2, encoder.weights.detach()
    row, column = divmod(int(values.sub(0.5).abs().argmin()), values.shape[1])
    measurements = []
    for change in (step, -step):
        with torch.no_grad():
            encoder.weights[row, column] += change
            measurements.append((encoder.eval()(scenes(colour=False)) * torch.arange(12)).sum())
            encoder.weights[row, column] -= change
    slope = (measurements[0] - measurements[1]) / (2 * step)
    torch.testing.assert_close(slope, gradients[1][row, column], rtol=2e-2, atol=1e-5)


def test_closed_sub_pixel_is_closed_when_it_counts() -> None:
    encoder = fresh("learned", None)
    assert isinstance(encoder, LearnedMask)
    with torch.no_grad():
        encoder.weights.zero_()
        assert float(encoder.train()(scenes(colour=False)).max()) > 0
        assert float(encoder.eval()(scenes(colour=False)).abs().max()) == 0
    assert not encoder.levels().any()


@pytest.mark.slow
@pytest.mark.parametrize("point", [False, True])
def test_psf_and_transfer_operator_agree(point: bool) -> None:
    """Two routes to one camera: the operator, and the PSF of the grid path."""
    mask = fresh("fixed_simulated", None, point=point)
    assert isinstance(mask, FixedMask)
    light = GridLight(CAMERA, SCENE, oversampling=4)
    psf = light.psf(torch.from_numpy(to_weights(mask.levels(), CAMERA.panel)).double())
    spread = Psf(psf, float(light.grid.pitch_y), CAMERA.distance)
    other = PsfEncoder(mask.setup, spread).transfer()
    error = (other - mask.transfer()).norm() / mask.transfer().norm()
    assert float(error) < 0.03
    file_like = Psf(psf.flip(1), spread.pitch, spread.distance)
    wrong = PsfEncoder(mask.setup, file_like).transfer()
    assert float((wrong - mask.transfer()).norm() / mask.transfer().norm()) > 0.1


def test_unknown_encoder_and_psf_that_is_not_wanted(psf_file: Path) -> None:
    with pytest.raises(TrainingError, match="use one of lens, coded_aperture"):
        fresh("pinhole", None)
    with pytest.raises(TrainingError, match="leave out --psf"):
        make_encoder("learned", SETUP, stream(0, "encoder"), psf=PsfFile(psf_file))
    with pytest.raises(TrainingError, match="give --psf FILE"):
        fresh("fixed_measured", None)


@pytest.mark.parametrize("name", ["lens", "coded_aperture", "diffuser", "fixed_measured"])
def test_measured_psf_takes_the_place_of_a_simulated_one(name: str, psf_file: Path) -> None:
    """A measured lens stands where the ideal one does, if nobody says otherwise."""
    for distance in (2e-3, None) if name == "lens" else (2e-3,):
        file = PsfFile(psf_file, distance=distance)
        made = make_encoder(name, SETUP, stream(0, "encoder"), psf=file)
        wanted = PsfEncoder(SETUP, read_psf(file, LENS_DISTANCE if distance is None else math.nan))
        torch.testing.assert_close(made.transfer(), wanted.transfer(), rtol=0, atol=0)


def test_measured_psf_of_one_channel_and_of_another_distance(tmp_path: Path) -> None:
    path = tmp_path / "psf.npz"
    psf = np.ones((5, 6))
    np.savez(path, psf=psf, pitch=1e-5)
    assert read_psf(PsfFile(path), 4e-3).distance == 4e-3
    assert read_psf(PsfFile(path, distance=3e-3), 4e-3).distance == 3e-3
    assert read_psf(PsfFile(path), 4e-3).irradiance.shape == (3, 5, 6)
    with pytest.raises(TrainingError, match="leave out --psf-pitch"):
        read_psf(PsfFile(path, pitch=1e-5), 4e-3)
    np.savez(path, psf=psf, pitch=1e-5, distance=2e-3)
    assert read_psf(PsfFile(path), 4e-3).distance == 2e-3
    with pytest.raises(TrainingError, match="leave out --psf-distance"):
        read_psf(PsfFile(path, distance=3e-3), 4e-3)


@pytest.mark.parametrize("kind", [".npy", ".png", ".tif"])
@pytest.mark.parametrize(
    ("shape", "dtype"), [((5, 6), np.uint8), ((5, 6), np.uint16), ((5, 6, 3), np.uint8)]
)
def test_pictures_and_arrays_are_psfs_with_a_pitch(
    tmp_path: Path, kind: str, shape: tuple[int, ...], dtype: type[np.unsignedinteger[Any]]
) -> None:
    top = np.iinfo(dtype).max
    shown = np.random.default_rng(1).integers(0, top, shape, endpoint=True).astype(dtype)
    path = tmp_path / f"psf{kind}"
    if kind == ".npy":
        np.save(path, shown)
    else:
        Image.fromarray(shown).save(path)
    found = read_psf(PsfFile(path, 1e-5), 4e-3)
    wanted = np.broadcast_to(shown, (3, 5, 6)) if len(shape) == 2 else np.moveaxis(shown, 2, 0)
    assert np.array_equal(found.irradiance.numpy(), wanted)
    assert (found.pitch, found.distance) == (1e-5, 4e-3)
    with pytest.raises(TrainingError, match="give --psf-pitch METRES"):
        read_psf(PsfFile(path), 4e-3)


def test_psf_in_a_picture_is_read_by_the_one_reader_of_pictures(tmp_path: Path) -> None:
    bright = np.linspace(0, 60_000, 48).reshape(6, 8).astype(np.uint16)
    for name, shown, warned in (("bright", bright, False), ("dark", bright // 16, True)):
        Image.fromarray(shown).save(tmp_path / f"{name}.tif")
        found = read_psf(PsfFile(tmp_path / f"{name}.tif", 1e-5), 4e-3)
        assert np.array_equal(found.irradiance[0].numpy(), shown)
        assert (found.warning is not None) == warned
    deep = next(each for each in make_samples() if each.name == "deep-colour.png")
    for content, reason in ((deep.content, "16 bits a channel"), (deep.content[:60], "damaged")):
        (tmp_path / "psf.png").write_bytes(content)
        with pytest.raises(TrainingError, match=rf"psf\.png .*{reason}"):
            read_psf(PsfFile(tmp_path / "psf.png", 1e-5), 4e-3)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (None, "missing"),
        ({}, "not the file of a PSF"),
        ({"psf": np.ones((5, 6))}, "not the file of a PSF"),
        ({"psf": np.ones((2, 5, 6)), "pitch": 1e-5}, r"use \(3, rows, columns\)"),
        *(
            ({"psf": np.full((5, 6), value), "pitch": 1e-5}, "no irradiance")
            for value in (0, -1, np.nan)
        ),
        *(({"psf": np.ones((5, 6)), "pitch": pitch}, "use metres") for pitch in (-1.0, 12.4)),
        (b"PK\x03\x04", "not the file of a PSF"),
        ({"psf": np.array([object()]), "pitch": 1e-5}, "not the file of a PSF"),
    ],
)
def test_files_of_no_psf(
    tmp_path: Path, content: dict[str, Any] | bytes | None, reason: str
) -> None:
    path = tmp_path / "psf.npz"
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        np.savez(path, **content)
    with pytest.raises(TrainingError, match=reason) as caught:
        read_psf(PsfFile(path), 4e-3)
    assert "\n" not in str(caught.value)
