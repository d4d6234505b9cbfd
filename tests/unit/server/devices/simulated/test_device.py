"""The simulated device: light alone couples panel and sensor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from structlog.testing import capture_logs
from tests.unit.server.devices.clock import Clock

from veilcam_client.wire.simulation import Faults, LightFaults, PanelFaults
from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Window
from veilcam_optics.camera.imperfections import NOMINAL, Imperfections
from veilcam_optics.camera.imperfections import Conditions as Optical
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.effects import Model, Sampling
from veilcam_optics.plan import Plan, plan
from veilcam_optics.propagation.sampling import area_average
from veilcam_optics.simulation.operator import LightOperator, Response
from veilcam_optics.transfer.tables import Reach
from veilcam_server.devices import SensorError
from veilcam_server.devices.base import Measurement
from veilcam_server.devices.simulated.device import Conditions, simulated_device
from veilcam_server.devices.simulated.light import (
    DECODERS_TOLERANCE,
    TOLERANCE,
    Light,
    planned_light,
    raw_shape,
)
from veilcam_server.devices.simulated.scenes import REMEMBERED, FileScene, write_scene

CAMERA = Camera(panel=Panel(), window=Window(rows=9, columns=5))
SCENE, EMBEDDING = Scene(5, 5), Embedding(4, 5)
RNG = np.random.default_rng(5)
QUIET = Conditions(snr_db=np.inf)
OLD, NEW = (RNG.integers(0, 64, CAMERA.mask_shape).astype(np.uint8) for _ in range(2))


class Still:
    """A scene that does not change."""

    def __init__(self, image: Measurement | None = None) -> None:
        self.image = RNG.random((28, 28), np.float32) if image is None else image

    def read(self) -> npt.NDArray[np.float32]:
        return self.image


class Shadow:
    """Light that takes no time: each raw pixel gets what passes the part of the mask above it."""

    def response(self, weights: torch.Tensor) -> Response:
        return (weights.square().double(),)

    def collect(self, scenes: torch.Tensor, response: Response) -> torch.Tensor:
        shadow = area_average(response[0], *raw_shape(EMBEDDING))
        return scenes.double().mean((1, 2))[:, None, None] * shadow


SHADOW = Shadow()


@pytest.fixture(scope="module")
def light() -> Light:
    return planned_light(CAMERA, Scene(), EMBEDDING)


class Simulation:
    """A display and a sensor on one clock, without noise unless asked for."""

    def __init__(
        self,
        light: Light,
        conditions: Conditions = QUIET,
        *,
        seed: int | None = 1,
        scene: Measurement | None = None,
    ) -> None:
        self.clock, self.scene, self.light = Clock(), Still(scene), light
        device = simulated_device(
            light,
            self.scene,
            camera=CAMERA,
            embedding=EMBEDDING,
            conditions=conditions,
            seed=seed,
            clock=self.clock,
            sleep=self.sleep,
        )
        self.device, self.display, self.sensor = device, device.display, device.sensor
        self.during: Callable[[], None] = lambda: None

    def sleep(self, seconds: float) -> None:
        awake = self.clock.now + seconds
        self.clock.sleep(seconds / 2)
        self.during()
        self.clock.now = awake

    def seen(self, levels: npt.NDArray[np.uint8]) -> Measurement:
        response = self.light.response(torch.from_numpy(to_weights(levels, CAMERA.panel)))
        raw = self.light.collect(torch.from_numpy(self.scene.image)[None], response)[0]
        return area_average(raw, *EMBEDDING.shape).numpy().astype(np.float32)

    def capture(self, after: float = 1.0) -> Measurement:
        return self.sensor.capture(self.clock.now + after, 5.0).embedding


def difference(one: Measurement, other: Measurement) -> float:
    """Relative L2."""
    return float(np.linalg.norm(one - other) / np.linalg.norm(other))


ROUNDING = 2e-3
"""Relative: the converter has 12 bits."""


def test_sensor_sees_the_scene_through_the_mask(light: Light) -> None:
    simulation = Simulation(light)
    simulation.display.show(NEW)
    assert difference(simulation.capture(), simulation.seen(NEW)) < ROUNDING
    simulation.scene.image = simulation.scene.image[::-1].copy()
    assert difference(simulation.capture(), simulation.seen(NEW)) < ROUNDING
    assert difference(simulation.capture(), simulation.seen(OLD)) > 0.1


BUILT_BADLY = Imperfections(gamma=1.5, shift_y=3e-5, dead_rows=(2,), dead_transmittance=1.0)


@pytest.mark.parametrize("imperfections", [NOMINAL, BUILT_BADLY])
def test_light_is_within_its_predicted_error(imperfections: Imperfections) -> None:
    embedding, weights = Embedding(3, 4), torch.from_numpy(to_weights(NEW, CAMERA.panel))
    with capture_logs() as logs:
        light = planned_light(CAMERA, SCENE, embedding, imperfections)
    assert [each["event"] for each in logs] == ["simulated light"]
    sampling = Sampling(reach=Reach(3, 1), zones=3, step=8e-7, dtype=torch.float64)
    fine = Model(CAMERA, SCENE, embedding, Optical(imperfections=imperfections), sampling)
    points = torch.eye(25).reshape(25, 5, 5)
    seen = area_average(light.collect(points, light.response(weights)).double(), 3, 4).flatten(1)
    error = difference(seen.numpy(), LightOperator(fine)(weights).numpy())
    assert error < logs[0]["predicted_error"] < DECODERS_TOLERANCE


@pytest.mark.parametrize("imperfections", [NOMINAL, BUILT_BADLY])
def test_sensor_in_colour_gives_the_channels_of_the_transfer(imperfections: Imperfections) -> None:
    scene = RNG.random((3, *SCENE.shape), np.float32)
    simulation = Simulation(
        planned_light(CAMERA, SCENE, EMBEDDING, imperfections, colour=True), scene=scene
    )
    simulation.display.show(NEW)
    model = Model(CAMERA, SCENE, EMBEDDING, Optical(imperfections=imperfections))
    transfer = LightOperator(model, colour=True)(torch.from_numpy(to_weights(NEW, CAMERA.panel)))
    expected = np.einsum("cp,cpe->ce", scene.reshape(3, -1), transfer.numpy())
    seen = simulation.capture()
    assert seen.shape == (3, *EMBEDDING.shape)
    for channel in range(3):
        assert difference(seen[channel].ravel(), expected[channel]) < ROUNDING + DECODERS_TOLERANCE


def test_noise_in_colour_has_the_ratio_asked_for() -> None:
    light = planned_light(CAMERA, SCENE, EMBEDDING, colour=True)
    scene = RNG.random((3, *SCENE.shape), np.float32)
    quiet, noisy = (
        Simulation(light, replace(QUIET, snr_db=snr_db), scene=scene) for snr_db in (np.inf, 40.0)
    )
    for simulation in (quiet, noisy):
        simulation.display.show(NEW)
    clean = quiet.capture()
    noise = np.stack([noisy.capture() for _ in range(50)]) - clean
    ratio = 10 * np.log10(np.square(clean).sum() / np.square(noise).sum((1, 2, 3)).mean())
    assert ratio == pytest.approx(40.0, abs=0.5)


def test_light_that_takes_long_is_as_coarse_as_a_decoders(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[float] = []

    def planned(*where: Any, **how: Any) -> Plan:
        asked.append(where[3])
        return plan(*where, **how)

    monkeypatch.setattr("veilcam_server.devices.simulated.light.plan", planned)
    planned_light(CAMERA, SCENE, EMBEDDING)
    planned_light(Camera(), Scene(), Embedding())
    assert asked == [TOLERANCE, TOLERANCE, DECODERS_TOLERANCE]


def test_opaque_panel_lets_no_light_through() -> None:
    simulation = Simulation(SHADOW, replace(QUIET, snr_db=40.0))
    simulation.display.show(NEW)
    simulation.display.blank()
    assert not simulation.capture().any()


def test_exposure_sees_the_scene_that_was_there_when_it_began() -> None:
    simulation = Simulation(SHADOW)
    scenes = simulation.device.scenes
    assert scenes is not None
    simulation.display.show(NEW)
    dark, white = np.zeros((28, 28), np.float32), np.ones((28, 28), np.float32)

    def hold(*pictures: Measurement) -> None:
        for picture in pictures:
            scenes.hold(picture)

    first = simulation.capture()
    # Held up, and another one, while the sensor collects light.
    simulation.during = lambda: hold(dark, white)
    assert difference(simulation.capture(after=0.0), first) == 0
    assert scenes.seen == 0
    simulation.during = lambda: None
    assert difference(simulation.capture(), first / simulation.scene.image.mean()) < ROUNDING
    assert scenes.seen == 2
    # Before the exposure, while the sensor waits for the mask to settle: a whole exposure follows.
    simulation.during = lambda: hold(dark)
    assert not simulation.capture().any()
    assert scenes.seen == 3
    # More than is remembered: what was seen cannot be told any more, so nothing is.
    simulation.during = lambda: hold(*[dark] * REMEMBERED)
    with pytest.raises(SensorError, match="more than 15 times during one exposure"):
        simulation.capture(after=0.0)


def test_exposure_while_the_crystal_turns_mixes_two_masks() -> None:
    simulation = Simulation(SHADOW, replace(QUIET, settle=0.1))
    simulation.display.show(OLD)
    simulation.clock.sleep(1)
    simulation.display.show(NEW)
    mixed = simulation.capture(after=0.05)
    assert difference(mixed, simulation.seen(OLD)) > 0.02
    assert difference(mixed, simulation.seen(NEW)) > 0.02
    assert difference(simulation.capture(after=0.1), simulation.seen(NEW)) < ROUNDING


def test_until_the_scan_has_passed_the_old_mask_is_shown() -> None:
    simulation = Simulation(SHADOW, replace(QUIET, settle=0.0, scan=0.5, exposure=0.001))
    simulation.display.show(OLD)
    simulation.clock.sleep(1)
    simulation.display.show(NEW)
    early = simulation.capture(after=0.0)
    assert difference(early, simulation.seen(NEW)) > ROUNDING
    assert difference(simulation.capture(after=0.5), simulation.seen(NEW)) < ROUNDING


def test_mask_that_changes_within_the_exposure_mixes() -> None:
    simulation = Simulation(SHADOW, replace(QUIET, settle=0.0))
    simulation.display.show(OLD)
    simulation.clock.sleep(1.0)
    changed: list[float] = []

    def interrupt() -> None:
        if not changed:
            changed.append(simulation.display.show(NEW).completed_at)

    simulation.during = interrupt
    exposure = simulation.sensor.capture(simulation.clock.now, 5.0)
    assert exposure.started_at < changed[0] < exposure.ended_at
    assert difference(exposure.embedding, simulation.seen(OLD)) > 0.02
    assert difference(exposure.embedding, simulation.seen(NEW)) > 0.02


def test_sensor_waits_as_long_as_it_was_told() -> None:
    simulation = Simulation(SHADOW, replace(QUIET, exposure=0.02))
    exposure = simulation.sensor.capture(simulation.clock.now + 0.3, 5.0)
    assert exposure.started_at == pytest.approx(100.3)
    assert exposure.ended_at == pytest.approx(100.32)


def test_noise_has_the_ratio_asked_for_at_the_embedding() -> None:
    simulation = Simulation(SHADOW, replace(QUIET, snr_db=40.0))
    simulation.display.show(NEW)
    clean = simulation.seen(NEW)
    noise = np.stack([simulation.capture() for _ in range(100)]) - clean
    ratio = 10 * np.log10(np.square(clean).sum() / np.square(noise).sum((1, 2)).mean())
    assert ratio == pytest.approx(40.0, abs=0.5)


def test_seed_fixes_the_noise() -> None:
    def measurement(seed: int | None) -> Measurement:
        simulation = Simulation(SHADOW, replace(QUIET, snr_db=40.0), seed=seed)
        simulation.scene.image = np.full((28, 28), 0.5, np.float32)
        simulation.display.show(NEW)
        return simulation.capture()

    assert np.array_equal(measurement(1), measurement(1))
    assert not np.array_equal(measurement(1), measurement(2))
    assert not np.array_equal(measurement(None), measurement(None))


def test_light_warms_up() -> None:
    simulation = Simulation(SHADOW, replace(QUIET, settle=0.0, warm_up=0.2, warm_up_time=10.0))
    simulation.display.show(NEW)
    expected = simulation.seen(NEW).mean()
    assert simulation.capture(after=0.0).mean() / expected == pytest.approx(0.8, abs=0.01)
    assert simulation.capture(after=10.0).mean() / expected == pytest.approx(0.926, abs=0.01)
    assert simulation.capture(after=100.0).mean() / expected == pytest.approx(1.0, abs=0.01)


@pytest.mark.slow
def test_light_comes_past_the_mask_as_a_share_of_the_open_window() -> None:
    simulation = Simulation(SHADOW)
    assert simulation.device.set_faults is not None
    simulation.display.show(np.full(CAMERA.mask_shape, 63, np.uint8))
    opened = simulation.capture().mean()
    simulation.device.set_faults(Faults(light=LightFaults(bypass=0.1)))
    simulation.display.blank()
    assert simulation.capture().mean() == pytest.approx(0.1 * opened, rel=1e-2)


def test_transparent_panel_lets_light_through_all_over_the_glass() -> None:
    simulation = Simulation(SHADOW)
    assert simulation.device.set_faults is not None
    opened = 0.0
    # In the light of a hundredth, as all of the glass saturates the sensor.
    for panel in (PanelFaults(), PanelFaults(dead=True), PanelFaults(open_window=True)):
        simulation.device.set_faults(Faults(panel=panel, light=LightFaults(lamp=0.01)))
        simulation.display.show(np.full(CAMERA.mask_shape, 63, np.uint8))
        seen = simulation.capture().mean()
        window = CAMERA.window.rows * CAMERA.panel.pitch_y
        window *= CAMERA.window.columns * CAMERA.panel.pitch_x
        whole = CAMERA.sensor.height * CAMERA.sensor.width / window
        opened = opened or seen
        assert seen == pytest.approx(opened * (whole if panel.dead else 1), rel=0.05)


def test_lamp_that_is_switched_within_an_exposure_lights_a_part_of_it() -> None:
    simulation = Simulation(SHADOW, replace(QUIET, exposure=0.02))
    simulation.display.show(NEW)
    lit = simulation.capture().mean()

    def switched() -> None:
        assert simulation.device.set_faults is not None
        # The clock of this simulation is half-way through its sleep to the end of the frame.
        simulation.clock.now = 102.005
        simulation.device.set_faults(Faults(light=LightFaults(lamp=0.0)))

    simulation.clock.now, simulation.during = 101.0, switched
    seen = simulation.sensor.capture(102.0, 5.0).embedding.mean()
    assert seen == pytest.approx(lit / 4, rel=0.01)


def test_exposure_longer_than_the_timeout_is_a_timeout() -> None:
    simulation = Simulation(SHADOW, replace(QUIET, exposure=2.0))
    with pytest.raises(SensorError):
        simulation.sensor.capture(simulation.clock.now, 1.0)


def test_scene_is_what_the_file_holds_now(tmp_path: Path) -> None:
    path = tmp_path / "scene.npy"
    source = FileScene(path, (2, 3))
    write_scene(path, np.full((2, 3), 255, np.uint8))
    assert np.min(source.read()) == 1.0
    write_scene(path, np.zeros((2, 3), np.uint8))
    assert np.max(source.read()) == 0.0
    np.save(path, np.full((2, 3), 0.25))
    assert source.read().dtype == np.float32
    assert [each.name for each in tmp_path.iterdir()] == ["scene.npy"]


@pytest.mark.parametrize(
    ("content", "message"), [(None, "there is no scene file"), (b"", "is no image")]
)
def test_bad_scene_file_is_a_sensor_error(
    tmp_path: Path, content: bytes | None, message: str
) -> None:
    path = tmp_path / "scene.npy"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(SensorError, match=message):
        FileScene(path, (2, 3)).read()
