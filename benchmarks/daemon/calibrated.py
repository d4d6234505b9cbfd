"""Digits read by a daemon whose camera was built badly: before, after, and after a restart.

    python -m benchmarks.daemon.calibrated --figures benchmarks/results/daemon-calibration.json

``veilcamd serve`` on the simulated camera, with the bundle of fresh masks that comes along, a mask
for every digit; ``veilcam calibrate`` in between, while it runs; then the daemon is started again,
and finds the record in its state directory. Digits are held up and read through the SDK.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.rig import work_folder

from veilcam_client import Camera
from veilcam_server.demo.daemon import running
from veilcam_server.demo_data import FRESH, Digits, load_digits
from veilcam_server.devices.simulated.scenes import write_scene

BUILT = {
    "shift_y": 80e-6,
    "shift_x": -60e-6,
    "rotation": 4e-3,
    "distance_error": 100e-6,
    "gamma": 1.4,
    "contrast_floor": 0.08,
    "dead_rows": [20],
    "dead_columns": [8],
    "dead_transmittance": 1.0,
}
"""Several things wrong at once; a row and a column are stuck open."""


def accuracy(url: str, digits: Digits, count: int, seed: int) -> float:
    """Share of right labels over so many digits that were drawn at random."""
    chosen = np.random.default_rng(seed).choice(len(digits), count, replace=False)
    right = 0
    with Camera(url) as camera:
        for index in chosen:
            camera.simulation.hold_scene(digits.images[index])
            right += camera.classify().label == str(digits.labels[index])
    return right / count


def main(
    figures: FiguresOption = None,
    count: Annotated[int, typer.Option(min=1, help="Digits read each time.")] = 100,
) -> None:
    """Serve, calibrate, serve again."""
    digits = load_digits()
    with work_folder() as folder:
        built, scene = folder / "built.json", folder / "scene.npy"
        built.write_text(json.dumps(BUILT))
        write_scene(scene, digits.images[0])
        options = (
            *("--imperfections", str(built), "--scene-api"),
            *("--settle", "0.02", "--exposure", "0.001"),
        )
        values = {}
        with running(FRESH, scene, folder, *options) as url:
            values["served_before"] = accuracy(url, digits, count, 1)
            command = [str(Path(sys.executable).with_name("veilcam")), "calibrate", "--url", url]
            subprocess.run(command, check=True)
            values["served_after"] = accuracy(url, digits, count, 1)
        with running(FRESH, scene, folder, *options) as url:
            values["served_again"] = accuracy(url, digits, count, 2)
    for what, value in values.items():
        print(f"{what}: {value:.3f} of {count}")
    record(figures, values)


if __name__ == "__main__":
    typer.run(main)
