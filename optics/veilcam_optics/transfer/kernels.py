"""One axis of the transfer operator: field products integrated over the pixels' boxes.

A scene pixel's image and an embedding pixel are boxes; ``kappa`` is the one convolved with the
other, a trapezoid in their offset. A kernel integrates products of aperture fields against it.
"""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from veilcam_optics.errors import invalid
from veilcam_optics.transfer.factored import aperture_fields, as_number


def double_integral(samples: Tensor, start: float, step: float, at: Tensor) -> Tensor:
    """Second antiderivative of the linear interpolant of ``samples``, at the points ``at``.

    Args:
        samples: (N, R) values at ``start + n step``.
        start: position of the first sample [m].
        step: distance of samples [m].
        at: positions (M,) [m], inside the samples' range.

    Returns:
        (M, R), in units of samples x m^2; zero with zero slope at ``start``.
    """
    trapezoids = (samples[1:] + samples[:-1]) * (step / 2)
    first = torch.cat([torch.zeros_like(samples[:1]), trapezoids.cumsum(0)])
    cubic = first[:-1] * step + (2 * samples[:-1] + samples[1:]) * (step * step / 6)
    second = torch.cat([torch.zeros_like(samples[:1]), cubic.cumsum(0)])
    cell = ((at.detach() - start) / step).floor().long().clamp(0, samples.shape[0] - 2)
    t = (at - start - cell.to(at.dtype) * step)[:, None]
    slope = (samples[cell + 1] - samples[cell]) / step
    return second[cell] + t * (first[cell] + t * (samples[cell] / 2 + t * slope / 6))


def box_kernel(
    offsets: Tensor,
    products: Tensor,
    start: float,
    step: float,
    *,
    pixel: float,
    image: float | Tensor,
) -> Tensor:
    """Integrate ``products`` against ``kappa``, an embedding pixel's box over a scene pixel's.

    Equations (4) and (5) of docs/mathematics.md, but for the factors before the integrals.

    ``kappa`` is a trapezoid, whose second derivative is four deltas at its corners. So the integral
    is four values of the second antiderivative, exact for any width of the boxes.

    Args:
        offsets: (O,) embedding pixel minus scene pixel's image [m].
        products: (N, R) field products on the nodes ``start + n step``.
        start: first node [m].
        step: node distance [m].
        pixel: side of an embedding pixel [m].
        image: side of a scene pixel's image [m].

    Returns:
        (O, R).
    """
    outer, inner = (pixel + image) / 2, (pixel - image) / 2  # the sign of inner does not matter
    corners = torch.cat([offsets + outer, offsets + inner, offsets - inner, offsets - outer])
    values = double_integral(products, start, step, corners).reshape(4, len(offsets), -1)
    return values[0] - values[1] - values[2] + values[3]


def shadow_kernel(
    offsets: Tensor, low: Tensor, high: Tensor, *, pixel: float, image: float | Tensor
) -> Tensor:
    """Integrate ``kappa`` over the geometric shadow of each aperture, in closed form.

    Args:
        offsets: (O,) embedding pixel minus scene pixel's image [m].
        low: (R,) lower end of each shadow [m].
        high: (R,) upper end [m].
        pixel: side of an embedding pixel [m].
        image: side of a scene pixel's image [m].

    Returns:
        (O, R) [m^2].
    """
    outer, inner = (pixel + image) / 2, (pixel - image) / 2
    total = torch.zeros(len(offsets), len(low), dtype=offsets.dtype)
    for corner, sign in ((outer, 1), (inner, -1), (-inner, -1), (-outer, 1)):
        at = (offsets + corner)[:, None]
        inside = (at - low).clamp_min(0).square() - (at - high).clamp_min(0).square()
        total = total + sign / 2 * inside
    return total


@dataclass(frozen=True, slots=True)
class Approximation:
    """What the kernels leave out. By default nothing.

    Attributes:
        shadow: geometric shadows take the place of diffraction; nothing interferes.
        plane_wave: the light at the mask is parallel: a scene point at infinity.
        point_measurement: an embedding value is read at its pixel's centre, not averaged over it.
    """

    shadow: bool = False
    plane_wave: bool = False
    point_binning: bool = False


EXACT = Approximation()
"""Nothing left out."""


_MAX_FIELD_VALUES = 1e8
"""Of all apertures at all nodes: 1.6 GB."""


class Axis:
    """One axis of camera and scene: the offsets, the integration nodes, and kernels made on them.

    Args:
        length: side of the sensor [m], cut into ``pixels`` embedding pixels.
        pixels: embedding pixels along this axis.
        scene_pixels: scene pixels along this axis, each ``scene_pixel`` [m] wide.
        scene_pixel: side of a scene pixel, in the scene [m].
        scene_distance: scene to mask [m].
        distance: mask to sensor [m].
        apertures: sub-pixels along this axis, ``pitch`` [m] apart and ``width`` [m] wide.
        pitch: distance of sub-pixels [m].
        width: open width of a sub-pixel [m].
        shift: displacement of the mask from the optical axis [m].
        step: largest distance of integration nodes [m].
        approximation: what is left out.

    Raises:
        OpticsError: nodes so many that the fields do not fit in memory.
    """

    def __init__(
        self,
        *,
        length: float,
        pixels: int,
        scene_pixels: int,
        scene_pixel: float,
        scene_distance: float | Tensor,
        distance: float | Tensor,
        apertures: int,
        pitch: float | Tensor,
        width: float,
        shift: float | Tensor,
        step: float,
        approximation: Approximation = EXACT,
    ) -> None:
        self.pixel = length / pixels
        self.image = scene_pixel * distance / scene_distance
        # A scene point at s falls at -s d2/d1, so the offset to it is o + s d2/d1.
        embedding = (torch.arange(pixels, dtype=torch.float64) - (pixels - 1) / 2) * self.pixel
        scene = torch.arange(scene_pixels, dtype=torch.float64) - (scene_pixels - 1) / 2
        self.offsets = (scene[:, None] * self.image + embedding).reshape(-1)
        reach = float(self.offsets.detach().abs().max()) + (self.pixel + as_number(self.image)) / 2
        # Nodes at whole multiples of the step stay put when the geometry moves a little, so that
        # a finite difference sees the integral change and not its quadrature error.
        half = 0 if approximation.shadow else math.floor(reach / step) + 2
        if (2 * half + 1) * apertures > _MAX_FIELD_VALUES:
            least = 2.1 * reach * apertures / _MAX_FIELD_VALUES
            raise invalid(
                "step",
                step,
                "m",
                f"at least {least:.2g} m: finer, the fields over the {2 * reach:.2g} m that scene "
                "and sensor span together do not fit in memory",
            )
        self.start, self.step = -half * step, step
        self.nodes = step * torch.arange(-half, half + 1, dtype=torch.float64)
        index = torch.arange(apertures, dtype=torch.float64) - (apertures - 1) / 2
        self.centres = index * pitch + shift
        self.width = width
        self.source_distance = math.inf if approximation.plane_wave else scene_distance
        self.distance = distance
        self.shadow = approximation.shadow
        if approximation.point_binning:
            self.pixel *= 1e-3
        self.scale = 1 / (self.pixel * scene_pixels * self.image)

    def fields(self, wavelength: float | Tensor, of: Tensor | None = None) -> Tensor:
        """Fields of the apertures on the nodes, complex128 (nodes, apertures).

        With ``of``, the indices of some apertures, those of all others are left at zero.
        """
        if self.shadow:
            return torch.zeros(0, len(self.centres), dtype=torch.complex128)
        fields = aperture_fields(
            self.nodes,
            self.centres if of is None else self.centres[of],
            self.width,
            wavelength=wavelength,
            source_distance=self.source_distance,
            distance=self.distance,
        )
        if of is None:
            return fields
        all_fields = fields.new_zeros(len(self.nodes), len(self.centres))
        return all_fields.index_copy(1, of, fields)

    def kernel(self, fields: Tensor, first: Tensor, second: Tensor) -> Tensor:
        """Complex kernel (O, pairs) of the pairs of apertures (first, second)."""
        if self.shadow:
            return self._shadows(first, second)
        products = fields[:, first] * fields[:, second].conj()
        parts = torch.cat([products.real, products.imag], dim=1)
        kernel = self.scale * box_kernel(
            self.offsets, parts, self.start, self.step, pixel=self.pixel, image=self.image
        )
        real, imaginary = kernel.chunk(2, dim=1)
        return torch.complex(real, imaginary)

    def slope(self, fields: Tensor, first: Tensor, second: Tensor) -> Tensor:
        """Derivative of :meth:`kernel` with respect to the offset, by a central difference."""
        offsets, small = self.offsets, self.step / 4
        kernels = []
        for sign in (1, -1):
            self.offsets = offsets + sign * small
            kernels.append(self.kernel(fields, first, second))
        self.offsets = offsets
        return (kernels[0] - kernels[1]) / (2 * small)

    def middles(self, first: Tensor, second: Tensor) -> Tensor:
        """Where pairs of apertures lie, from the middle of the mask [m]."""
        return (self.centres[first] + self.centres[second]) / 2 - self.centres.mean()

    @property
    def magnification(self) -> float | Tensor:
        """How much larger a shadow is than what casts it."""
        return 1 + self.distance / self.source_distance

    def _shadows(self, first: Tensor, second: Tensor) -> Tensor:
        """Kernels without diffraction: the shadow of an aperture with itself, else nothing."""
        magnification = self.magnification
        low = (self.centres[first] - self.width / 2) * magnification
        high = (self.centres[first] + self.width / 2) * magnification
        shadows = shadow_kernel(self.offsets, low, high, pixel=self.pixel, image=self.image)
        # Spreading out by the magnification dims the light along each axis by as much.
        shadows = shadows * (first == second) * (self.scale / magnification)
        return torch.complex(shadows, torch.zeros_like(shadows))
