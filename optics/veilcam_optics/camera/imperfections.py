"""Imperfections of a built camera, and conditions of light and sensor. All absent by default."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Self

from pydantic import ConfigDict

from veilcam_optics.arrays import Array, namespace
from veilcam_optics.camera.geometry import CHANNELS, Camera
from veilcam_optics.camera.masks import respond
from veilcam_optics.errors import require, require_ratio, require_within

if TYPE_CHECKING:
    import torch


@dataclass(frozen=True, slots=True)
class Spreads:
    """Spreads of built cameras around the nominal one. Zero means none.

    Attributes:
        shift: displacement of the mask along each axis, to either side [m].
        distance: error of the sensor's distance, to either side [m].
        gamma: largest departure of the exponent from 1, to either side; uniform.
        contrast_floor: largest amplitude of a sub-pixel that is told to be dark; uniform.
        normal: True if ``shift`` and ``distance`` are standard deviations of normal distributions,
            False if they are the ends of uniform ones.
    """

    shift: float = 0.0
    distance: float = 0.0
    gamma: float = 0.0
    contrast_floor: float = 0.0
    normal: bool = False


@dataclass(frozen=True, slots=True)
class Imperfections:
    """Departures of a camera as built from the nominal one.

    Attributes:
        shift_y: displacement of the mask along y [m].
        shift_x: displacement of the mask along x [m].
        rotation: rotation of the mask around the axis, from x towards y [rad].
        distance_error: distance by which the sensor is farther than ``camera.distance`` [m].
        gamma: the panel shows the amplitude ``w^gamma``.
        contrast_floor: amplitude of a sub-pixel that is told to be dark.
        dead_rows: mask rows that do not obey, from 0.
        dead_columns: mask columns that do not obey, from 0.
        dead_transmittance: amplitude that those pass.
        stray_light: share of the light on the sensor that is spread evenly over it.

    Raises:
        OpticsError: a number that no camera can have.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(
        extra="forbid", strict=True, allow_inf_nan=False
    )

    shift_y: float = 0.0
    shift_x: float = 0.0
    rotation: float = 0.0
    distance_error: float = 0.0
    gamma: float = 1.0
    contrast_floor: float = 0.0
    dead_rows: tuple[int, ...] = ()
    dead_columns: tuple[int, ...] = ()
    dead_transmittance: float = 0.0
    stray_light: float = 0.0

    def __post_init__(self) -> None:
        for name, unit, low, high in (
            ("shift_y", "m", -math.inf, math.inf),
            ("shift_x", "m", -math.inf, math.inf),
            ("rotation", "rad", -math.pi, math.pi),
            ("distance_error", "m", -math.inf, math.inf),
            ("gamma", "", 0.1, 10),
            ("contrast_floor", "", 0, 0.99),
            ("dead_transmittance", "", 0, 1),
            ("stray_light", "", 0, 1),
        ):
            require_within(f"imperfections.{name}", getattr(self, name), unit, low, high)

    @classmethod
    def sample(cls, spreads: Spreads, generator: torch.Generator | None = None) -> Self:
        """One camera drawn at random; what has no spread takes no random number.

        Args:
            spreads: spreads around the nominal camera.
            generator: None is torch's own.
        """
        import torch  # noqa: PLC0415 - training draws cameras, and a device is one

        y = x = along = 0.0
        if spreads.shift or spreads.distance:
            draws = torch.empty(3, dtype=torch.float64)
            if spreads.normal:
                draws.normal_(generator=generator)
            else:
                draws.uniform_(-1, 1, generator=generator)
            y, x, along = draws.tolist()
        gamma, floor = (
            float(torch.rand((), generator=generator)) if largest else 0.0
            for largest in (spreads.gamma, spreads.contrast_floor)
        )
        return cls(
            shift_y=spreads.shift * y,
            shift_x=spreads.shift * x,
            distance_error=spreads.distance * along,
            gamma=1 + spreads.gamma * (2 * gamma - 1),
            contrast_floor=spreads.contrast_floor * floor,
        )

    def check(self, camera: Camera) -> None:
        """Raise :class:`OpticsError` if ``camera`` cannot have them."""
        require(
            self.distance_error > -camera.distance,
            "imperfections.distance_error",
            self.distance_error,
            "m",
            f"more than minus the camera's distance, {-camera.distance:.3e} m",
        )
        self._check_lines(camera.mask_shape)

    def actual(self, camera: Camera) -> Camera:
        """Return the camera with the distance that it really has."""
        return replace(camera, distance=camera.distance + self.distance_error)

    def shown(self, weights: Array) -> Array:
        """Amplitudes that the panel shows when it is told ``weights``, same shape; differentiable.

        Args:
            weights: amplitudes asked of the panel, (..., rows, columns), in [0, 1].

        Raises:
            OpticsError: a dead row or column that the mask does not have.
        """
        shown = respond(weights, gamma=self.gamma, contrast_floor=self.contrast_floor)
        if not (self.dead_rows or self.dead_columns):
            return shown
        self._check_lines((weights.shape[-2], weights.shape[-1]))
        copied: Array = namespace(shown).asarray(shown, copy=True)
        copied[..., list(self.dead_rows), :] = self.dead_transmittance
        copied[..., list(self.dead_columns)] = self.dead_transmittance
        return copied

    def _check_lines(self, shape: tuple[int, int]) -> None:
        for name, count in zip(("dead_rows", "dead_columns"), shape, strict=True):
            for line in getattr(self, name):
                require(0 <= line < count, f"imperfections.{name}", line, "", f"0 to {count - 1}")


NOMINAL = Imperfections()
"""A camera without any."""


@dataclass(frozen=True, slots=True)
class Conditions:
    """Departures from a nominal camera in front of a flat, still, monochromatic scene.

    A zero (an infinite ``snr_db``) means: not there. What is there is computed only where a plan
    finds that it matters.

    Attributes:
        bandwidth: full width at half maximum of the light of R, G and B [m]; a Gaussian spectrum.
        depth_range: the scene's pixels lie evenly spread over this depth, centred on the scene's
            distance [m].
        imperfections: departures of the camera as built.
        levels: number of amplitudes that the panel can show; 0 for any.
        bayer: every sensor pixel reads one colour (RGGB), and embedding pixels cut through them.
        snr_db: signal-to-noise ratio of shot noise in every embedding [dB], where photons are not
            counted; infinite for none.
        electrons: photo-electrons in an embedding value of 1 (all-white scene, no mask); then shot
            noise follows from the count. 0: not counted.
        read_noise: standard deviation of the noise of reading one embedding value [electrons].
        full_well: electrons at which an embedding value saturates.
        adc_bits: bits of the converter.
        adc_range: embedding value at which the converter ends; 0: the full well, or 1 without one.
        black_level: offset that the camera adds to every measurement [embedding value].
    """

    bandwidth: tuple[float, float, float] = (0.0, 0.0, 0.0)
    depth_range: float = 0.0
    imperfections: Imperfections = NOMINAL
    levels: int = 0
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
            require_within(f"conditions.bandwidth[{channel}]", width, "m", 0, 1e-6)
        for name, unit in (
            ("depth_range", "m"),
            ("electrons", "electrons"),
            ("read_noise", "electrons"),
            ("full_well", "electrons"),
            ("black_level", ""),
            ("adc_range", ""),
        ):
            require_within(f"conditions.{name}", getattr(self, name), unit, 0, math.inf)
        for name, low, high in (("levels", 2, 65536), ("adc_bits", 1, 24)):
            value = getattr(self, name)
            require(
                value == 0 or (type(value) is int and low <= value <= high),
                f"conditions.{name}",
                value,
                "",
                f"0 (none) or an integer {low} to {high}",
            )
        require_ratio("conditions.snr_db", self.snr_db)
        require(
            self.electrons == 0 or self.snr_db == math.inf,
            "conditions.snr_db",
            self.snr_db,
            "dB",
            "inf where electrons count the shot noise",
        )
        for name in ("read_noise", "full_well"):
            require(
                self.electrons > 0 or not getattr(self, name),
                "conditions.electrons",
                0,
                "electrons",
                f"> 0 to give {name} a scale",
            )


IDEAL = Conditions()
"""Nothing beyond the ideal."""
