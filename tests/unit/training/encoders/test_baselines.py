"""The simulated baselines are the optics that they claim to be."""

from __future__ import annotations

import pytest
import torch

from veilcam_optics.apertures import mls_cells
from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Sensor
from veilcam_optics.transfer.field_angle import fading
from veilcam_training.encoders import PsfEncoder, Setup
from veilcam_training.encoders import baselines as b
from veilcam_training.encoders.psf import Psf, point_transfer
from veilcam_training.seeding import stream

CAMERA, SCENE = Camera(), Scene()
SMALL = Camera(sensor=Sensor(rows=1520, columns=2028))


@pytest.mark.slow
@pytest.mark.parametrize("place", [(0, 0), (0, 27), (20, 5)])
def test_lens_shows_a_scene_pixel_inverted_where_geometry_says(place: tuple[int, int]) -> None:
    embedding = Embedding(152, 203)  # 31 um
    encoder = PsfEncoder(Setup(CAMERA, SCENE, embedding), b.lens_psf(CAMERA))
    scene = torch.zeros(1, 28, 28)
    scene[0, place[0], place[1]] = 1
    image = encoder(scene).reshape(embedding.shape)
    for axis, (index, count, side) in enumerate(
        zip(place, embedding.shape, (CAMERA.sensor.height, CAMERA.sensor.width), strict=True)
    ):
        weights = image.sum(1 - axis)
        seen = (weights * (torch.arange(count) - (count - 1) / 2)).sum() / weights.sum()
        expected = -(index - 13.5) * SCENE.pixel * b.LENS_DISTANCE / SCENE.distance
        assert float(seen) * side / count == pytest.approx(expected, abs=3e-6)
    assert int((image > 0.01 * image.max()).sum()) < 50


@pytest.mark.slow
def test_coded_aperture_casts_the_shadow_of_its_pattern() -> None:
    psf = b.coded_aperture_psf(CAMERA, SCENE)
    # Averaged over an opening and its fringes, the light is the pattern, magnified a little.
    rows, columns = psf.irradiance.shape[1:]
    magnification = 1 + b.APERTURE_DISTANCE / SCENE.distance
    pattern = mls_cells()
    place = (torch.arange(126) - 62.5) * b.APERTURE_FEATURE * magnification / psf.pitch
    y, x = ((place + (count - 1) / 2).round().long() for count in (rows, columns))
    middle = psf.irradiance.mean(0)
    mean = torch.nn.functional.avg_pool2d(middle[None], 5, 1, 2)[0]
    seen = mean[y[:, None], x]
    assert float(seen[pattern == 1].mean()) > 0.8
    assert float(seen[pattern == 0].mean()) < 0.15
    # And its light comes through the openings: none is made, none is lost.
    power = float(psf.irradiance.mean(0).sum()) * psf.pitch**2
    assert power == pytest.approx(float(pattern.sum()) * b.APERTURE_FEATURE**2, rel=0.02)


@pytest.mark.slow
def test_diffuser_makes_caustics_and_no_light() -> None:
    psf = b.diffuser_psf(CAMERA, SCENE, stream(0, "diffuser"))
    rows, columns = psf.irradiance.shape[1:]
    middle = psf.irradiance[:, rows // 4 : 3 * rows // 4, columns // 4 : 3 * columns // 4]
    assert float(middle.mean()) == pytest.approx(1, abs=0.08)
    contrast = float(middle[1].std() / middle[1].mean())
    assert contrast > 0.5


@pytest.mark.slow
def test_caustics_are_sharpest_where_the_sensor_is(monkeypatch: pytest.MonkeyPatch) -> None:
    contrast = {}
    for distance in (1e-3, 4e-3, 16e-3):
        monkeypatch.setattr(b, "DIFFUSER_DISTANCE", distance)
        irradiance = b.diffuser_psf(SMALL, SCENE, stream(0, "diffuser")).irradiance[1]
        rows, columns = irradiance.shape
        middle = irradiance[2 * rows // 5 : 3 * rows // 5, 2 * columns // 5 : 3 * columns // 5]
        contrast[distance] = float(middle.std() / middle.mean())
    assert max(contrast, key=contrast.__getitem__) == 4e-3


def test_point_binning_is_a_fine_area_measurement_at_the_same_place() -> None:
    """61 pixels side by side: the middle one is nearly a point."""
    psf = Psf(torch.rand(3, 90, 110, generator=stream(0, "psf"), dtype=torch.float64), 30e-6, 4e-3)
    scene, fine = Scene(rows=5, columns=6), Embedding(3 * 61, 4 * 61)
    setup = Setup(CAMERA, scene, fine, colour=True)
    matrix = PsfEncoder(setup, psf).transfer().reshape(3, 30, *fine.shape)
    middle = matrix[..., 30::61, 30::61].flatten(2)
    image = scene.pixel_at_sensor(CAMERA)
    point = point_transfer(psf, CAMERA.sensor, scene, Embedding(3, 4), image=image)
    point = point * torch.from_numpy(fading(scene)).reshape(-1, 1)
    torch.testing.assert_close(point.float(), middle, rtol=0.02, atol=0.01 * float(middle.max()))
