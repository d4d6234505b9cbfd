"""Why a calibration of the simulated camera finds the sensor too near: its light comes off a grid.

    python -m benchmarks.daemon.distance --figures benchmarks/results/daemon-calibration.json

A small nominal camera, without noise: white card and lamp behind six random patterns, the light
once off grids that get finer, once by the operator that is fitted; then the fit of a calibration.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
import typer
from benchmarks.figures import FiguresOption, record

from veilcam_optics.camera import imperfections as optical
from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Window
from veilcam_optics.camera.imperfections import NOMINAL, PARAXIAL
from veilcam_optics.effects import Model, Sampling
from veilcam_optics.plan import plan
from veilcam_optics.simulation.operator import LightOperator
from veilcam_optics.transfer.tables import Reach
from veilcam_server.calibration.alignment import Sight, align
from veilcam_server.calibration.rig import Geometry, lamp, white
from veilcam_server.devices.simulated.device import TOLERANCE

GEOMETRY = Geometry(
    Camera(window=Window(rows=15, columns=7)), Scene(rows=6, columns=6), Embedding(24, 16)
)
FINER = (1, 2, 4)
"""Grids, by how much finer they are than the simulated camera's."""


def distance(model: Model, weights: torch.Tensor) -> float:
    """What the fit makes of the sensor's distance, which is nominal [um]."""
    light, sights = LightOperator(model), []
    with torch.no_grad():
        responses = [light.response(each.float()) for each in weights]
        for scene in (white(GEOMETRY.scene), lamp(GEOMETRY.scene)):
            image = torch.from_numpy(scene.image)[None]
            seen = torch.cat([light.collect(image, response) for response in responses])
            sights.append(Sight(scene.image.astype(np.float64), seen.double().numpy()))
    found = align(GEOMETRY, weights.double().numpy(), sights, NOMINAL, reach=Reach())
    return 1e6 * found.imperfections.distance_error


def main(
    figures: FiguresOption = None,
) -> None:
    """Fit the light of every grid, and that of the operator."""
    torch.set_num_threads(1)
    camera, scene, embedding = GEOMETRY.camera, GEOMETRY.scene, GEOMETRY.embedding
    weights = torch.from_numpy(np.random.default_rng(1).random((6, *camera.mask_shape)))
    coarse = plan(camera, scene, embedding, TOLERANCE, PARAXIAL, batch=1, method="grid").model
    values = {}
    for finer in FINER:
        sampling = replace(
            coarse.sampling,
            oversampling=finer * coarse.sampling.oversampling,
            step=coarse.sampling.step / finer,
        )
        values[f"distance_grid_{finer}_um"] = distance(replace(coarse, sampling=sampling), weights)
    exact = Model(camera, scene, embedding, optical.IDEAL, Sampling("transfer", reach=Reach(6, 1)))
    values["distance_transfer_um"] = distance(exact, weights)
    for name, value in values.items():
        print(f"{name}: {value:.1f}", flush=True)
    record(figures, values)


if __name__ == "__main__":
    typer.run(main)
