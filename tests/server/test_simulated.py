"""The simulated device: light alone couples panel and sensor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
import torch

from veilcam_optics.geometry import Camera, Embedding, Panel, Scene, Window
from veilcam_optics.masks import to_weights
from veilcam_optics.transfer import TransferOperator
from veilcam_server.devices import DisplayError, SensorError, SensorTimeoutError
from veilcam_server.devices.scene import FileScene, write_scene
from veilcam_server.devices.simulated import (
    Conditions,
    Light,
    SimulatedDisplay,
    SimulatedSensor,
    planned_light,
)

CAMERA = Camera(panel=Panel(), window=Window(rows=9, columns=5))
EMBEDDING = Embedding(4, 5)
RNG = np.random.default_rng(5)
OLD, NEW = (RNG.integers(0, 64, CAMERA.mask_shape).astype(np.uint8) for _ in range(2))


class Clock:
    """Time that passes only when somebody sleeps."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


class Still:
    """A scene that does not change."""

    def __init__(self) -> None:
        self.image = RNG.random((28, 28), np.float32)

    def read(self) -> npt.NDArray[np.float32]:
        return self.image


@pytest.fixture(scope="module")
def light() -> Light:
    return planned_light(CAMERA, Scene(), EMBEDDING)


class Simulation:
    """A display and a sensor on one clock, without noise unless asked for."""

    def __init__(
        self,
        light: Light,
        *,
        settle: float = 0.05,
        exposure: float = 0.01,
        snr_db: float = np.inf,
        seed: int | None = 1,
    ) -> None:
        self.clock, self.scene, self.light = Clock(), Still(), light
        self.display = SimulatedDisplay(CAMERA, settle, self.clock)
        self.sensor = SimulatedSensor(
            self.display,
            self.scene,
            light,
            camera=CAMERA,
            conditions=Conditions(settle, exposure, snr_db),
            seed=seed,
            clock=self.clock,
            sleep=self.clock.sleep,
        )

    def seen(self, levels: npt.NDArray[np.uint8]) -> npt.NDArray[np.float32]:
        response = self.light.response(to_weights(levels, CAMERA.panel))
        return self.light.collect(torch.from_numpy(self.scene.image)[None], response)[0].numpy()

    def capture(self, after: float = 1.0) -> npt.NDArray[np.float32]:
        return self.sensor.capture(self.clock.now + after, 5.0).embedding


def test_the_sensor_sees_the_scene_through_the_mask(light: Light) -> None:
    simulation = Simulation(light)
    simulation.display.show(NEW)
    np.testing.assert_allclose(simulation.capture(), simulation.seen(NEW), rtol=1e-5)
    simulation.scene.image = simulation.scene.image[::-1].copy()
    np.testing.assert_allclose(simulation.capture(), simulation.seen(NEW), rtol=1e-5)


def test_its_light_agrees_with_the_transfer_operator_of_training(light: Light) -> None:
    simulation = Simulation(light)
    simulation.display.show(NEW)
    operator = TransferOperator(CAMERA, Scene(), EMBEDDING)
    scene = torch.from_numpy(simulation.scene.image).reshape(1, -1)
    expected = (scene @ operator(to_weights(NEW, CAMERA.panel))).reshape(EMBEDDING.shape).numpy()
    difference = np.linalg.norm(simulation.capture() - expected) / np.linalg.norm(expected)
    assert 0 < difference < 0.05  # two routes to one light: near, but not the same


def test_an_opaque_panel_lets_no_light_through(light: Light) -> None:
    simulation = Simulation(light, snr_db=40.0)
    simulation.display.show(NEW)
    simulation.display.blank()
    assert not simulation.capture().any()


def test_an_exposure_while_the_crystal_turns_mixes_two_masks(light: Light) -> None:
    simulation = Simulation(light, settle=0.1, exposure=0.01)
    simulation.display.show(OLD)
    simulation.clock.sleep(1)
    simulation.display.show(NEW)
    mixed = simulation.capture(after=0.05)
    assert not np.allclose(mixed, simulation.seen(OLD), rtol=1e-3)
    assert not np.allclose(mixed, simulation.seen(NEW), rtol=1e-3)
    settled = simulation.capture(after=0.1)
    np.testing.assert_allclose(settled, simulation.seen(NEW), rtol=1e-5)


def test_a_mask_that_changes_within_the_exposure_mixes(light: Light) -> None:
    simulation = Simulation(light, settle=0.0, exposure=0.0)
    simulation.display.show(OLD)
    sleeps: list[float] = []

    def interrupt(seconds: float) -> None:
        sleeps.append(seconds)
        simulation.clock.sleep(0.1)
        if len(sleeps) == 2:  # the second sleep of a capture is its exposure
            simulation.display.show(NEW)
            simulation.clock.sleep(0.1)

    simulation.sensor._sleep = interrupt
    mixed = simulation.capture()
    assert not np.allclose(mixed, simulation.seen(OLD), rtol=1e-3)
    assert not np.allclose(mixed, simulation.seen(NEW), rtol=1e-3)


def test_the_sensor_waits_as_long_as_it_was_told(light: Light) -> None:
    simulation = Simulation(light, exposure=0.02)
    exposure = simulation.sensor.capture(simulation.clock.now + 0.3, 5.0)
    assert exposure.started_at == pytest.approx(100.3)
    assert exposure.ended_at == pytest.approx(100.32)


def test_noise_has_the_ratio_asked_for(light: Light) -> None:
    simulation = Simulation(light, snr_db=20.0)
    simulation.display.show(NEW)
    clean = simulation.seen(NEW)
    noise = np.stack([simulation.capture() for _ in range(100)]) - clean
    ratio = 10 * np.log10(np.square(clean).sum() / np.square(noise).sum((1, 2)).mean())
    assert ratio == pytest.approx(20.0, abs=0.5)


def test_the_seed_fixes_the_noise(light: Light) -> None:
    def reading(seed: int | None) -> npt.NDArray[np.float32]:
        simulation = Simulation(light, snr_db=20.0, seed=seed)
        simulation.scene.image = np.full((28, 28), 0.5, np.float32)
        simulation.display.show(NEW)
        return simulation.capture()

    assert np.array_equal(reading(1), reading(1))
    assert not np.array_equal(reading(1), reading(2))
    assert not np.array_equal(reading(None), reading(None))


def test_an_exposure_longer_than_the_timeout_is_a_timeout(light: Light) -> None:
    simulation = Simulation(light, exposure=2.0)
    with pytest.raises(SensorTimeoutError):
        simulation.sensor.capture(simulation.clock.now, 1.0)


@pytest.mark.parametrize(
    "levels",
    [
        np.zeros((5, 9), np.uint8),
        np.zeros((9, 5), np.float32),
        np.full((9, 5), 64, np.uint8),
    ],
)
def test_the_panel_refuses_what_it_cannot_show(light: Light, levels: np.ndarray) -> None:
    with pytest.raises(DisplayError):
        Simulation(light).display.show(levels)


@pytest.mark.parametrize("name", ["settle", "exposure"])
@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf")])
def test_impossible_conditions_are_refused(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        Conditions(**{name: value})


def test_the_scene_is_what_the_file_holds_now(tmp_path: Path) -> None:
    path = tmp_path / "scene.npy"
    source = FileScene(path, (2, 3))
    write_scene(path, np.full((2, 3), 255, np.uint8))
    assert source.read().min() == 1.0
    write_scene(path, np.zeros((2, 3), np.uint8))
    assert source.read().max() == 0.0
    np.save(path, np.full((2, 3), 0.25))
    assert source.read().dtype == np.float32
    assert [each.name for each in tmp_path.iterdir()] == ["scene.npy"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "there is no scene file"),
        (b"", "is not a .npy image"),
        (b"\x93NUMPY\x01\x00", "is not a .npy image"),
        (np.zeros((3, 3), np.uint8), "wrong shape"),
        (np.full((2, 3), 1.5), "no reflectances"),
        (np.full((2, 3), np.nan), "no reflectances"),
        (np.full((2, 3), 1, np.int64), "no reflectances"),
        (np.full((2, 3), None), "is not a .npy image"),
    ],
)
def test_a_bad_scene_file_is_a_sensor_error(
    tmp_path: Path, content: np.ndarray | bytes | None, message: str
) -> None:
    path = tmp_path / "scene.npy"
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        np.save(path, content, allow_pickle=True)
    with pytest.raises(SensorError, match=message):
        FileScene(path, (2, 3)).read()
