"""Boxes of an embedding: the driver averages raw pixels as the optics average light."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
import torch
from tests.unit.server.devices.clock import Clock

from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Sensor, Window
from veilcam_optics.camera.masks import random_mask
from veilcam_optics.effects import Model, Sampling
from veilcam_optics.simulation.operator import LightOperator
from veilcam_server.devices import SensorError
from veilcam_server.devices.base import Measurement
from veilcam_server.devices.imx477 import DRIVER
from veilcam_server.devices.raw import SensorMode
from veilcam_server.devices.simulated.device import Conditions, simulated_device
from veilcam_server.devices.simulated.light import planned_light

SCENE = Scene(6, 5, height=0.026)
ROWS, COLUMNS = 3, 4
NOISE = 1e-2
"""Relative, of a measurement of 40 dB: what a decoder cannot tell apart."""


def camera(rows: int, columns: int) -> Camera:
    """A camera whose embedding pixels are as wide as those of 24 x 32 values: 196 um."""
    return Camera(
        window=Window(rows=9, columns=5), sensor=Sensor(rows, columns, ROWS * 196e-6 / rows)
    )


def seen(camera: Camera, embedding: Embedding) -> npt.NDArray[np.float64]:
    """Return the measurement of one scene, (3, rows, columns), by the transfer."""
    generator = torch.Generator().manual_seed(2)
    weights, scene = random_mask(camera, generator), torch.rand(1, 30, generator=generator)
    model = Model(camera, SCENE, embedding, sampling=Sampling(dtype=torch.float64))
    light = scene.double() @ LightOperator(model, colour=True)(weights.double())
    measured: npt.NDArray[np.float64] = light.reshape(3, *embedding.shape).numpy()
    return measured


def read(frame: npt.NDArray[np.float64], shape: tuple[int, ...], fill: float) -> Measurement:
    """Return what the driver makes of light on raw pixels, at the most exposure there can be."""
    mode, clock = SensorMode(frame.shape[0], frame.shape[1], 0.0, 0.0), Clock()
    full_scale = 1.01 * float(frame.max())
    counts = frame / full_scale * (mode.white_level - mode.black_level) + mode.black_level
    assert DRIVER.emulate is not None
    start, _ = DRIVER.emulate(
        *(lambda begin, end: counts.round().astype(np.uint16), mode),
        shape=shape,
        fill=fill,
        exposure=0.01,
        full_scale=full_scale,
        clock=clock,
        sleep=clock.sleep,
    )
    return start().capture(0.0, 1.0).embedding


def difference(one: npt.NDArray[np.float32], other: npt.NDArray[np.float64]) -> float:
    return float(np.linalg.norm(one - other) / np.linalg.norm(other))


@pytest.mark.parametrize(
    ("rows", "columns", "beside"),
    [(190, 254, 1.0), (189, 252, 1.0), (192, 256, 1.5), (380, 507, 1.0)],
)
@pytest.mark.parametrize("fill", [1.0, 0.5, 0.2, 0.1])
def test_driver_and_transfer_average_the_same_boxes(
    fill: float, rows: int, columns: int, beside: float
) -> None:
    """Of 63 1/3 raw pixels, as the real sensor has, an odd number, an even one, and of 127.

    A colour's pixels are two apart, so that what is read of it lies up to half a raw pixel beside
    the box: less than the noise, unless it is so at every box, as of an even number.
    """
    built = camera(rows, columns)
    planes = seen(built, Embedding(rows, columns))
    expected = seen(built, Embedding(ROWS, COLUMNS, fill))
    mosaic = planes[1].copy()
    mosaic[::2, ::2], mosaic[1::2, 1::2] = planes[0, ::2, ::2], planes[2, 1::2, 1::2]
    assert difference(read(mosaic, (3, ROWS, COLUMNS), fill), expected) < beside * NOISE
    gray = np.einsum("c,cyx->yx", np.array(built.sensor.channel_weights), expected)
    assert difference(read(mosaic, (ROWS, COLUMNS), fill), gray) < beside * NOISE
    if fill < 1:
        assert difference(read(mosaic, (ROWS, COLUMNS), 1.0), gray) > 2 * NOISE


@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("fill", [1.0, 0.2, 0.1])
def test_simulated_device_measures_what_the_transfer_says(fill: float, colour: bool) -> None:
    built, embedding = camera(192, 256), Embedding(ROWS, COLUMNS, fill)
    clock, image = Clock(), np.random.default_rng(1).random((3, *SCENE.shape), np.float32)
    image = image if colour else image[0]

    class Still:
        def read(self) -> npt.NDArray[np.float32]:
            return image

    def captured(snr_db: float, count: int = 1) -> list[Measurement]:
        device = simulated_device(
            *(planned_light(built, SCENE, embedding, colour=colour), Still()),
            camera=built,
            embedding=embedding,
            conditions=Conditions(settle=0.0, snr_db=snr_db),
            seed=1,
            clock=clock,
            sleep=clock.sleep,
        )
        levels = np.random.default_rng(3).integers(0, 64, built.mask_shape).astype(np.uint8)
        device.display.show(levels)
        clock.sleep(1.0)
        found = [device.sensor.capture(clock.now, 5.0).embedding for _ in range(count)]
        device.close()
        weights = torch.from_numpy(levels / 63)
        model = Model(built, SCENE, embedding, sampling=Sampling(dtype=torch.float64))
        transfer = LightOperator(model, colour=colour)(weights).numpy()
        light = np.einsum("cp,cpe->ce", image.reshape(-1, 30), transfer.reshape(-1, 30, 12))
        assert difference(found[0], light.reshape(found[0].shape)) < max(NOISE, 2 * noise(snr_db))
        return found

    clean = captured(np.inf)[0]
    noisy = captured(30.0, 40)
    off = np.sqrt(np.mean([difference(each, clean.astype(np.float64)) ** 2 for each in noisy]))
    assert 0.8 < off / noise(30.0) < 1.2


def noise(snr_db: float) -> float:
    return 10 ** (-snr_db / 20)


def test_box_smaller_than_four_raw_pixels_is_refused() -> None:
    """A driver says what to change; it does not average other pixels instead."""
    frame = np.ones((30, 40))
    with pytest.raises(
        SensorError, match=r"too coarse for this bundle: 3 boxes of fill 0.1 .* larger"
    ):
        read(frame, (3, 4), 0.1)
