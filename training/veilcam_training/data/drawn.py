"""Pictures of five shapes that a program draws, for a first fit; no two are alike."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from veilcam_training.errors import require

Point = tuple[float, float]

SIDE = 64
"""Rows and columns of a picture."""
SMOOTH = 4
"""Drawn so many times larger, then reduced."""
TEST_SHARE = 0.2


def _polygon(corners: int, inner: float = 1.0) -> list[Point]:
    """Return a regular polygon of radius 1, first corner up; every second corner at ``inner``."""
    steps = corners if inner == 1 else 2 * corners
    radii = [1.0 if number % 2 == 0 else inner for number in range(steps)]
    angles = [2 * math.pi * number / steps - math.pi / 2 for number in range(steps)]
    pairs = zip(radii, angles, strict=True)
    return [(radius * math.cos(angle), radius * math.sin(angle)) for radius, angle in pairs]


def _cross(width: float = 0.3) -> list[Point]:
    arm = [(width, -1.0), (width, -width), (1.0, -width)]
    corners = []
    for _ in range(4):
        corners += arm
        arm = [(-y, x) for x, y in arm]
    return corners


SHAPES: Mapping[str, Callable[[], list[Point]]] = {
    "circle": lambda: _polygon(48),
    "cross": _cross,
    "square": lambda: [(-0.8, -0.8), (0.8, -0.8), (0.8, 0.8), (-0.8, 0.8)],
    "star": lambda: _polygon(5, inner=0.4),
    "triangle": lambda: _polygon(3),
}
"""Corners of each in the unit circle, x to the right and y down."""


def draw_shape(name: str, random: np.random.Generator) -> Image.Image:
    """One picture, gray: a bright shape on a dim, uneven ground.

    Size (half to all of what fits), place (10 % of the side), angle (15 degrees), brightness and
    ground differ from picture to picture.
    """
    size = SIDE * SMOOTH
    radius = size * random.uniform(0.22, 0.38)
    angle = math.radians(random.uniform(-15, 15))
    x, y = size / 2 + size * random.uniform(-0.1, 0.1, 2)
    turned = [
        (
            x + radius * (a * math.cos(angle) - b * math.sin(angle)),
            y + radius * (a * math.sin(angle) + b * math.cos(angle)),
        )
        for a, b in SHAPES[name]()
    ]
    shape = Image.new("L", (size, size))
    ImageDraw.Draw(shape).polygon(turned, fill=255)
    covered = np.asarray(shape.resize((SIDE, SIDE), Image.Resampling.BOX)) / 255
    slope = np.linspace(-1, 1, SIDE)
    tilt = random.uniform(-0.05, 0.05, 2)
    ground = random.uniform(0, 0.2) + 0.05 + tilt[0] * slope[:, None] + tilt[1] * slope
    light = ground + covered * (random.uniform(0.6, 1.0) - ground)
    light += random.normal(0, 0.02, light.shape)
    return Image.fromarray((255 * np.clip(light, 0, 1)).round().astype(np.uint8))


def draw_folder(folder: Path, count: int, seed: int) -> None:
    """Write ``count`` pictures, as many of each shape, as ``train/SHAPE/`` and ``test/SHAPE/``.

    Raises:
        TrainingError: too few for both parts, or a folder that is not empty.
    """
    each = count // len(SHAPES)
    tested = round(TEST_SHARE * each)
    require(tested > 0, f"{count} pictures are too few: use {5 * len(SHAPES)} or more")
    require(
        not folder.exists() or (folder.is_dir() and not any(folder.iterdir())),
        f"{folder} is not empty: give a new folder",
    )
    random = np.random.default_rng(seed)
    for name in SHAPES:
        for number in range(each):
            part = "test" if number < tested else "train"
            path = folder / part / name / f"{name}-{number:04}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            draw_shape(name, random).save(path)
