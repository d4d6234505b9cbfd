"""Measurements of a calibration: three scenes, read behind patterns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from veilcam_optics.transfer.tables import Reach, make_transfer
from veilcam_server.calibration import rig as scenes
from veilcam_server.calibration.alignment import Sight
from veilcam_server.calibration.lines import Lines, measure_lines
from veilcam_server.calibration.response import STEPS, Staircase, climb
from veilcam_server.calibration.rig import CalibrationScene, Geometry, Patterns, Rig, Values
from veilcam_server.calibration.settling import Settling, measure_settling
from veilcam_server.devices.base import Levels
from veilcam_server.errors import CalibrationError


@dataclass(frozen=True, slots=True)
class Budget:
    """Number of measurements of each kind."""

    repeats: int = 2
    """Exposures for one measurement."""
    samples: int = 10
    """Of each step of settling, in each of two passes."""
    patterns: Patterns = field(default_factory=Patterns)

    def captures(self, geometry: Geometry) -> int:
        """Count the exposures of a calibration."""
        single = 3 + 2 + sum(geometry.camera.mask_shape) + 1 + STEPS + 2 * self.patterns.count
        return 1 + 8 * self.samples + self.repeats * single


_DIM = 0.01
"""Least light of the card through the open panel, over what saturates the sensor."""
_HIDES = 0.5
"""Most light that an opaque panel may let through, over that of the open one."""
_DRIFT = 0.05
"""Largest change of the light while it is measured."""


@dataclass(frozen=True, eq=False, slots=True)
class Measurements:
    """Everything that was read."""

    unlit: Values
    settling: Settling
    lines: Lines
    staircase: Staircase
    levels: Sequence[Levels]
    sights: tuple[Sight, Sight]
    """Of the card and of the lamp."""
    drift: float


def measure(
    make: Callable[[float], Rig],
    geometry: Geometry,
    set_scene: Callable[[CalibrationScene], None],
    *,
    longest: float,
    reach: Reach,
    budget: Budget,
) -> Measurements:
    """Ask for scenes, and read them behind patterns.

    Args:
        make: a rig that grants the panel so long to settle [s].
        geometry: the nominal camera.
        set_scene: brings a scene before the camera and returns once it is there.
        longest: longest time that the panel's settling may take [s].
        reach: reach of interference between sub-pixels.
        budget: number of measurements of each kind.

    Raises:
        CalibrationError: the camera or its light is not good enough, and what to do.
        DeviceError, FenceError: panel or sensor failed.
    """
    rig = make(longest)
    set_scene(scenes.dark(geometry.scene))
    # Both: what leaks in around the panel is not told from what comes through it.
    unlit = np.stack([rig.read(rig.opaque), rig.read(rig.open)])
    black = float(unlit.mean())
    card, lamp = scenes.white(geometry.scene), scenes.lamp(geometry.scene)

    set_scene(card)
    begin = rig.read(rig.open).mean() - black
    _check_light(begin, black, rig)
    opaque = rig.read(rig.opaque).mean() - black
    if opaque > _HIDES * begin:
        raise CalibrationError("the panel does not hide the scene: check its power and its wiring")
    settling = measure_settling(rig, longest=longest, samples=budget.samples)
    # Twice as long: within 2 % is good enough for captures, not for what they are corrected by.
    rig = make(min(longest, 2 * (settling.seconds + settling.uncertainty)))
    transfer = make_transfer(
        geometry.camera,
        geometry.scene,
        geometry.embedding,
        reach=reach,
        like=np.empty(0),
    )
    lines = measure_lines(rig, geometry, card.image.astype(np.float64), transfer)
    staircase = climb(rig, black_level=black)
    levels = budget.patterns.draw(geometry.camera)
    before_card = _look(rig, levels, card, black)
    drift = float((rig.read(rig.open).mean() - black) / begin - 1)
    if abs(drift) > _DRIFT:
        raise CalibrationError(
            f"the light changed by {100 * drift:+.2g} % meanwhile: let the lamp warm up and "
            "hold everything still"
        )
    set_scene(lamp)
    sights = (before_card, _look(rig, levels, lamp, black))
    return Measurements(unlit, settling, lines, staircase, levels, sights, drift)


def _look(rig: Rig, levels: Sequence[Levels], scene: CalibrationScene, black: float) -> Sight:
    measurements = np.stack([rig.read(each) for each in levels]) - black
    if not measurements.mean() > 0:
        raise CalibrationError(f"there is no light from the {scene.name}: light it, try again")
    return Sight(scene.image.astype(np.float64), measurements)


def _check_light(light: float, black: float, rig: Rig) -> None:
    if light < _DIM * rig.full_scale:
        raise CalibrationError(
            "too little light comes from the white card: light it, or expose longer"
        )
    if black > light:
        raise CalibrationError(
            "it was not dark when the camera was covered: cover it so that no light gets in"
        )
