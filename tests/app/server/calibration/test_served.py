"""A camera that was built badly: served, calibrated over its API, and served again."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from tests.unit.server.calibration.camera import GEOMETRY as WHOLE
from typer.testing import CliRunner

from veilcam_client import Camera
from veilcam_client.cli.main import app as client
from veilcam_optics.camera.geometry import Sensor
from veilcam_optics.decoding import MeasurementNoise, fit_statistics
from veilcam_optics.keys.masks import MaskDistribution
from veilcam_server.cli.main import app as server
from veilcam_server.demo.daemon import running
from veilcam_training.bundle import Bundle, Fresh, write_bundle
from veilcam_training.bundle.layers import Linear

CLASSES = 8
# Half of the sensor along each side: simulated light takes half of the time.
GEOMETRY = replace(WHOLE, camera=replace(WHOLE.camera, sensor=Sensor(rows=1520, columns=2028)))
BUILT = {
    "shift_y": 120e-6,
    "shift_x": -90e-6,
    "gamma": 2.2,
    "dead_rows": [4],
    "dead_transmittance": 1.0,
}


def scenes() -> npt.NDArray[np.float32]:
    """One of each class: its template."""
    return np.random.default_rng(5).random((CLASSES, *GEOMETRY.scene.shape)).astype(np.float32)


def nearest_template() -> Bundle:
    """Fresh masks, and the classifier that takes the nearest of the templates."""
    random = np.random.default_rng(6)
    templates = scenes().reshape(CLASSES, -1)
    seen = random.random((400, *GEOMETRY.scene.shape), np.float32)
    pixels = GEOMETRY.scene.rows * GEOMETRY.scene.columns
    return Bundle(
        task="templates",
        labels=tuple(map(str, range(CLASSES))),
        camera=GEOMETRY.camera,
        scene=GEOMETRY.scene,
        embedding=GEOMETRY.embedding,
        mode="fresh",
        fresh=Fresh(
            distribution=MaskDistribution.uniform(GEOMETRY.camera),
            statistics=fit_statistics([seen], pixels),
            noise=MeasurementNoise(40.0),
            layers=(Linear(inputs=pixels, outputs=CLASSES),),
            weights={"0.weight": 20 * templates, "0.bias": -10 * np.square(templates).sum(axis=1)},
        ),
    )


def accuracy(camera: Camera, captures: int) -> float:
    """Of captures that each have a mask of their own."""
    right = 0
    for number in range(captures):
        label = number % CLASSES
        camera.simulation.hold_scene(scenes()[label])
        right += camera.classify().label == str(label)
    return right / captures


@pytest.mark.thorough
@pytest.mark.timeout(900)  # two daemons and a calibration, on a machine that may be busy
def test_calibration_is_what_tells_scenes_apart(tmp_path: Path) -> None:
    bundle, built = tmp_path / "a.veilcam", tmp_path / "built.json"
    write_bundle(bundle, nearest_template())
    built.write_text(json.dumps(BUILT))
    scene = tmp_path / "scene.npy"
    np.save(scene, scenes()[0])
    options = (
        *("--imperfections", str(built), "--scene-api"),
        *("--settle", "0.02", "--exposure", "0.001"),
    )
    with running(bundle, scene, tmp_path, *options) as url, Camera(url) as camera:
        before = accuracy(camera, 2 * CLASSES)
        result = CliRunner().invoke(client, ["calibrate", "--repeats", "1", "--url", url])
        assert result.exit_code == 0, result.output
        after = accuracy(camera, CLASSES)
        signed = camera.calibration.get().signed
    assert signed is not None
    assert signed.record.shift_y_m.value == pytest.approx(BUILT["shift_y"], abs=3e-6)
    assert signed.record.dead_rows == (4,)
    with running(bundle, scene, tmp_path, *options) as url, Camera(url) as camera:
        assert camera.calibration.get().signed == signed
        again = accuracy(camera, CLASSES)
    # Over many masks, of the whole sensor: 0.24 before, 1.0 afterwards.
    assert before < 0.7
    assert min(after, again) > 0.8


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (None, "cannot be read: No such file"),
        ("{", "file: Invalid JSON"),
        ('{"shift": 1}', "shift: Unexpected keyword argument"),
        ('{"rotation": 9}', "rotation"),
        ('{"dead_transmittance": 2}', "dead_transmittance"),
        ('{"dead_rows": [51]}', "dead_rows = 51 is not valid: use 0 to 50"),
    ],
)
def test_camera_that_cannot_be_built_is_refused_in_one_line(
    tmp_path: Path, text: str | None, reason: str
) -> None:
    built = tmp_path / "built.json"
    if text is not None:
        built.write_text(text)
    options = ["--simulate", "--state-dir", str(tmp_path), "--imperfections", str(built)]
    result = CliRunner().invoke(server, ["calibrate", *options])
    assert result.exit_code == 1
    assert reason in result.stderr
    assert len(result.stderr.splitlines()) == 1


def test_only_a_simulated_camera_is_built_as_somebody_likes() -> None:
    result = CliRunner().invoke(server, ["calibrate", "--bundle", "x", "--imperfections", "y"])
    assert "add --simulate" in result.stderr
