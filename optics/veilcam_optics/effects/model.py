"""A model of the light: camera, scene, embedding, conditions, and how finely each is computed."""

from dataclasses import dataclass, field, replace
from typing import Any, Literal, Self

import torch

from veilcam_optics.camera.geometry import CHANNELS, Camera, Embedding, Scene
from veilcam_optics.camera.imperfections import IDEAL, Conditions
from veilcam_optics.errors import require, require_choice, require_count, require_positive
from veilcam_optics.transfer.kernels import Approximation
from veilcam_optics.transfer.tables import Reach

Method = Literal["transfer", "factors", "grid"]


@dataclass(frozen=True, slots=True)
class Sampling:
    """Sampling of the light: the parts that are left out, and how finely the rest is sampled.

    Attributes:
        method: ``"transfer"`` forms the matrix from scene to embedding; ``"factors"`` applies its
            factors without forming it; ``"grid"`` propagates a field and convolves.
        diffraction: False for the geometric shadow of every sub-pixel.
        spherical: False for a scene at infinity.
        binning: False to read an embedding value at its pixel's centre.
        oblique: False to take light from every scene pixel for light along the axis.
        shot: False to leave the photon noise out.
        reach: distance up to which sub-pixels interfere.
        wavelengths: samples of each channel's spectrum.
        layers: samples of the scene's depth.
        zones: parts of the field along each side, each with a point spread function of its own.
        step: largest distance of integration nodes [m] (not for the grid).
        oversampling: samples per 8 sensor pixels (for the grid alone).
        dtype: type of the result.
    """

    method: Method = "transfer"
    diffraction: bool = True
    spherical: bool = True
    binning: bool = True
    oblique: bool = True
    shot: bool = True
    reach: Reach = field(default_factory=Reach)
    wavelengths: int = 1
    layers: int = 1
    zones: int = 1
    step: float = 1.55e-6
    oversampling: float = 2.0
    dtype: torch.dtype = torch.float32

    def __post_init__(self) -> None:
        require_choice("sampling.method", self.method, ("transfer", "factors", "grid"))
        for name in ("wavelengths", "layers", "zones"):
            require_count(f"sampling.{name}", getattr(self, name))
        require_positive("sampling.step", self.step, "m")
        require_positive("sampling.oversampling", self.oversampling, "")
        require_choice("sampling.dtype", self.dtype, (torch.float32, torch.float64))


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
            require(
                width <= wavelength / 2,
                f"conditions.bandwidth[{name}]",
                width,
                "m",
                f"at most half the wavelength, {wavelength / 2:.3e} m",
            )
        require(
            conditions.depth_range <= scene.distance,
            "conditions.depth_range",
            conditions.depth_range,
            "m",
            f"at most the scene's distance, {scene.distance:.3e} m",
        )
        conditions.imperfections.check(camera)

    def with_sampling(
        self,
        *,
        reach: Reach | None = None,
        step: float | None = None,
        wavelengths: int | None = None,
        layers: int | None = None,
        zones: int | None = None,
        dtype: torch.dtype | None = None,
    ) -> Self:
        """Return the same model computed otherwise; None keeps the present value."""
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
                dtype=dtype or sampling.dtype,
            ),
        )

    def with_samples(self, of: str, count: int) -> Self:
        """Return the same model with so many samples ``of`` "wavelengths", "layers" or "zones"."""
        samples: dict[str, Any] = {of: count}
        return replace(self, sampling=replace(self.sampling, **samples))

    @property
    def approximation(self) -> Approximation:
        """Approximation of the kernels."""
        sampling = self.sampling
        return Approximation(
            shadow=not sampling.diffraction,
            plane_wave=not sampling.spherical,
            point_binning=not sampling.binning,
            axial=not sampling.oblique,
        )
