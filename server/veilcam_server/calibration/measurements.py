"""Measurements of a calibration: settling time, dead lines, staircase and patterns."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from veilcam_optics.transfer.product import Transfer
from veilcam_optics.transfer.tables import Reach, make_transfer
from veilcam_server.calibration import rig as scenes
from veilcam_server.calibration.alignment import SceneReadings
from veilcam_server.calibration.response import STEPS, Staircase, climb
from veilcam_server.calibration.rig import CalibrationScene, Geometry, Moment, Patterns, Rig, Values
from veilcam_server.devices.base import Levels
from veilcam_server.errors import CalibrationError

SETTLED = 0.02
"""Largest distance from the final value, over the step, that counts as settled."""


@dataclass(frozen=True, slots=True)
class Settling:
    """Times since the panel's last byte [s]."""

    seconds: float
    """Earliest start of an exposure of a settled panel."""
    uncertainty: float
    """Distance of the samples around that start [s]."""
    residual: float
    """Scatter of settled measurements, root mean square over the step."""
    rising: tuple[Moment, ...]
    """From opaque to open; means from 0 to 1."""
    falling: tuple[Moment, ...]


def measure_settling(rig: Rig, *, longest: float, samples: int) -> Settling:
    """Sample both steps at equal distances, then more finely around their ends.

    Args:
        rig: rig in front of a lit scene.
        longest: longest time that settling may take [s].
        samples: number of samples of each step and of each of the two passes.

    Raises:
        CalibrationError: the panel takes longer, or does not change.
    """
    steps: tuple[list[Moment], list[Moment]] = ([], [])
    low, high = 0.0, longest
    end = rig.after(rig.opaque, longest).mean
    for _ in range(2):
        for delay in np.linspace(low, high, samples):
            for moments, levels in zip(steps, (rig.open, rig.opaque), strict=True):
                begin = end
                seen = rig.after(levels, float(delay))
                # Final value of this step, and first value of the next one.
                end = rig.after(levels, longest).mean
                if end == begin:
                    raise CalibrationError(
                        "the panel shows nothing of what it is told: check its power and wiring"
                    )
                moments.append(
                    Moment(seen.started, seen.ended, (seen.mean - begin) / (end - begin))
                )
        low, high = (max(ends) for ends in zip(*(_ends(each) for each in steps), strict=True))
        if high == np.inf:
            raise CalibrationError(
                f"the panel has not settled after {longest * 1000:.3g} ms: give a longer --settle, "
                "or hold the light still"
            )
    settled = [each for moments in steps for each in moments if each.started >= high]
    return Settling(
        seconds=high,
        uncertainty=high - low,
        residual=float(np.sqrt(np.mean([(1 - each.mean) ** 2 for each in settled]))),
        rising=_in_order(steps[0]),
        falling=_in_order(steps[1]),
    )


def _ends(moments: list[Moment]) -> tuple[float, float]:
    """Return starts of the last unsettled exposure (or 0) and of the next one (or inf)."""
    last, first = 0.0, np.inf
    for moment in reversed(_in_order(moments)):
        if abs(1 - moment.mean) > SETTLED:
            last = moment.started
            break
        first = moment.started
    return last, first


def _in_order(moments: list[Moment]) -> tuple[Moment, ...]:
    return tuple(sorted(moments, key=lambda moment: moment.started))


_DEAD = 0.5
"""Share of the typical line's light below which a line is dead."""
_MOST = 0.25
"""Largest share of dead lines along an axis."""


@dataclass(frozen=True, slots=True)
class Lines:
    """Light of each opened row and column, over the expected light."""

    rows: Values = field(repr=False)
    columns: Values = field(repr=False)

    @property
    def dead_rows(self) -> tuple[int, ...]:
        """Numbers of the dead rows, from 0."""
        return _dead(self.rows)

    @property
    def dead_columns(self) -> tuple[int, ...]:
        """Numbers of the dead columns, from 0."""
        return _dead(self.columns)


def measure_lines(rig: Rig, geometry: Geometry, image: Values, transfer: Transfer[Any]) -> Lines:
    """Open each row and each column alone.

    Args:
        rig: rig in front of ``image``.
        geometry: the nominal camera.
        image: (rows, columns) of the scene.
        transfer: transfer of the nominal camera, for the expected light of each line.

    Raises:
        CalibrationError: too many lines are dead.
    """
    rows, columns = geometry.camera.mask_shape
    floor = rig.read(rig.opaque).mean()
    top = int(np.max(rig.open))
    scene = image.reshape(1, -1)
    found = []
    for count, axis in ((rows, 0), (columns, 1)):
        shares = np.empty(count)
        for line in range(count):
            opened = np.zeros((rows, columns), np.uint8)
            opened.swapaxes(0, axis)[line] = top
            expected = float((scene @ transfer(opened / top)).mean())
            shares[line] = (rig.read(opened).mean() - floor) / expected
        typical = float(np.median(shares))
        if not typical > 0:
            raise CalibrationError("single lines let no light through: light the card, try again")
        found.append(shares / typical)
    lines = Lines(*found)
    for name, dead, count in (
        ("rows", lines.dead_rows, rows),
        ("columns", lines.dead_columns, columns),
    ):
        if len(dead) > _MOST * count:
            raise CalibrationError(
                f"{len(dead)} of {count} {name} of the mask do not obey: check the panel's "
                "wiring and that the card is evenly lit"
            )
    return lines


def _dead(shares: Values) -> tuple[int, ...]:
    return tuple(int(line) for line in np.flatnonzero(shares < _DEAD))


@dataclass(frozen=True, slots=True)
class Budget:
    """Number of measurements of each kind."""

    repeats: int = 2
    """Exposures for one measurement."""
    samples: int = 10
    """Samples of each step of settling, in each of two passes."""
    patterns: Patterns = field(default_factory=Patterns)

    def captures(self, geometry: Geometry) -> int:
        """Count the exposures of a calibration."""
        single = 3 + 2 + sum(geometry.camera.mask_shape) + 1 + STEPS + 2 * self.patterns.count
        return 1 + 8 * self.samples + self.repeats * single


_DIM = 0.01
"""Least light of the card through the open panel, over the sensor's full scale."""
_HIDES = 0.5
"""Largest light through an opaque panel, over that through the open one."""
_DRIFT = 0.05
"""Largest relative change of the light during the measurements."""


@dataclass(frozen=True, eq=False, slots=True)
class Measurements:
    """All measurements of a calibration."""

    unlit: Values
    settling: Settling
    lines: Lines
    staircase: Staircase
    levels: Sequence[Levels]
    sights: tuple[SceneReadings, SceneReadings]
    """Measurements of the card and of the lamp."""
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
    """Ask for scenes, and measure them behind patterns.

    Args:
        make: function that returns a rig for a settling time [s].
        geometry: the nominal camera.
        set_scene: function that returns once a scene is in front of the camera.
        longest: longest time that the panel's settling may take [s].
        reach: reach of interference between sub-pixels.
        budget: number of measurements of each kind.

    Raises:
        CalibrationError: the camera or its light is not good enough; the text has a remedy.
        DeviceError, FenceError: panel or sensor failed.
    """
    rig = make(longest)
    set_scene(scenes.dark(geometry.scene))
    # Both panels, since light that leaks in around the panel looks like light through it.
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
    # Twice as long: a rest of 2 % is small for captures, but not for their calibration.
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


def _look(
    rig: Rig, levels: Sequence[Levels], scene: CalibrationScene, black: float
) -> SceneReadings:
    measurements = np.stack([rig.read(each) for each in levels]) - black
    if not measurements.mean() > 0:
        raise CalibrationError(f"there is no light from the {scene.name}: light it, try again")
    return SceneReadings(scene.image.astype(np.float64), measurements)


def _check_light(light: float, black: float, rig: Rig) -> None:
    if light < _DIM * rig.full_scale:
        raise CalibrationError(
            "too little light comes from the white card: light it, or expose longer"
        )
    if black > light:
        raise CalibrationError(
            "it was not dark when the camera was covered: cover it so that no light gets in"
        )
