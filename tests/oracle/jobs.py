"""Random jobs, as wide as the constructors allow, corners on purpose; both sides of each."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, replace

import numpy as np

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.camera.imperfections import Conditions, Imperfections

from .physics import Array, Axis, Beam, Light

PITCHES = (0.5e-6, 1e-3)
DISTANCES = (10e-6, 1.0)
WAVELENGTHS = (0.3e-6, 12e-6)
TOLERANCES = (1e-3, 1e-1)
MOST_WORK = 1.5e6
"""Samples times waves: about 3 s of one core."""

_FILLS = ((1, 1), (4, 2), (5, 3), (6, 4), (10, 8))
_SPECTRUM, _LAYERS = 9, 6
_DEVIATIONS = 2 * math.sqrt(2 * math.log(2))


@dataclass(frozen=True)
class Job:
    """One camera, scene and embedding under some conditions, and the tolerance of its plan."""

    camera: Camera
    scene: Scene
    embedding: Embedding
    conditions: Conditions
    tolerance: float
    parts: int
    """Equal parts of the pitch, of which the middle ``open_parts`` are open."""
    open_parts: int
    effects: tuple[str, ...]


def draw(seed: int) -> Job:
    """The job of one seed: drawn anew until the oracle can afford it."""
    generator = random.Random(seed)
    while True:
        job = _draw(generator)
        if light(job).work <= MOST_WORK:
            return job


def _draw(generator: random.Random) -> Job:
    pitch_y, distance, wavelength = (
        _corner(generator, *ends) for ends in (PITCHES, DISTANCES, WAVELENGTHS)
    )
    # Most pairs of lengths drawn apart make shadows or points: every other distance is drawn so
    # that fringes, apertures and pixels are about as wide as one another.
    if generator.random() < 0.5:
        distance = pitch_y**2 / wavelength * log_uniform(generator, 0.05, 20)
        distance = min(max(distance, DISTANCES[0]), DISTANCES[1])
    pitch_x = min(PITCHES[1], pitch_y * generator.choice([1, 1, 2, 3]))
    parts, open_parts = generator.choice(_FILLS)
    fill = open_parts / parts
    rows, columns = generator.randint(1, 12), generator.randint(1, 12)
    filtered = generator.random() < 0.4
    panel = Panel(
        rows=rows,
        columns=columns,
        pitch_y=pitch_y,
        pitch_x=pitch_x,
        aperture_y=fill * pitch_y,
        aperture_x=fill * pitch_x,
        filter_cycle=(0, 1, 2) if filtered else (),
        filter_leakage=generator.choice([0.0, 0.1, 0.3]) if filtered else 0.0,
    )
    side = max(rows * pitch_y, columns * pitch_x) * log_uniform(generator, 0.3, 2)
    sensor_rows, sensor_columns = generator.randint(6, 40), generator.randint(6, 40)
    sensor = Sensor(sensor_rows, sensor_columns, side / max(sensor_rows, sensor_columns))
    camera = Camera(
        panel=panel,
        window=Window(rows, columns, 0, 0),
        sensor=sensor,
        distance=distance,
        wavelengths=(
            wavelength,
            wavelength * generator.choice([1.0, 0.85]),
            wavelength * generator.choice([1.0, 0.7]),
        ),
    )
    scene_distance = max(distance, 2 * side) * log_uniform(generator, 10, 1e4)
    scene_rows, scene_columns = generator.randint(1, 6), generator.randint(1, 6)
    tangent = min(0.4, log_uniform(generator, 0.05, 1) * sensor.height / distance)
    scene = Scene(scene_rows, scene_columns, tangent * scene_distance, scene_distance)
    embedding = Embedding(generator.randint(1, 6), generator.randint(1, 6))
    conditions, effects = _conditions(generator, camera, scene)
    tolerance = log_uniform(generator, *TOLERANCES)
    return Job(camera, scene, embedding, conditions, tolerance, parts, open_parts, effects)


def _conditions(
    generator: random.Random, camera: Camera, scene: Scene
) -> tuple[Conditions, tuple[str, ...]]:
    """None in every other job, else one or two."""
    rows, columns = camera.mask_shape
    pitch, least = camera.panel.pitch_y, min(camera.wavelengths)
    imperfections = {
        "shift": lambda: Imperfections(shift_y=pitch * log_uniform(generator, 1e-3, 1)),
        "rotation": lambda: Imperfections(rotation=log_uniform(generator, 1e-4, 0.1)),
        "distance error": lambda: Imperfections(
            distance_error=camera.distance * log_uniform(generator, 1e-4, 0.1)
        ),
        "gamma": lambda: Imperfections(gamma=generator.uniform(0.6, 1.6)),
        "contrast floor": lambda: Imperfections(contrast_floor=log_uniform(generator, 1e-3, 0.3)),
        "dead lines": lambda: Imperfections(
            dead_rows=(generator.randrange(rows),), dead_columns=(generator.randrange(columns),)
        ),
        "stray light": lambda: Imperfections(stray_light=log_uniform(generator, 1e-3, 0.3)),
    }
    others = {
        "bandwidth": lambda c: replace(
            c, bandwidth=(min(1e-6, least * generator.uniform(0.01, 0.2)),) * 3
        ),
        "depth": lambda c: replace(c, depth_range=scene.distance * generator.uniform(0.02, 0.5)),
        "levels": lambda c: replace(c, levels=generator.choice([2, 8, 64])),
        "bayer": lambda c: replace(c, bayer=True),
    }
    conditions, names = Conditions(), []
    if generator.random() < 0.5:
        names.append(generator.choice(sorted(imperfections)))
        conditions = Conditions(imperfections=imperfections[names[0]]())
    if generator.random() < 0.3:
        names.append(generator.choice(sorted(others)))
        conditions = others[names[-1]](conditions)
    return conditions, tuple(names)


def light(job: Job) -> Light:
    """The job as the oracle sees it: raw lengths."""
    camera, scene, embedding, built = (
        job.camera,
        job.scene,
        job.embedding,
        job.conditions.imperfections,
    )
    panel, sensor = camera.panel, camera.sensor
    y, x = (
        Axis(
            apertures=apertures,
            pitch=pitch,
            open_parts=job.open_parts,
            parts=job.parts,
            sensor=count * sensor.pixel,
            pixels=pixels,
            scene_pixels=scene_pixels,
            scene_pixel=scene.height / scene.rows,
            shift=shift,
        )
        for apertures, pitch, count, pixels, scene_pixels, shift in (
            (
                camera.window.rows,
                panel.pitch_y,
                sensor.rows,
                embedding.rows,
                scene.rows,
                built.shift_y,
            ),
            (
                camera.window.columns,
                panel.pitch_x,
                sensor.columns,
                embedding.columns,
                scene.columns,
                built.shift_x,
            ),
        )
    )
    return Light(
        y,
        x,
        camera.distance + built.distance_error,
        tuple(_beams(job)),
        built.rotation,
        _bayer(job) if job.conditions.bayer else None,
    )


def _beams(job: Job) -> list[Beam]:
    """Every wavelength and depth; a spectrum and a depth are sampled evenly."""
    conditions = job.conditions
    found = []
    for channel, wavelength in enumerate(job.camera.wavelengths):
        colours = [(wavelength, 1.0)]
        if conditions.bandwidth[channel]:
            at = np.linspace(-3.2, 3.2, _SPECTRUM)
            density = np.exp(-(at**2) / 2)
            sigma = conditions.bandwidth[channel] / _DEVIATIONS
            colours = list(zip(wavelength + sigma * at, density / density.sum(), strict=True))
        depths = [(job.scene.distance, 1.0)]
        if conditions.depth_range:
            at = (np.arange(_LAYERS) + 0.5) / _LAYERS - 0.5
            depths = [
                (job.scene.distance + conditions.depth_range * float(one), 1 / _LAYERS)
                for one in at
            ]
        weight = 1.0 if conditions.bayer else job.camera.sensor.channel_weights[channel]
        found += [
            Beam(channel, float(colour), depth, weight * float(part) * share)
            for colour, part in colours
            for depth, share in depths
        ]
    return found


def _bayer(job: Job) -> Array:
    """Share of R, G and B in every embedding pixel of an RGGB sensor, by counting fine parts."""
    sensor, embedding = job.camera.sensor, job.embedding
    shares = []
    for count, pixels in ((sensor.rows, embedding.rows), (sensor.columns, embedding.columns)):
        odd = np.repeat(np.arange(count) % 2, pixels).reshape(pixels, count).mean(1)
        shares.append(odd)
    y, x = shares[0][:, None], shares[1]
    red, blue = (1 - y) * (1 - x), y * x
    return np.stack([red, 1 - red - blue, blue])


def shown(job: Job, weights: Array) -> Array:
    """Amplitudes that each channel's light passes, (masks, 3, rows, columns)."""
    built = job.conditions.imperfections
    values = weights
    if job.conditions.levels:
        steps = job.conditions.levels - 1
        values = np.rint(values * steps) / steps
    values = values**built.gamma
    values = built.contrast_floor + (1 - built.contrast_floor) * values
    values[:, list(built.dead_rows)] = built.dead_transmittance
    values[:, :, list(built.dead_columns)] = built.dead_transmittance
    panel = job.camera.panel
    passed = np.ones((3, job.camera.window.rows))
    if panel.filter_cycle:
        for row in range(job.camera.window.rows):
            for channel in range(3):
                own = panel.filter_cycle[row % len(panel.filter_cycle)] == channel
                passed[channel, row] = 1.0 if own else panel.filter_leakage
    return values[:, None] * passed[..., None]


def masks(job: Job, count: int = 2) -> Array:
    """Masks that no plan has seen."""
    return np.random.default_rng(987654321).random((count, *job.camera.mask_shape))


def scattered(job: Job, transfers: Array) -> Array:
    """With the stray light that is spread evenly over the sensor."""
    share = job.conditions.imperfections.stray_light
    spread: Array = (1 - share) * transfers + share * transfers.mean(-1, keepdims=True)
    return spread


def log_uniform(generator: random.Random, low: float, high: float) -> float:
    """A number whose logarithm is evenly spread."""
    return math.exp(generator.uniform(math.log(low), math.log(high)))


def _corner(generator: random.Random, low: float, high: float) -> float:
    """An end of the range in one draw of four."""
    if generator.random() < 0.25:
        return generator.choice([low, high])
    return log_uniform(generator, low, high)
