"""Everything that a calibration reads: three scenes, behind patterns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch

from veilcam_optics.transfer.operator import Reach, TransferOperator
from veilcam_server.calibration import targets as scenes
from veilcam_server.calibration.alignment import Sight
from veilcam_server.calibration.errors import CalibrationError
from veilcam_server.calibration.lines import Lines, measure_lines
from veilcam_server.calibration.response import STEPS, Staircase, climb
from veilcam_server.calibration.rig import Bench, Geometry, Patterns, Values
from veilcam_server.calibration.settling import Settling, measure_settling
from veilcam_server.calibration.targets import CalibrationScene
from veilcam_server.devices.base import Levels


@dataclass(frozen=True, slots=True)
class Effort:
    """How much is read."""

    repeats: int = 2
    """Exposures for one reading."""
    samples: int = 10
    """Of each step of settling, in each of two passes."""
    patterns: Patterns = field(default_factory=Patterns)

    def captures(self, geometry: Geometry) -> int:
        """How many exposures a calibration takes."""
        single = 3 + 2 + sum(geometry.camera.mask_shape) + 1 + STEPS + 2 * self.patterns.count
        return 1 + 8 * self.samples + self.repeats * single


_DIM = 0.01
"""Least light of the card through the open panel, over what saturates the sensor."""
_HIDES = 0.5
"""Most light that an opaque panel may let through, over that of the open one."""
_DRIFT = 0.05
"""Largest change of the light while it is measured."""


@dataclass(frozen=True, eq=False, slots=True)
class Observations:
    """Everything that was read."""

    unlit: Values
    settling: Settling
    lines: Lines
    staircase: Staircase
    levels: Sequence[Levels]
    sights: tuple[Sight, Sight]
    """Of the card and of the lamp."""
    drift: float


def observe(
    make: Callable[[float], Bench],
    geometry: Geometry,
    present: Callable[[CalibrationScene], None],
    *,
    longest: float,
    reach: Reach,
    effort: Effort,
) -> Observations:
    """Ask for scenes, and read them behind patterns.

    Args:
        make: a bench that grants the panel so long to settle [s].
        geometry: the camera as drawn.
        present: brings a scene before the camera and returns once it is there.
        longest: what the panel's settling may take [s].
        reach: which sub-pixels interfere.
        effort: how much is read.

    Raises:
        CalibrationError: the camera or its light is not good enough, and what to do.
        DeviceError, FenceError: panel or sensor failed.
    """
    bench = make(longest)
    present(scenes.dark(geometry.scene))
    # Both: what leaks in around the panel is not told from what comes through it.
    unlit = np.stack([bench.read(bench.opaque), bench.read(bench.open)])
    black = float(unlit.mean())
    card, lamp = scenes.white(geometry.scene), scenes.lamp(geometry.scene)

    present(card)
    begin = bench.read(bench.open).mean() - black
    _check_light(begin, black, bench)
    opaque = bench.read(bench.opaque).mean() - black
    if opaque > _HIDES * begin:
        raise CalibrationError("the panel does not hide the scene: check its power and its wiring")
    settling = measure_settling(bench, longest=longest, samples=effort.samples)
    # Twice as long: within 2 % is good enough for captures, not for what they are corrected by.
    bench = make(min(longest, 2 * (settling.seconds + settling.uncertainty)))
    operator = TransferOperator(
        geometry.camera,
        geometry.scene,
        geometry.embedding,
        reach=reach,
        dtype=torch.float64,
    )
    lines = measure_lines(bench, geometry, card.image.astype(np.float64), operator)
    staircase = climb(bench, black_level=black)
    levels = effort.patterns.draw(geometry.camera)
    before_card = _look(bench, levels, card, black)
    drift = float((bench.read(bench.open).mean() - black) / begin - 1)
    if abs(drift) > _DRIFT:
        raise CalibrationError(
            f"the light changed by {100 * drift:+.2g} % meanwhile: let the lamp warm up and "
            "hold everything still"
        )
    present(lamp)
    sights = (before_card, _look(bench, levels, lamp, black))
    return Observations(unlit, settling, lines, staircase, levels, sights, drift)


def _look(bench: Bench, levels: Sequence[Levels], scene: CalibrationScene, black: float) -> Sight:
    readings = np.stack([bench.read(each) for each in levels]) - black
    if not readings.mean() > 0:
        raise CalibrationError(f"there is no light from the {scene.name}: light it, try again")
    return Sight(scene.image.astype(np.float64), readings)


def _check_light(light: float, black: float, bench: Bench) -> None:
    if light < _DIM * bench.full_scale:
        raise CalibrationError(
            "too little light comes from the white card: light it, or expose longer"
        )
    if black > light:
        raise CalibrationError(
            "it was not dark when the camera was covered: cover it so that no light gets in"
        )
