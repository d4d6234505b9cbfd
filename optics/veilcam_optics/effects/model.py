"""A model of the light: camera, scene, embedding, conditions, and how finely each is computed."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from veilcam_optics.camera.geometry import CHANNELS, Camera, Embedding, Scene
from veilcam_optics.camera.imperfections import IDEAL, Conditions
from veilcam_optics.camera.masks import quantise, respond
from veilcam_optics.errors import invalid, require_count, require_positive
from veilcam_optics.transfer.kernels import Approximation
from veilcam_optics.transfer.operator import Beam, Reach

Method = Literal["transfer", "factors", "grid"]

_DEVIATIONS = 2 * math.sqrt(2 * math.log(2))
"""Standard deviations in the full width at half maximum of a normal distribution."""


@dataclass(frozen=True, slots=True)
class Sampling:
    """How the light is computed: what is left out, and how finely the rest is sampled.

    Attributes:
        method: ``"transfer"`` forms the matrix from scene to embedding; ``"factors"`` applies its
            factors without forming it; ``"grid"`` propagates a field and convolves.
        diffraction: False for the geometric shadow of every sub-pixel.
        spherical: False for a scene at infinity.
        binning: False to read an embedding value at its pixel's centre.
        shot: False to leave the photon noise out.
        reach: which sub-pixels interfere.
        wavelengths: samples of each channel's spectrum.
        layers: samples of the scene's depth.
        zones: parts of the field along each side, each with a point spread function of its own.
        step: largest distance of integration nodes [m] (not for the grid).
        oversampling: samples per 8 sensor pixels (for the grid alone).
        dtype: of the result.
    """

    method: Method = "transfer"
    diffraction: bool = True
    spherical: bool = True
    binning: bool = True
    shot: bool = True
    reach: Reach = field(default_factory=Reach)
    wavelengths: int = 1
    layers: int = 1
    zones: int = 1
    step: float = 1.55e-6
    oversampling: float = 2.0
    dtype: torch.dtype = torch.float32

    def __post_init__(self) -> None:
        if self.method not in {"transfer", "factors", "grid"}:
            raise invalid(
                "sampling.method", repr(self.method), "", '"transfer", "factors" or "grid"'
            )
        for name in ("wavelengths", "layers", "zones"):
            require_count(f"sampling.{name}", getattr(self, name))
        require_positive("sampling.step", self.step, "m")
        require_positive("sampling.oversampling", self.oversampling, "")
        if self.dtype not in {torch.float32, torch.float64}:
            raise invalid("sampling.dtype", self.dtype, "", "torch.float32 or torch.float64")


@dataclass(frozen=True, slots=True)
class Zone:
    """A block of scene pixels that share one point spread function.

    Attributes:
        rows: scene rows.
        columns: scene columns.
        tangent_y: tangent of the angle to the axis, along y, at the block's centre.
        tangent_x: along x.
    """

    rows: slice
    columns: slice
    tangent_y: float
    tangent_x: float

    @property
    def stretch(self) -> tuple[float, float]:
        """Factors on the wavelength along y and x.

        Around a ray at angle theta, the second derivative of the distance ``R`` to a point is
        ``(1 - u^2) / R``, ``u`` the direction cosine along that axis, and ``R = d / cos theta``:
        the paraxial field of a longer wavelength.
        """
        squares = 1 + self.tangent_y**2 + self.tangent_x**2
        y, x = (t * t / squares for t in (self.tangent_y, self.tangent_x))
        return math.sqrt(squares) / (1 - y), math.sqrt(squares) / (1 - x)


@dataclass(frozen=True)
class Model:
    """Everything an embedding is computed from, short of scene, mask and random numbers.

    Raises:
        OpticsError: conditions that this camera or scene cannot have.
    """

    camera: Camera
    scene: Scene
    embedding: Embedding
    conditions: Conditions = IDEAL
    sampling: Sampling = field(default_factory=Sampling)

    def __post_init__(self) -> None:
        camera, scene, conditions = self.camera, self.scene, self.conditions
        for name, width, wavelength in zip(
            CHANNELS, conditions.bandwidth, camera.wavelengths, strict=True
        ):
            if width > wavelength / 2:
                valid = f"at most half the wavelength, {wavelength / 2:.3e} m"
                raise invalid(f"conditions.bandwidth[{name}]", width, "m", valid)
        if conditions.depth_range > scene.distance:
            valid = f"at most the scene's distance, {scene.distance:.3e} m"
            raise invalid("conditions.depth_range", conditions.depth_range, "m", valid)
        if conditions.distance_error <= -camera.distance:
            valid = f"more than minus the camera's distance, {-camera.distance:.3e} m"
            raise invalid("conditions.distance_error", conditions.distance_error, "m", valid)

    def with_sampling(
        self,
        *,
        reach: Reach | None = None,
        step: float | None = None,
        wavelengths: int | None = None,
        layers: int | None = None,
        zones: int | None = None,
    ) -> Model:
        """The same model computed otherwise; None keeps what is there."""
        sampling = self.sampling
        return replace(
            self,
            sampling=replace(
                sampling,
                reach=reach or sampling.reach,
                step=step or sampling.step,
                wavelengths=wavelengths or sampling.wavelengths,
                layers=layers or sampling.layers,
                zones=zones or sampling.zones,
            ),
        )

    @property
    def actual_camera(self) -> Camera:
        """The camera with the distance it really has."""
        error = self.conditions.distance_error
        if not error:
            return self.camera
        return replace(self.camera, distance=self.camera.distance + error)

    @property
    def approximation(self) -> Approximation:
        """What the kernels leave out."""
        sampling = self.sampling
        return Approximation(
            shadow=not sampling.diffraction,
            plane_wave=not sampling.spherical,
            point_reading=not sampling.binning,
        )

    def shown(self, weights: Tensor) -> Tensor:
        """Amplitudes that the panel shows when it is told ``weights``, same shape."""
        conditions = self.conditions
        if conditions.levels:
            weights = quantise(weights, replace(self.camera.panel, levels=conditions.levels))
        return respond(weights, gamma=conditions.gamma, contrast_floor=conditions.contrast_floor)

    def beams(self, zone: Zone | None = None) -> list[Beam]:
        """What each channel adds up: samples of its spectrum times samples of the depth."""
        stretch = (1.0, 1.0) if zone is None else zone.stretch
        distances: list[tuple[float | None, float]] = [(None, 1.0)]
        if self.conditions.depth_range and self.sampling.layers > 1:
            # Gauss-Legendre: the layers lie where a smooth function's mean is best sampled.
            nodes, shares = np.polynomial.legendre.leggauss(self.sampling.layers)
            half = self.conditions.depth_range / 2
            distances = [
                (self.scene.distance + half * float(node), float(share) / 2)
                for node, share in zip(nodes, shares, strict=True)
            ]
        return [
            Beam(channel, wavelength, share * part, distance, stretch)
            for channel in range(len(CHANNELS))
            for wavelength, share in self._spectrum(channel)
            for distance, part in distances
        ]

    def _spectrum(self, channel: int) -> Iterator[tuple[float, float]]:
        """Wavelengths and shares: Gauss-Hermite quadrature of a Gaussian line."""
        centre, width = self.camera.wavelengths[channel], self.conditions.bandwidth[channel]
        if not width or self.sampling.wavelengths == 1:
            yield centre, 1.0
            return
        nodes, shares = np.polynomial.hermite_e.hermegauss(self.sampling.wavelengths)
        for node, share in zip(nodes, shares / shares.sum(), strict=True):
            yield centre + width / _DEVIATIONS * float(node), float(share)

    def tangents(self) -> tuple[Tensor, Tensor]:
        """Tangent of the angle to the axis of every scene row, and of every column, float64."""
        scale = math.tan(self.conditions.off_axis) * 2 / self.scene.rows
        return tuple(  # type: ignore[return-value]
            (torch.arange(count, dtype=torch.float64) - (count - 1) / 2) * scale
            for count in self.scene.shape
        )

    def fade(self) -> Tensor:
        """Share of the light that each scene pixel keeps, cos^4 of its angle, float64 (rows, cols).

        Lambert's law, the tilted mask, and twice the distance (Goodman, section 4.2.1).
        """
        y, x = self.tangents()
        return (1 + y.square()[:, None] + x.square()).pow(-2)

    def zones(self) -> list[list[Zone]]:
        """The parts of the scene, by rows and columns."""
        y, x = self.tangents()
        parts = []
        for positions in (y, x):
            count = min(self.sampling.zones if self.conditions.off_axis else 1, len(positions))
            edges = [round(k * len(positions) / count) for k in range(count + 1)]
            parts.append([slice(a, b) for a, b in pairwise(edges)])
        return [
            [
                Zone(rows, columns, float(y[rows].mean()), float(x[columns].mean()))
                for columns in parts[1]
            ]
            for rows in parts[0]
        ]
