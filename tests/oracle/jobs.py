"""Random jobs, as wide as the constructors allow: every length alone and at its ends together.

Sizes are small, since size is not the physics. Left out is what the oracle cannot afford even of
the smallest sizes (apertures thousands of waves wide, close to the sensor); how often that is drawn
is counted. Left out, too, is noise, which no matrix holds.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
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

_FILLS = ((1, 1), (4, 2), (5, 3), (6, 4), (10, 8), (3, 2))
"""Equal parts of a pitch, and how many in the middle are open."""

BOXES = (1e-3, 1.0)
"""Fills of embeddings; a smaller box is as good as a point."""

_CYCLES = ((), (), (0, 1, 2), (2, 1, 0), (1,), (0, 0, 2))
_SHARES = ((0.25, 0.5, 0.25), (0.25, 0.5, 0.25), (1 / 3, 1 / 3, 1 / 3), (0.0, 1.0, 0.0))
_SIZES = (12, 6, 3, 1)
"""Most apertures a side; embeddings and scenes have half as many, and the first draw is kept."""

_PARTS = 20_000
"""Parts of a box along each side whose colours are counted."""

_SPECTRUM, _LAYERS = 9, 6
_DEVIATIONS = 2 * math.sqrt(2 * math.log(2))
_WIDE, _MOST_SOURCES = 0.07, 3
"""Angle up to which a scene pixel may be one point [rad]: its share of the error is then 2e-3."""

_ELECTRONS = 1e20
"""So many that their noise is nothing even in the faintest light."""


@dataclass(frozen=True)
class Job:
    camera: Camera
    scene: Scene
    embedding: Embedding
    conditions: Conditions
    tolerance: float
    fills: tuple[tuple[int, int], tuple[int, int]]
    """Equal parts of the pitch, and how many in the middle are open, along y and x."""
    effects: tuple[str, ...] = ()
    unaffordable: int = 0

    @property
    def measured(self) -> bool:
        conditions = self.conditions
        return bool(conditions.full_well or conditions.black_level or conditions.adc_bits)


@dataclass(frozen=True)
class Lengths:
    pitch: float
    distance: float
    wavelength: float


def draw(seed: int) -> Job:
    """The job of one seed: of smaller sizes, then of other lengths, until it is affordable."""
    generator, fill = random.Random(seed), _fill(seed)
    unaffordable = 0
    while True:
        lengths = _lengths(generator)
        for most in _SIZES:
            job = _draw(generator, lengths, most, fill)
            while not lit(job):
                job = _draw(generator, lengths, most, fill)
            if light(job).affordable(MOST_WORK):
                return replace(job, unaffordable=unaffordable)
        unaffordable += 1


def draw_everyday(seed: int) -> Job:
    """A camera of an LCD in visible light, as it should be, that sees up to 30 degrees."""
    generator = random.Random(seed)
    while True:
        lengths = Lengths(
            generator.uniform(40e-6, 110e-6),
            log_uniform(generator, 0.5e-3, 10e-3),
            generator.uniform(450e-9, 650e-9),
        )
        job = replace(
            _draw(generator, lengths, _SIZES[0], 1.0), conditions=Conditions(), effects=()
        )
        narrow = job.scene.height / 2 / job.scene.distance <= math.tan(math.pi / 6)
        if narrow and lit(job) and light(job).affordable(MOST_WORK):
            return job


def _fill(seed: int) -> float:
    """Fill of a seed's embedding, from numbers of its own: the rest is as without it."""
    generator = random.Random(f"fill {seed}")
    shares = (1.0, 1.0, 0.5, log_uniform(generator, *BOXES), generator.choice(BOXES))
    return generator.choice(shares)


def _lengths(generator: random.Random) -> Lengths:
    pitch, distance, wavelength = (
        _corner(generator, *ends) for ends in (PITCHES, DISTANCES, WAVELENGTHS)
    )
    # Most pairs of lengths drawn apart make shadows or points: every other distance is drawn so
    # that fringes, apertures and pixels are about as wide as one another.
    if generator.random() < 0.5:
        distance = pitch**2 / wavelength * log_uniform(generator, 0.02, 50)
        distance = min(max(distance, DISTANCES[0]), DISTANCES[1])
    return Lengths(pitch, distance, wavelength)


def _draw(generator: random.Random, lengths: Lengths, most: int, fill: float) -> Job:
    rows, columns = generator.randint(1, most), generator.randint(1, most)
    few = max(1, most // 2)
    fills = generator.choice(_FILLS), generator.choice(_FILLS)
    pitch_y, distance = lengths.pitch, lengths.distance
    pitch_x = min(PITCHES[1], max(PITCHES[0], pitch_y * generator.choice([1, 1, 0.5, 2, 3])))
    panel = _panel(generator, rows, columns, (pitch_y, pitch_x), fills)
    mask = max(rows * pitch_y, columns * pitch_x)
    side = mask * log_uniform(generator, 0.3, 2)
    if generator.random() < 0.3:  # as wide as the light spreads
        side += min(2 * distance, 2 * lengths.wavelength * distance / panel.aperture_y)
    sensor_rows, sensor_columns = generator.randint(6, 40), generator.randint(6, 40)
    pixel = min(max(side / max(sensor_rows, sensor_columns), 1e-8), 0.1)
    camera = Camera(
        panel=panel,
        window=Window(rows, columns, panel.rows - rows, 0),
        sensor=Sensor(
            sensor_rows, sensor_columns, pixel, channel_weights=generator.choice(_SHARES)
        ),
        distance=distance,
        wavelengths=_colours(generator, lengths.wavelength),
    )
    scene = _scene(generator, camera, side, few)
    embedding = Embedding(generator.randint(1, few), generator.randint(1, few), fill)
    conditions, effects = _conditions(generator, camera, scene)
    tolerance = log_uniform(generator, *TOLERANCES)
    return Job(camera, scene, embedding, conditions, tolerance, fills, effects)


def _panel(
    generator: random.Random,
    rows: int,
    columns: int,
    pitches: tuple[float, float],
    fills: tuple[tuple[int, int], tuple[int, int]],
) -> Panel:
    cycle = generator.choice(_CYCLES)
    table: tuple[tuple[float, float, float], ...] = ()
    if cycle and generator.random() < 0.3:
        measured = np.random.default_rng(generator.randrange(2**32)).random((3, 3)) / 2 + np.eye(3)
        table = tuple((float(r), float(g), float(b)) for r, g, b in measured.clip(0, 1))
    return Panel(
        rows=rows + generator.randint(0, 2),
        columns=columns,
        pitch_y=pitches[0],
        pitch_x=pitches[1],
        aperture_y=pitches[0] * fills[0][1] / fills[0][0],
        aperture_x=pitches[1] * fills[1][1] / fills[1][0],
        filter_cycle=cycle,
        filter_leakage=generator.choice([0.0, 0.1, 0.3, 1.0]) if cycle else 0.0,
        filter_amplitudes=table,
    )


def _colours(generator: random.Random, wavelength: float) -> tuple[float, float, float]:
    colours = [wavelength * part for part in (1, generator.choice([1, 0.85]))]
    colours.append(wavelength * generator.choice([1.0, 0.7]))
    generator.shuffle(colours)
    red, green, blue = (max(WAVELENGTHS[0], colour) for colour in colours)
    return red, green, blue


def _scene(generator: random.Random, camera: Camera, side: float, most: int) -> Scene:
    """A scene as far as a few sensors, or at infinity; up to 45 degrees to either side."""
    distance = max(2 * camera.distance, side) * log_uniform(generator, 2, 1e4)
    rows, columns = generator.randint(1, most), generator.randint(1, most)
    tangent = min(2.0, log_uniform(generator, 0.05, 2) * side / camera.distance)
    return Scene(rows, columns, tangent * distance / max(1, columns / rows), distance)


def _conditions(
    generator: random.Random, camera: Camera, scene: Scene
) -> tuple[Conditions, tuple[str, ...]]:
    imperfect, others = _imperfections(generator, camera), _others(generator, camera, scene)
    chance = generator.choice([0.0, 0.1, 0.3])
    built = [name for name in imperfect if generator.random() < chance]
    found = [name for name in others if generator.random() < chance]
    imperfections, conditions = Imperfections(), Conditions()
    for name in built:
        imperfections = imperfect[name](imperfections)
    for name in found:
        conditions = others[name](conditions)
    return replace(conditions, imperfections=imperfections), (*built, *found)


def _imperfections(
    generator: random.Random, camera: Camera
) -> dict[str, Callable[[Imperfections], Imperfections]]:
    rows, columns = camera.mask_shape
    panel = camera.panel

    def either(low: float, high: float) -> float:
        return generator.choice([-1, 1]) * log_uniform(generator, low, high)

    return {
        "shift": lambda i: replace(
            i, shift_y=panel.pitch_y * either(1e-3, 2), shift_x=panel.pitch_x * either(1e-3, 2)
        ),
        "rotation": lambda i: replace(i, rotation=either(1e-4, 0.2)),
        "distance error": lambda i: replace(i, distance_error=camera.distance * either(1e-4, 0.3)),
        "gamma": lambda i: replace(i, gamma=log_uniform(generator, 0.4, 2.5)),
        "contrast floor": lambda i: replace(i, contrast_floor=log_uniform(generator, 1e-3, 0.5)),
        "dead lines": lambda i: replace(
            i,
            dead_rows=(generator.randrange(rows),),
            dead_columns=(generator.randrange(columns),),
            dead_transmittance=generator.choice([0.0, 0.0, 1.0, 0.3]),
        ),
        "stray light": lambda i: replace(i, stray_light=log_uniform(generator, 1e-3, 0.5)),
    }


def _others(
    generator: random.Random, camera: Camera, scene: Scene
) -> dict[str, Callable[[Conditions], Conditions]]:
    least = min(camera.wavelengths)
    return {
        "bandwidth": lambda c: replace(
            c, bandwidth=(min(1e-6, least * log_uniform(generator, 0.005, 0.25)),) * 3
        ),
        "depth": lambda c: replace(c, depth_range=scene.distance * generator.uniform(0.02, 0.5)),
        "levels": lambda c: replace(c, levels=generator.choice([2, 3, 8, 64])),
        "bayer": lambda c: replace(c, bayer=True),
        "full well": lambda c: replace(
            c, electrons=_ELECTRONS, full_well=_ELECTRONS * log_uniform(generator, 1e-3, 1)
        ),
        "ADC": lambda c: replace(
            c,
            adc_bits=generator.choice([4, 8, 12]),
            black_level=generator.choice([0.0, 0.01]),
            adc_range=log_uniform(generator, 0.1, 2),
        ),
    }


def light(job: Job) -> Light:
    camera, scene, embedding = job.camera, job.scene, job.embedding
    panel, sensor, built = camera.panel, camera.sensor, job.conditions.imperfections
    pixel = scene.height / scene.rows
    y, x = (
        Axis(
            apertures,
            pitch,
            part,
            parts,
            size * sensor.pixel,
            pixels,
            points,
            pixel,
            shift,
            embedding.fill,
        )
        for apertures, size, pixels, points, pitch, (parts, part), shift in zip(
            camera.mask_shape,
            (sensor.rows, sensor.columns),
            embedding.shape,
            scene.shape,
            (panel.pitch_y, panel.pitch_x),
            job.fills,
            (built.shift_y, built.shift_x),
            strict=True,
        )
    )
    return Light(
        y,
        x,
        camera.distance + built.distance_error,
        tuple(_beams(job)),
        built.rotation,
        _bayer(job) if job.conditions.bayer else None,
        min(_MOST_SOURCES, math.ceil(pixel / scene.distance / _WIDE)),
    )


def _beams(job: Job) -> list[Beam]:
    """Every wavelength and depth; a spectrum and a depth are sampled evenly."""
    conditions = job.conditions
    found = []
    for channel, wavelength in enumerate(job.camera.wavelengths):
        weight = 1.0 if conditions.bayer else job.camera.sensor.channel_weights[channel]
        if not weight:
            continue
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
        found += [
            Beam(channel, float(colour), depth, weight * float(part) * share)
            for colour, part in colours
            for depth, share in depths
        ]
    return found


def _bayer(job: Job) -> Array:
    """Share of R, G and B in every embedding value of an RGGB sensor, by counting fine parts."""
    sensor, embedding = job.camera.sensor, job.embedding
    shares = []
    for count, pixels in ((sensor.rows, embedding.rows), (sensor.columns, embedding.columns)):
        middles = (np.arange(pixels)[:, None] + 0.5) * count / pixels
        parts = (np.arange(_PARTS) + 0.5) / _PARTS - 0.5
        shares.append((np.floor(middles + embedding.fill * count / pixels * parts) % 2).mean(1))
    y, x = shares[0][:, None], shares[1]
    red, blue = (1 - y) * (1 - x), y * x
    return np.stack([red, 1 - red - blue, blue])


def shown(job: Job, weights: Array) -> Array:
    """Amplitudes that each channel's light passes, (masks, 3, rows, columns)."""
    built, panel, window = job.conditions.imperfections, job.camera.panel, job.camera.window
    values = weights
    if job.conditions.levels:
        steps = job.conditions.levels - 1
        values = np.rint(values * steps) / steps
    values = values**built.gamma
    values = built.contrast_floor + (1 - built.contrast_floor) * values
    values[:, list(built.dead_rows)] = built.dead_transmittance
    values[:, :, list(built.dead_columns)] = built.dead_transmittance
    passed = np.ones((3, window.rows))
    for row in range(window.rows if panel.filter_cycle else 0):
        own = panel.filter_cycle[(window.first_row + row) % len(panel.filter_cycle)]
        leaks = np.full(3, panel.filter_leakage)
        leaks[own] = 1.0
        passed[:, row] = panel.filter_amplitudes[own] if panel.filter_amplitudes else leaks
    return values[:, None] * passed[..., None]


def lit(job: Job) -> bool:
    passed = shown(job, masks(job))
    seen = sorted({beam.channel for beam in _beams(job)})
    return bool(passed[:, seen].any((1, 2, 3)).all())


def masks(job: Job, count: int = 3) -> Array:
    return np.random.default_rng(987654321).random((count, *job.camera.mask_shape))


def scattered(job: Job, transfers: Array) -> Array:
    share = job.conditions.imperfections.stray_light
    spread: Array = (1 - share) * transfers + share * transfers.mean(-1, keepdims=True)
    return spread


def read(job: Job, values: Array) -> Array:
    conditions = job.conditions
    if conditions.full_well:
        values = np.minimum(values, conditions.full_well / conditions.electrons)
    values = values + conditions.black_level
    if conditions.adc_bits:
        most = 2**conditions.adc_bits - 1
        values = np.clip(np.rint(values / conditions.adc_range * most), 0, most)
        values = values * conditions.adc_range / most
    return values


def log_uniform(generator: random.Random, low: float, high: float) -> float:
    return math.exp(generator.uniform(math.log(low), math.log(high)))


def _corner(generator: random.Random, low: float, high: float) -> float:
    if generator.random() < 0.25:
        return generator.choice([low, high])
    return log_uniform(generator, low, high)
