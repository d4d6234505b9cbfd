"""What a camera and a scene do beyond the ideal. Everything is absent by default."""

from __future__ import annotations

import math
from dataclasses import dataclass

from veilcam_optics.camera.geometry import CHANNELS, Scene
from veilcam_optics.errors import invalid


@dataclass(frozen=True, slots=True)
class Conditions:
    """Departures from an ideal camera in front of a flat, still, monochromatic scene.

    A zero (an infinite ``snr_db``, a ``gamma`` of 1) means: not there. What is there is computed
    only where a plan finds that it matters.

    Attributes:
        bandwidth: full width at half maximum of the light of R, G and B [m]; a Gaussian spectrum.
        depth_range: the scene's pixels lie evenly spread over this depth, centred on the scene's
            distance [m].
        off_axis: angle between the axis and the scene's upper edge up to which the point spread
            function is let change and fade over the field [rad]; see :func:`half_field`.
        gamma: the panel shows the amplitude ``w^gamma``.
        contrast_floor: amplitude of a sub-pixel that is told to be dark.
        levels: how many amplitudes the panel can show; 0 for any.
        shift_y: displacement of the mask along y [m].
        shift_x: displacement of the mask along x [m].
        rotation: of the mask around the axis, from x towards y [rad].
        distance_error: how much farther than ``camera.distance`` the sensor is [m].
        stray_light: share of the light on the sensor that is spread evenly over it.
        bayer: every sensor pixel reads one colour (RGGB), and embedding pixels cut through them.
        snr_db: signal-to-noise ratio of shot noise in every embedding [dB], where photons are not
            counted; infinite for none.
        electrons: photo-electrons in an embedding value of 1 (all-white scene, no mask); then shot
            noise follows from the count. 0: not counted.
        read_noise: standard deviation of the noise of reading one embedding value [electrons].
        full_well: electrons at which an embedding value saturates.
        adc_bits: bits of the converter.
        adc_range: embedding value at which the converter ends; 0: the full well, or 1 without one.
        black_level: offset that the camera adds to every reading [embedding value].
    """

    bandwidth: tuple[float, float, float] = (0.0, 0.0, 0.0)
    depth_range: float = 0.0
    off_axis: float = 0.0
    gamma: float = 1.0
    contrast_floor: float = 0.0
    levels: int = 0
    shift_y: float = 0.0
    shift_x: float = 0.0
    rotation: float = 0.0
    distance_error: float = 0.0
    stray_light: float = 0.0
    bayer: bool = False
    snr_db: float = math.inf
    electrons: float = 0.0
    read_noise: float = 0.0
    full_well: float = 0.0
    adc_bits: int = 0
    adc_range: float = 0.0
    black_level: float = 0.0

    def __post_init__(self) -> None:
        for channel, width in zip(CHANNELS, self.bandwidth, strict=True):
            _within(f"conditions.bandwidth[{channel}]", width, "m", 0, 1e-6)
        for name, unit in (
            ("depth_range", "m"),
            ("electrons", "electrons"),
            ("read_noise", "electrons"),
            ("full_well", "electrons"),
            ("black_level", ""),
            ("adc_range", ""),
        ):
            _within(f"conditions.{name}", getattr(self, name), unit, 0, math.inf)
        for name, unit in (("shift_y", "m"), ("shift_x", "m"), ("distance_error", "m")):
            _within(f"conditions.{name}", getattr(self, name), unit, -math.inf, math.inf)
        _within("conditions.off_axis", self.off_axis, "rad", 0, 1.4)
        _within("conditions.rotation", self.rotation, "rad", -math.pi, math.pi)
        _within("conditions.contrast_floor", self.contrast_floor, "", 0, 0.99)
        _within("conditions.stray_light", self.stray_light, "", 0, 1)
        _within("conditions.gamma", self.gamma, "", 0.1, 10)
        for name, low, high in (("levels", 2, 65536), ("adc_bits", 1, 24)):
            value = getattr(self, name)
            if value != 0 and not (type(value) is int and low <= value <= high):
                raise invalid(
                    f"conditions.{name}", value, "", f"0 (none) or an integer {low} to {high}"
                )
        if math.isnan(self.snr_db) or self.snr_db == -math.inf:
            raise invalid(
                "conditions.snr_db", self.snr_db, "dB", "a finite number, or inf for none"
            )
        if self.electrons and self.snr_db != math.inf:
            raise invalid(
                "conditions.snr_db", self.snr_db, "dB", "inf where electrons count the shot noise"
            )
        for name in ("read_noise", "full_well"):
            if getattr(self, name) and not self.electrons:
                raise invalid("conditions.electrons", 0, "electrons", f"> 0 to give {name} a scale")


def half_field(scene: Scene) -> float:
    """Angle between the axis and the upper edge of ``scene`` [rad]."""
    return math.atan(scene.height / 2 / scene.distance)


def _within(argument: str, value: float, unit: str, low: float, high: float) -> None:
    if not (math.isfinite(value) and low <= value <= high):
        ends = f"a finite number of at least {low}" if high == math.inf else f"{low} to {high}"
        raise invalid(argument, value, unit, "a finite number" if low == -math.inf else ends)


IDEAL = Conditions()
"""Nothing beyond the ideal."""
