"""Cost of a model: numbers held and operations done, and from them milliseconds.

The rates are those of one core of a server processor. They need not be right for another: only the
order of the settings must be, and the ratio of arithmetic to overhead hardly changes it.
"""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch

from veilcam_optics.camera.geometry import CHANNELS, Camera
from veilcam_optics.effects.composition import beams
from veilcam_optics.effects.light import zone_counts
from veilcam_optics.effects.mask import actual_camera
from veilcam_optics.effects.model import Model
from veilcam_optics.simulation.rotated_mask import covered_sides
from veilcam_optics.transfer.grid import sample_pitch
from veilcam_optics.transfer.tables import Reach

_PRODUCTS_PER_MS = {torch.float32: 2.0e7, torch.float64: 0.9e7}
_NUMBERS_PER_MS = {torch.float32: 1.2e6, torch.float64: 0.5e6}
_FIXED_MS, _ZONE_MS, _STACK_MS, _SCENE_MS, _GRID_MS = 0.15, 0.09, 0.045, 0.02, 2.5
"""What a step, each zone of the field, each stack of pairs, each scene by factors and each sample
of light on a grid take beside their products: measured for masks of a few sub-pixels."""

_FIELD_VALUES_PER_MS = 3e3
_BUILDS_PER_STEP = 1e-4
"""A model is made once and used for many steps: ten thousand, as in a training run."""


@dataclass(frozen=True, slots=True)
class Cost:
    """Cost of one step: a new mask, and a batch of scenes behind it.

    Attributes:
        step_ms: time of a step [ms].
        build_ms: time to make the operator, once [ms].
        numbers: most numbers held at once.
    """

    step_ms: float
    build_ms: float
    numbers: float

    @property
    def rank(self) -> float:
        """Time that plans are compared by [ms]."""
        return self.step_ms + _BUILDS_PER_STEP * self.build_ms


def pairs(model: Model) -> tuple[int, int, int]:
    """(row pairs over all column offsets, row pairs times column pairs, stacks) of one zone."""
    reach = model.sampling.reach if model.sampling.diffraction else Reach(0, 0)
    shares = model.camera.sensor.channel_weights
    channels = tuple(
        beam.channel for beam in beams(model) if shares[beam.channel] or model.conditions.bayer
    )
    rotated = model.conditions.imperfections.rotation != 0
    return _counted(model.camera, reach, channels, rotated, model.conditions.bayer)


@lru_cache(maxsize=128)
def _counted(
    camera: Camera, reach: Reach, channels: tuple[int, ...], rotated: bool, apart: bool
) -> tuple[int, int, int]:
    """As :func:`pairs`, of a camera; the same few are asked for again and again.

    Args:
        camera: camera whose pairs are counted.
        reach: reach of interference.
        channels: channel of every beam.
        rotated: True where slopes are needed, too.
        apart: True where colours are kept apart.
    """
    rows, columns = camera.mask_shape
    far_rows, far_columns = min(reach.rows, rows - 1), min(reach.columns, columns - 1)
    row_pairs = products = 0
    stacks = set()
    for channel in set(channels):
        by_offset = meetings(camera, channel)[: far_rows + 1]
        for dc in range(far_columns + 1):
            count = sum(by_offset) + (sum(by_offset[1:]) if dc else 0)
            if not count:
                continue
            parts = (2 if dc else 1) * channels.count(channel) * (3 if rotated else 1)
            row_pairs += parts * count
            products += parts * count * (columns - dc)
            # Those of one shape are multiplied at once; colours that are kept apart are not.
            stacks.add((channel if apart else 0, dc, count))
    return row_pairs, products, len(stacks)


@lru_cache(maxsize=128)
def meetings(camera: Camera, channel: int) -> tuple[int, ...]:
    """Return the number of pairs of rows 0, 1, 2, ... apart that both pass a channel's light."""
    lit = (np.array(camera.row_amplitudes(channel)) > 0).astype(float)
    together = np.fft.irfft(abs(np.fft.rfft(lit, 2 * len(lit))) ** 2)[: len(lit)]
    return tuple(int(count) for count in np.rint(together))


def nodes(model: Model) -> tuple[int, int]:
    """Integration nodes along y and x."""
    height, width = actual_camera(model).lit_sides(model.scene)
    # Python's integers do not overflow where a scene a mile wide meets a step of a picometre.
    return math.ceil(height / model.sampling.step), math.ceil(width / model.sampling.step)


def cost(model: Model, batch: int) -> Cost:
    """Estimated cost of embedding ``batch`` scenes behind a new mask."""
    if model.sampling.method == "grid":
        return _grid_cost(model, batch)
    scene, embedding, dtype = model.scene, model.embedding, model.sampling.dtype
    row_pairs, products, stacks = pairs(model)
    down, across = zone_counts(model)
    offsets_y, offsets_x = scene.rows * embedding.rows, scene.columns * embedding.columns
    colours = len(CHANNELS) if model.conditions.bayer else 1
    matrix = colours * offsets_y * offsets_x
    kernels = (offsets_y + offsets_x) * row_pairs * max(down, across)
    if model.sampling.method == "transfer":
        # Every row of zones spreads the products along x anew.
        multiplied = down * products * offsets_x + row_pairs * offsets_y * offsets_x
        multiplied += batch * scene.rows * scene.columns * embedding.size
        moved = 2 * matrix * (2 if colours > 1 else 1) + 2 * batch * embedding.size
        numbers = 2 * matrix + kernels + row_pairs * offsets_x
    else:
        spread = row_pairs * offsets_x
        each = spread * scene.rows + row_pairs * offsets_y * embedding.columns
        multiplied = down * products * offsets_x + batch * each
        # Each scene makes (pairs, rows, columns) numbers and lays them out anew.
        moved = down * spread + 3 * batch * row_pairs * scene.rows * embedding.columns
        numbers = kernels + spread + 3 * row_pairs * scene.rows * embedding.columns
    each_zone = _ZONE_MS + _STACK_MS * stacks
    if model.sampling.method == "factors":
        each_zone += _SCENE_MS * batch * colours
    step = (
        _FIXED_MS
        + multiplied / _PRODUCTS_PER_MS[dtype]
        + moved / _NUMBERS_PER_MS[dtype]
        + each_zone * down * across
    )
    nodes_y, nodes_x = nodes(model)
    rows, columns = model.camera.mask_shape
    fields = len(beams(model)) * down * across * (nodes_y * rows + nodes_x * columns)
    build = 1.0 if not model.sampling.diffraction else fields / _FIELD_VALUES_PER_MS
    build += kernels / 2e4
    return Cost(step, build, numbers)


def _grid_cost(model: Model, batch: int) -> Cost:
    """One propagation per sample of light and channel, one convolution per scene and channel."""
    scene, built, dtype = model.scene, model.conditions.imperfections, model.sampling.dtype
    pitch = sample_pitch(model.camera, model.sampling.oversampling)
    mask = covered_sides(model.camera, built.rotation, shift_y=built.shift_y, shift_x=built.shift_x)
    target = actual_camera(model).lit_sides(scene)
    padded = [math.ceil((a + b) / pitch) for a, b in zip(mask, target, strict=True)]
    cells = float(padded[0]) * padded[1]
    lights = len(CHANNELS) * max(1, len(beams(model)) // len(CHANNELS))
    lights *= math.prod(zone_counts(model))
    transform = 5 * cells * math.log2(max(cells, 2))
    multiplied = lights * 2 * transform
    series = [math.ceil(length / pitch) for length in target]
    each = series[1] * (
        scene.rows * scene.columns + series[0] * (scene.rows + model.embedding.rows)
    )
    multiplied += lights * (batch * 2 * each + transform)
    step = _FIXED_MS + lights * _GRID_MS + multiplied / 2e6
    step += lights * cells * 4 / _NUMBERS_PER_MS[dtype]
    return Cost(step, lights * cells / 1e4, (4 * lights + 12) * cells)
