"""The whole of a calibration: three scenes, and what follows from each."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch

from veilcam_client.calibration_models import CalibrationRecord
from veilcam_optics.decoding import Calibration
from veilcam_optics.masks import to_weights
from veilcam_optics.transfer import Reach, TransferOperator
from veilcam_server.calibration import scenes
from veilcam_server.calibration.alignment import NAMES, Alignment, Optics, Sight, align
from veilcam_server.calibration.bench import Bench, Values
from veilcam_server.calibration.darkness import split_darkness
from veilcam_server.calibration.errors import CalibrationError
from veilcam_server.calibration.findings import Findings, make_record
from veilcam_server.calibration.geometry import Geometry
from veilcam_server.calibration.lines import Lines, measure_lines
from veilcam_server.calibration.patterns import Patterns
from veilcam_server.calibration.response import STEPS, Response, Staircase, climb, fit_response
from veilcam_server.calibration.scenes import CalibrationScene
from veilcam_server.calibration.settling import Settling, measure_settling
from veilcam_server.devices.protocols import Device, Levels
from veilcam_server.fence import Fence

_DIM = 0.01
"""Least light of the card through the open panel, over what saturates the sensor."""
_HIDES = 0.5
"""Most light that an opaque panel may let through, over that of the open one."""
_DRIFT = 0.05
"""Largest change of the light while it is measured."""
_MISFIT = 0.1
"""Largest relative error of predicted readings behind patterns that no fit has seen."""
_ROUNDS = 2
"""How often light of the floor, light of dead lines, and gain are fitted in turn."""
_FARTHEST, _TURNED = 1e-3, 20e-3
"""Largest shift [m] and rotation [rad] that decoders can take in."""


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


@dataclass(frozen=True, eq=False, slots=True)
class Calibrated:
    """The record, and the curves that it was made from."""

    record: CalibrationRecord
    findings: Findings


def calibrate(
    device: Device,
    geometry: Geometry,
    present: Callable[[CalibrationScene], None],
    *,
    longest: float,
    exposure: float,
    tab: str | None = None,
    reach: Reach = Reach(),  # noqa: B008 - immutable
    timeout: float = 5.0,
    effort: Effort = Effort(),
    advance: Callable[[], None] = lambda: None,
    check: Callable[[], None] = lambda: None,
    fitting: Callable[[], None] = lambda: None,
    clock: Callable[[], float] = time.monotonic,
) -> Calibrated:
    """Measure a camera with itself. The panel is opaque afterwards, come what may.

    Args:
        device: panel and sensor; it is not closed here.
        geometry: the camera as drawn.
        present: brings a scene before the camera and returns once it is there.
        longest: what the panel's settling may take [s].
        exposure: of readings, for the record [s].
        tab: of the panel, for the record.
        reach: which sub-pixels decoders let interfere.
        timeout: longest wait for one reading [s].
        effort: how much is read.
        advance: called after each of ``effort.captures(geometry)`` exposures.
        check: called after each of them and before each evaluation of a fit; what it raises ends
            the calibration.
        fitting: called once everything is read; the panel is opaque from then on.
        clock: monotonic time [s].

    Raises:
        CalibrationError: the camera, its light or the fit is not good enough, and what to do.
        DeviceError, FenceError: panel or sensor failed.
    """

    def bench(settle: float) -> Bench:
        return Bench(
            device,
            geometry.camera,
            geometry.embedding.shape,
            fence=Fence(settle, timeout),
            repeats=effort.repeats,
            advance=advanced,
            clock=clock,
        )

    def advanced() -> None:
        advance()
        check()

    measurement = _Measurement(geometry, present, reach, effort, check)
    try:
        seen = measurement.read(bench, longest)
    finally:
        device.display.blank()
    fitting()
    found = measurement.fit(seen)
    record = make_record(found, device, exposure=exposure, tab=tab, geometry=geometry.digest)
    return Calibrated(record, found)


@dataclass(frozen=True, eq=False, slots=True)
class _Seen:
    """Everything that was read."""

    unlit: Values
    settling: Settling
    lines: Lines
    staircase: Staircase
    levels: Sequence[Levels]
    sights: tuple[Sight, Sight]
    """Of the card and of the lamp."""
    drift: float


@dataclass(eq=False, slots=True)
class _Measurement:
    geometry: Geometry
    present: Callable[[CalibrationScene], None]
    reach: Reach
    effort: Effort
    check: Callable[[], None]
    stuck_uncertainty: float = 0.0
    """Of what dead lines let through."""

    def read(self, make: Callable[[float], Bench], longest: float) -> _Seen:
        """Ask for scenes, and read them behind patterns."""
        geometry = self.geometry
        bench = make(longest)
        self.present(scenes.dark(geometry.scene))
        # Both: what leaks in around the panel is not told from what comes through it.
        unlit = np.stack([bench.read(bench.opaque), bench.read(bench.open)])
        black = float(unlit.mean())
        card, lamp = scenes.white(geometry.scene), scenes.lamp(geometry.scene)

        self.present(card)
        begin = bench.read(bench.open).mean() - black
        _check_light(begin, black, bench)
        opaque = bench.read(bench.opaque).mean() - black
        if opaque > _HIDES * begin:
            raise CalibrationError(
                "the panel does not hide the scene: check its power and its wiring"
            )
        settling = measure_settling(bench, longest=longest, samples=self.effort.samples)
        # Twice as long: within 2 % is good enough for captures, not for what they are corrected by.
        bench = make(min(longest, 2 * (settling.seconds + settling.uncertainty)))
        operator = TransferOperator(
            geometry.camera,
            geometry.scene,
            geometry.embedding,
            reach=self.reach,
            dtype=torch.float64,
        )
        lines = measure_lines(bench, geometry, card.image.astype(np.float64), operator)
        staircase = climb(bench, black_level=black)
        levels = self.effort.patterns.draw(geometry.camera)
        before_card = self._look(bench, levels, card, black)
        drift = float((bench.read(bench.open).mean() - black) / begin - 1)
        if abs(drift) > _DRIFT:
            raise CalibrationError(
                f"the light changed by {100 * drift:+.2g} % meanwhile: let the lamp warm up and "
                "hold everything still"
            )
        self.present(lamp)
        sights = (before_card, self._look(bench, levels, lamp, black))
        return _Seen(unlit, settling, lines, staircase, levels, sights, drift)

    def fit(self, seen: _Seen) -> Findings:
        """Find the camera that would read what was read."""
        response, alignment = self._fit(seen.levels, seen.sights, seen.lines, seen.staircase)
        predicted, errors = self._verdict(seen.levels, seen.sights, alignment)
        return Findings(
            unlit=seen.unlit,
            settling=seen.settling,
            lines=seen.lines,
            staircase=seen.staircase,
            response=response,
            alignment=alignment,
            stuck_uncertainty=self.stuck_uncertainty,
            card_error=errors[0],
            lamp_error=errors[1],
            drift=seen.drift,
            seen=seen.sights[1].readings[-1],
            predicted=predicted[1, -1],
        )

    def _look(
        self, bench: Bench, levels: Sequence[Levels], scene: CalibrationScene, black: float
    ) -> Sight:
        readings = np.stack([bench.read(each) for each in levels]) - black
        if not readings.mean() > 0:
            raise CalibrationError(f"there is no light from the {scene.name}: light it, try again")
        return Sight(scene.image.astype(np.float64), readings)

    def _fit(
        self,
        levels: Sequence[Levels],
        sights: Sequence[Sight],
        lines: Lines,
        staircase: Staircase,
    ) -> tuple[Response, Alignment]:
        """Coarse patterns first, then all.

        What dead lines let through is not known at first, but is there at every pattern: where
        there are any, the first fits are of what patterns add to the opaque panel's light.
        """
        patterns = self.effort.patterns
        coarse = slice(1, 1 + patterns.coarse)
        every = slice(1, 1 + patterns.coarse + patterns.fine)
        dead = bool(lines.dead_rows or lines.dead_columns)
        response = fit_response(staircase, floor=0.0 if dead else None)
        known = Calibration(
            gamma=response.gamma,
            contrast_floor=response.floor,
            dead_rows=lines.dead_rows,
            dead_columns=lines.dead_columns,
        )
        added = [_added(sight) for sight in sights] if dead else sights
        alignment = self._align(levels, added, known, coarse)
        alignment = self._align(levels, added, alignment.calibration, every)
        for _ in range(_ROUNDS if dead else 0):
            opaque = [replace(sight, readings=sight.readings[:1]) for sight in sights]
            known, floor_spread, self.stuck_uncertainty = split_darkness(
                self.geometry, opaque, alignment.gains, alignment.calibration, reach=self.reach
            )
            response = fit_response(
                staircase, floor=known.contrast_floor, floor_uncertainty=floor_spread
            )
            known = replace(known, gamma=response.gamma)
            alignment = self._align(levels, sights, known, every)
        return response, alignment

    def _align(
        self,
        levels: Sequence[Levels],
        sights: Sequence[Sight],
        start: Calibration,
        used: slice,
    ) -> Alignment:
        return align(
            self.geometry,
            self._shown(levels[used], start),
            [replace(sight, readings=sight.readings[used]) for sight in sights],
            start,
            reach=self.reach,
            check=self.check,
        )

    def _shown(self, levels: Sequence[Levels], calibration: Calibration) -> torch.Tensor:
        panel = self.geometry.camera.panel
        return torch.stack([calibration.shown(to_weights(each, panel)) for each in levels])

    def _verdict(
        self, levels: Sequence[Levels], sights: Sequence[Sight], alignment: Alignment
    ) -> tuple[Values, tuple[float, ...]]:
        """Predicted readings of the held-out patterns, and their relative error for each scene."""
        found = alignment.calibration
        for name, amount, limit, unit in (
            ("shifted", max(abs(found.shift_y), abs(found.shift_x)), _FARTHEST, 1e-3),
            ("turned", abs(found.rotation), _TURNED, 1e-3),
        ):
            if amount > limit:
                kind = "mm" if name == "shifted" else "mrad"
                raise CalibrationError(
                    f"the panel is {name} by {amount / unit:.3g} {kind}, more than decoders can "
                    f"take in ({limit / unit:g}): mount it anew, or check where the card was"
                )
        held_out = slice(-self.effort.patterns.held_out, None)
        optics = Optics(
            self.geometry,
            self._shown(levels[held_out], found),
            [sight.image for sight in sights],
            self.reach,
        )
        place = torch.tensor([getattr(found, name) for name in NAMES], dtype=torch.float64)
        gains = np.array(alignment.gains)[:, None, None, None]
        shape = (len(sights), -1, *self.geometry.embedding.shape)
        predicted: Values = gains * optics.predict(place).numpy().reshape(shape)
        seen = np.stack([sight.readings[held_out] for sight in sights])
        axes = (1, 2, 3)
        errors = np.sqrt(((predicted - seen) ** 2).sum(axes) / (seen**2).sum(axes))
        for name, error in zip(("white card", "lamp"), errors, strict=True):
            if error > _MISFIT:
                raise CalibrationError(
                    f"readings of the {name} are {100 * error:.2g} % off what the optics predict: "
                    "check that card and lamp were where they should be, and no other light was on"
                )
        return predicted, tuple(errors.tolist())


def _added(sight: Sight) -> Sight:
    """What patterns add to the first one, the opaque panel."""
    return replace(sight, readings=sight.readings - sight.readings[0])


def _check_light(light: float, black: float, bench: Bench) -> None:
    if light < _DIM * bench.full_scale:
        raise CalibrationError(
            "too little light comes from the white card: light it, or expose longer"
        )
    if black > light:
        raise CalibrationError(
            "it was not dark when the camera was covered: cover it so that no light gets in"
        )
