"""Random cases of a plan, and the truth about each.

The truth is a far finer setting of the same physics, or direct integration of the whole field,
which shares nothing with it but the field of one aperture.
"""

from __future__ import annotations

import math
import random
import statistics
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from benchmarks.accuracy.reference import reference_transfer
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.camera.imperfections import IDEAL, Conditions
from veilcam_optics.effects import Model, Sampling
from veilcam_optics.simulation.operator import LightOperator
from veilcam_optics.transfer.tables import Reach

EMBEDDINGS = ((1, 1), (3, 4), (6, 8), (12, 16), (13, 17), (24, 32), (27, 36), (48, 64))


@dataclass(frozen=True)
class Case:
    """One random job."""

    camera: Camera
    scene: Scene
    embedding: Embedding
    conditions: Conditions
    tolerance: float

    @property
    def unit(self) -> int:
        """Rows between the nearest two that pass the same light."""
        panel = self.camera.panel
        if not panel.filter_cycle or panel.filter_leakage:
            return 1
        return len(panel.filter_cycle)


def draw(generator: random.Random) -> Case:
    """A case of everyday to rather odd geometry."""
    pitch_y = generator.uniform(40e-6, 110e-6)
    pitch_x = pitch_y * generator.choice([1, 2, 3])
    fill = generator.uniform(0.6, 1)
    panel = Panel(
        pitch_y=pitch_y,
        pitch_x=pitch_x,
        aperture_y=fill * pitch_y,
        aperture_x=fill * pitch_x,
        filter_cycle=generator.choice([(), (0, 1, 2)]),
        filter_leakage=generator.choice([0.0, 0.0, generator.uniform(0.01, 0.2)]),
    )
    camera = Camera(
        panel=panel,
        window=Window(generator.randint(4, 60), generator.randint(2, 30)),
        sensor=Sensor(generator.randint(400, 1600), generator.randint(400, 1600)),
        distance=_log_uniform(generator, 1e-3, 20e-3),
        wavelengths=(
            generator.uniform(600e-9, 700e-9),
            generator.uniform(520e-9, 580e-9),
            generator.uniform(430e-9, 490e-9),
        ),
    )
    scene_distance = generator.uniform(0.2, 2.0)
    side = generator.uniform(0.1, 1.0) * camera.sensor.height
    scene = Scene(
        rows=generator.randint(4, 6),
        columns=generator.randint(4, 6),
        height=side * scene_distance / camera.distance,
        distance=scene_distance,
    )
    # A scene wider than it is far away is no scene for a paraxial camera.
    scene = replace(scene, height=min(scene.height, 0.8 * scene_distance))
    return Case(
        camera,
        scene,
        Embedding(*generator.choice(EMBEDDINGS)),
        _some_conditions(generator, camera, scene),
        _log_uniform(generator, 1e-4, 1e-1),
    )


def _some_conditions(generator: random.Random, camera: Camera, scene: Scene) -> Conditions:
    """None in every other case, else one to three of them."""
    if generator.random() < 0.5:
        return IDEAL
    conditions = IDEAL
    changes: list[Callable[[Conditions], Conditions]] = [
        lambda c: replace(c, bandwidth=(generator.uniform(5e-9, 60e-9),) * 3),
        lambda c: replace(c, depth_range=generator.uniform(0.01, 0.4) * scene.distance),
        lambda c: _with(c, gamma=generator.uniform(0.8, 1.3)),
        lambda c: _with(c, contrast_floor=_log_uniform(generator, 1e-3, 1e-1)),
        lambda c: replace(c, levels=generator.choice([8, 16, 64, 256])),
        lambda c: _with(c, shift_y=_log_uniform(generator, 1e-8, 5e-5), shift_x=1e-6),
        lambda c: _with(c, distance_error=camera.distance * _log_uniform(generator, 1e-5, 2e-2)),
        lambda c: _with(c, stray_light=_log_uniform(generator, 1e-4, 1e-1)),
        lambda c: replace(c, bayer=True),
    ]
    for change in generator.sample(changes, generator.randint(1, 3)):
        conditions = change(conditions)
    return conditions


def _with(conditions: Conditions, **changes: float) -> Conditions:
    imperfections = replace(conditions.imperfections, **changes)  # type: ignore[arg-type]
    return replace(conditions, imperfections=imperfections)


def _log_uniform(generator: random.Random, low: float, high: float) -> float:
    return math.exp(generator.uniform(math.log(low), math.log(high)))


def some_masks(case: Case, count: int) -> list[Tensor]:
    """Masks that no plan has seen."""
    generator = torch.Generator().manual_seed(987654321)
    return [
        torch.rand(case.camera.mask_shape, generator=generator, dtype=torch.float64)
        for _ in range(count)
    ]


def true_model(case: Case, chosen: Reach) -> Model:
    """A setting far finer than any that a plan would choose.

    Every zone of the field has kernels of its own, and all pairs would take minutes each: the pairs
    are those within ``chosen``, the plan's reach, and the nearest two shells beyond it, which hold
    nearly all that it leaves out.
    """
    camera = case.camera
    reach = Reach(chosen.rows + 2 * case.unit, chosen.columns + 2)
    rows, columns = camera.window.rows - 1, camera.window.columns - 1
    reach = Reach(min(rows, reach.rows), min(columns, reach.columns))
    apart = max(camera.panel.pitch_y * (1 + reach.rows), camera.panel.pitch_x * (1 + reach.columns))
    sensor, embedding = camera.sensor, case.embedding
    pixel = min(sensor.height / embedding.rows, sensor.width / embedding.columns)
    fringe = 0.9 * min(camera.wavelengths) * camera.distance / apart
    sampling = Sampling(
        reach=reach,
        wavelengths=7,
        layers=7,
        zones=6,  # each pixel of the scene has its own
        step=min(fringe / 3, pixel / 20),
        dtype=torch.float64,
    )
    return Model(camera, case.scene, embedding, case.conditions, sampling)


def matrices(operator: LightOperator, masks: list[Tensor]) -> list[Tensor]:
    """The transfer matrix of every mask, by whatever method."""
    with torch.no_grad():
        if operator.has_transfer:
            return [operator(mask) for mask in masks]
        rows, columns = operator.model.scene.shape
        points = torch.eye(rows * columns, dtype=operator.dtype).reshape(-1, rows, columns)
        return [operator.embed(points, mask).flatten(1) for mask in masks]


def relative(values: list[Tensor], truths: list[Tensor]) -> float:
    """Root mean square over the masks, relative to that of the truths."""
    differences = sum(
        float((v.double() - t).square().sum()) for v, t in zip(values, truths, strict=True)
    )
    return math.sqrt(differences / sum(float(t.square().sum()) for t in truths))


def spread(values: list[Tensor], truths: list[Tensor]) -> float:
    """Standard error of :func:`relative`, from how much the masks differ."""
    size = math.sqrt(statistics.mean(float(t.square().sum()) for t in truths))
    squares = [
        float((v.double() - t).square().sum()) / size**2
        for v, t in zip(values, truths, strict=True)
    ]
    mean = statistics.mean(squares)
    if len(squares) < 2 or not mean:
        return 0.0
    return statistics.stdev(squares) / math.sqrt(len(squares)) / (2 * math.sqrt(mean))


def against_integration(case: Case) -> float:
    """Relative L2 between the truth and direct integration of the whole field."""
    ideal = replace(case, conditions=IDEAL)
    weights = some_masks(ideal, 1)
    model = true_model(ideal, Reach(8 * case.unit + 4, 6))
    # The whole field is integrated without the angle of the field.
    model = replace(model, sampling=replace(model.sampling, oblique=False))
    truth = matrices(LightOperator(model), weights)
    whole = max(
        case.camera.window.rows * case.camera.panel.pitch_y,
        case.camera.window.columns * case.camera.panel.pitch_x,
    )
    fringe = min(case.camera.wavelengths) * case.camera.distance / whole
    oversampling = min(64, max(16, math.ceil(1.2 * 8 * case.camera.sensor.pixel / fringe)))
    reference = reference_transfer(
        case.camera, case.scene, case.embedding, weights[0], oversampling=oversampling
    )
    return relative(truth, [reference])
