"""Effects of the light on its way from the scene through the panel to the sensor."""

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from types import MappingProxyType

import numpy as np
import torch
from torch import Tensor

from veilcam_optics.effects.base import Comparison, Effect, Imperfection
from veilcam_optics.effects.mask import actual_camera
from veilcam_optics.effects.model import Model
from veilcam_optics.transfer.field_angle import fading, scene_tangents
from veilcam_optics.transfer.tables import Beam, Reach

_DEVIATIONS = 2 * math.sqrt(2 * math.log(2))
"""Standard deviations in the full width at half maximum of a normal distribution."""


def tangents(model: Model) -> tuple[Tensor, Tensor]:
    """Tangent of the angle to the axis of every scene row, and of every column, float64."""
    y, x = (torch.from_numpy(each) for each in scene_tangents(model.scene))
    return (y, x) if model.sampling.oblique else (0 * y, 0 * x)


def scene_pixel_tangent(model: Model) -> float:
    """Return the distance between the tangents of neighbouring scene pixels."""
    return model.scene.pixel / model.scene.distance


def fade(model: Model) -> Tensor:
    """Share of the light that each scene pixel keeps over the field, float64 (rows, columns)."""
    if not model.sampling.oblique:
        return torch.ones(model.scene.shape, dtype=torch.float64)
    return torch.from_numpy(fading(model.scene))


def stretch(y: Tensor, x: Tensor) -> tuple[Tensor, Tensor]:
    """Factors on the wavelength along y and x, of light at tangents ``y`` and ``x``: equation (8).

    Around a ray at angle theta, the second derivative of the distance ``R`` to a point is
    ``(1 - u^2) / R``, ``u`` the direction cosine along that axis, and ``R = d / cos theta``: the
    paraxial field of a longer wavelength.
    """
    squares = 1 + y.square() + x.square()
    root = squares.sqrt()
    return root / (1 - y.square() / squares), root / (1 - x.square() / squares)


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
        """Factors on the wavelength along y and x; see :func:`stretch`."""
        # As plain numbers: a plan asks for a thousand.
        y, x = self.tangent_y**2, self.tangent_x**2
        squares = 1 + y + x
        root = math.sqrt(squares)
        return root / (1 - y / squares), root / (1 - x / squares)


def zone_counts(model: Model) -> tuple[int, int]:
    """Zones along y and x."""
    most = model.sampling.zones if model.sampling.oblique else 1
    return min(most, model.scene.rows), min(most, model.scene.columns)


def zones(model: Model) -> list[list[Zone]]:
    """List the parts of the scene that have a point spread function each, by rows and columns."""
    scale = scene_pixel_tangent(model)
    parts = []
    for length, count in zip(model.scene.shape, zone_counts(model), strict=True):
        edges = [round(k * length / count) for k in range(count + 1)]
        # The mean tangent of neighbours is that of the middle between them.
        parts.append([(slice(a, b), (a + b - length) / 2 * scale) for a, b in pairwise(edges)])
    return [
        [Zone(rows, columns, at_y, at_x) for columns, at_x in parts[1]] for rows, at_y in parts[0]
    ]


class Diffraction(Effect):
    """Light spreads behind a sub-pixel, against its geometric shadow."""

    name = "diffraction"
    free = False

    def present(self, model: Model) -> bool:
        """Return True: every model has it."""
        return bool(model)

    def without(self, model: Model) -> Model:
        """Geometric shadows."""
        return replace(model, sampling=replace(model.sampling, diffraction=False))

    def reason(self, model: Model) -> str:
        """Fresnel number."""
        panel, distance = model.camera.panel, actual_camera(model).distance
        side = min(panel.aperture_y, panel.aperture_x)
        number = side**2 / (max(model.camera.wavelengths) * distance)
        spread = "edges blur a little" if number > 10 else "light spreads beyond the shadow"
        return f"Fresnel number {number:.3g}: {spread}"


class NonParaxial(Effect):
    """Light that spreads at large angles travels farther than Fresnel's parabola says."""

    name = "non-paraxial diffraction"
    free = False
    absent = "no diffraction"

    def present(self, model: Model) -> bool:
        """With diffraction."""
        return model.sampling.diffraction

    def without(self, model: Model) -> Model:
        """Fresnel's approximation: a factored field in the place of the grid's exact one."""
        if model.sampling.method != "grid":
            return model
        return replace(model, sampling=replace(model.sampling, method="transfer"))

    def error(self, comparison: Comparison) -> float:
        """Return the error of the factored field."""
        return comparison.paraxial()

    def reason(self, model: Model) -> str:
        """Say by how much an aperture spreads light."""
        panel = model.camera.panel
        angle = max(model.camera.wavelengths) / min(panel.aperture_y, panel.aperture_x)
        return f"an aperture spreads light by {angle:.2g} rad; the grid alone counts it"


class SphericalWavefront(Effect):
    """The wave from a scene at a finite distance is curved."""

    name = "spherical wavefront"

    def present(self, model: Model) -> bool:
        """Return True: every model has it."""
        return bool(model)

    def without(self, model: Model) -> Model:
        """Return the model of a scene at infinity."""
        return replace(model, sampling=replace(model.sampling, spherical=False))

    def reason(self, model: Model) -> str:
        """Magnification of the shadow."""
        ratio = actual_camera(model).distance / model.scene.distance
        edge = ratio * model.camera.window.rows * model.camera.panel.pitch_y / 2
        return f"shadow magnified by {100 * ratio:.2g} %: its edge moves {edge * 1e6:.3g} um"


class Interference(Effect):
    """Light of different sub-pixels interferes."""

    name = "neighbour interference"
    free = False
    absent = "one sub-pixel, or no diffraction"

    def present(self, model: Model) -> bool:
        """With more than one sub-pixel, and diffraction."""
        return model.sampling.diffraction and model.camera.mask_shape != (1, 1)

    def without(self, model: Model) -> Model:
        """Irradiances of sub-pixels add up."""
        return model.with_sampling(reach=Reach(0, 0))

    def error(self, comparison: Comparison) -> float:
        """Relative L2 at the embedding if it is ignored."""
        return comparison.interference()

    def reason(self, model: Model) -> str:
        """Fringes against pixels."""
        distance, panel = actual_camera(model).distance, model.camera.panel
        apart = panel.pitch_y * (len(set(panel.filter_cycle)) or 1)
        fringe = max(model.camera.wavelengths) * distance / apart
        pixel = model.embedding.box(model.camera.sensor)[0]
        return f"fringes of {fringe * 1e6:.3g} um, averaged over pixels of {pixel * 1e6:.3g} um"


class Spectrum(Effect):
    """The light of a channel has a width."""

    name = "spectrum per channel"
    free = False
    absent = "one wavelength per channel"
    neutral = MappingProxyType({"bandwidth": (0.0, 0.0, 0.0)})

    def error(self, comparison: Comparison) -> float:
        """Relative L2 at the embedding if it is ignored."""
        return comparison.sampled("wavelengths", 1)

    def reason(self, model: Model) -> str:
        """Relative width."""
        widest = max(
            width / wavelength
            for width, wavelength in zip(
                model.conditions.bandwidth, model.camera.wavelengths, strict=True
            )
        )
        return f"bandwidth up to {100 * widest:.2g} % of the wavelength"

    def beams(self, beams: list[Beam], model: Model) -> list[Beam]:
        """Gauss-Hermite quadrature of a Gaussian line for each channel that has a width."""
        if model.sampling.wavelengths == 1:
            return beams
        nodes, shares = np.polynomial.hermite_e.hermegauss(model.sampling.wavelengths)
        samples = list(zip(nodes.tolist(), (shares / shares.sum()).tolist(), strict=True))
        found = []
        for beam in beams:
            width = model.conditions.bandwidth[beam.channel]
            found += [
                replace(
                    beam,
                    wavelength=beam.wavelength + width / _DEVIATIONS * node,
                    share=beam.share * share,
                )
                for node, share in (samples if width else [(0.0, 1.0)])
            ]
        return found


class Depth(Effect):
    """The scene is not flat."""

    name = "depth layers"
    free = False
    absent = "flat scene"
    neutral = MappingProxyType({"depth_range": 0.0})

    def error(self, comparison: Comparison) -> float:
        """Relative L2 at the embedding if it is ignored."""
        return comparison.sampled("layers", 1)

    def reason(self, model: Model) -> str:
        """Relative depth."""
        share = model.conditions.depth_range / model.scene.distance
        return f"depth is {100 * share:.2g} % of the distance"

    def beams(self, beams: list[Beam], model: Model) -> list[Beam]:
        """Gauss-Legendre: the layers lie where a smooth function's mean is best sampled."""
        if model.sampling.layers == 1:
            return beams
        nodes, shares = np.polynomial.legendre.leggauss(model.sampling.layers)
        half = model.conditions.depth_range / 2
        layers = [
            (model.scene.distance + half * node, share / 2)
            for node, share in zip(nodes.tolist(), shares.tolist(), strict=True)
        ]
        return [
            replace(beam, scene_distance=distance, share=beam.share * share)
            for beam in beams
            for distance, share in layers
        ]


class OffAxis(Effect):
    """Oblique light is fainter, and spreads differently: the field has no single PSF."""

    name = "field angle"
    free = False

    def present(self, model: Model) -> bool:
        """Return True, unless the model leaves it out."""
        return model.sampling.oblique

    def without(self, model: Model) -> Model:
        """All light as bright, and as wide, as light along the axis."""
        return replace(model, sampling=replace(model.sampling, oblique=False, zones=1))

    def error(self, comparison: Comparison) -> float:
        """Relative L2 at the embedding if it is ignored."""
        return comparison.off_axis(None)

    def reason(self, model: Model) -> str:
        """Angle and fading."""
        angle = math.atan(model.scene.height / 2 / model.scene.distance)
        fade = 100 * (1 - math.cos(angle) ** 4)
        return f"up to {math.degrees(angle):.3g} degrees: {fade:.2g} % darker at the edge"


class StrayLight(Imperfection):
    """Some light is scattered evenly over the sensor."""

    name = "stray light"
    absent = "no scattered light"
    fields = ("stray_light",)

    def reason(self, model: Model) -> str:
        """Its share."""
        share = model.conditions.imperfections.stray_light
        return f"{100 * share:.2g} % of the light is spread evenly"

    def collected(self, values: Tensor, axes: tuple[int, ...], model: Model) -> Tensor:
        """Its share is the mean over the sensor."""
        share = model.conditions.imperfections.stray_light
        return (1 - share) * values + share * values.mean(axes, keepdim=True)


class Binning(Effect):
    """An embedding value is an average over its pixel."""

    name = "pixel binning"

    def present(self, model: Model) -> bool:
        """Return True: every model has it."""
        return bool(model)

    def without(self, model: Model) -> Model:
        """Read at the pixel's centre."""
        return replace(model, sampling=replace(model.sampling, binning=False))

    def reason(self, model: Model) -> str:
        """Pixels against structure."""
        pixel = max(model.embedding.box(model.camera.sensor))
        image = model.scene.pixel_at_sensor(actual_camera(model))
        return f"boxes of {pixel * 1e6:.3g} um, scene pixels of {image * 1e6:.3g} um on them"
