"""One axis of the transfer operator: field products integrated over the pixels' boxes.

A scene pixel's image and an embedding pixel are boxes; ``kappa`` is the one convolved with the
other, a trapezoid in their offset. A kernel integrates products of aperture fields against it.
"""

import math
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Generic, Self

from veilcam_optics.arrays import Array, Scalar, detached, namespace
from veilcam_optics.errors import invalid
from veilcam_optics.transfer.factored import aperture_fields, as_number
from veilcam_optics.transfer.field_angle import MASK_POWER


def double_integral(samples: Array, start: float, step: float, at: Array) -> Array:
    """Second antiderivative of a function known at equal steps, at the points ``at``.

    Its integrals are right to the third power of the step.

    Args:
        samples: (N, R) values at ``start + n step``.
        start: position of the first sample [m].
        step: distance of samples [m].
        at: positions (M,) [m], inside the samples' range.

    Returns:
        (M, R), in units of samples x m^2; zero with zero slope at ``start``.
    """
    xp = namespace(samples)
    # A straight line lies h^2 f'' / 12 above the mean of f between two nodes.
    bend = (samples[2:] - 2 * samples[1:-1] + samples[:-2]) / 12
    samples = xp.concat([samples[:1], samples[1:-1] - bend, samples[-1:]])
    trapezoids = (samples[1:] + samples[:-1]) * (step / 2)
    first = xp.cumulative_sum(trapezoids, axis=0, include_initial=True)
    cubic = first[:-1] * step + (2 * samples[:-1] + samples[1:]) * (step * step / 6)
    second = xp.cumulative_sum(cubic, axis=0, include_initial=True)
    cells = xp.clip(xp.floor((detached(at) - start) / step), 0, samples.shape[0] - 2)
    cell = xp.astype(cells, xp.int64)
    t = (at - start - cells * step)[:, None]
    slope = (samples[cell + 1] - samples[cell]) / step
    value: Array = second[cell] + t * (first[cell] + t * (samples[cell] / 2 + t * slope / 6))
    return value


def box_kernel(
    offsets: Array,
    products: Array,
    start: float,
    step: float,
    *,
    pixel: float,
    image: Scalar,
) -> Array:
    """Integrate ``products`` against ``kappa``, an embedding pixel's box over a scene pixel's.

    Equations (4) and (5) of docs/mathematics.md, but for the factors before the integrals.

    ``kappa`` is a trapezoid, whose second derivative is four deltas at its corners. So the integral
    is four values of the second antiderivative, exact for any width of the boxes.

    Args:
        offsets: (O,) embedding pixel minus scene pixel's image [m].
        products: (N, R) field products on the nodes ``start + n step``.
        start: first node [m].
        step: node distance [m].
        pixel: side of an embedding pixel's box [m].
        image: side of a scene pixel's image [m].

    Returns:
        (O, R).
    """
    outer, inner = (pixel + image) / 2, (pixel - image) / 2  # the sign of inner does not matter
    signed = [offsets + outer, offsets + inner, offsets - inner, offsets - outer]
    corners = namespace(offsets).concat(signed)
    values = double_integral(products, start, step, corners)
    values = values.reshape((4, offsets.shape[0], products.shape[1]))
    kernel: Array = values[0] - values[1] - values[2] + values[3]
    return kernel


def shadow_kernel(offsets: Array, low: Array, high: Array, *, pixel: float, image: Scalar) -> Array:
    """Integrate ``kappa`` over the geometric shadow of each aperture, in closed form.

    Args:
        offsets: (O,) embedding pixel minus scene pixel's image [m].
        low: (R,) lower end of each shadow [m].
        high: (R,) upper end [m].
        pixel: side of an embedding pixel's box [m].
        image: side of a scene pixel's image [m].

    Returns:
        (O, R) [m^2].
    """
    outer, inner = (pixel + image) / 2, (pixel - image) / 2
    xp = namespace(offsets)
    total: Array = xp.zeros((offsets.shape[0], low.shape[0]), dtype=offsets.dtype)
    for corner, sign in ((outer, 1), (inner, -1), (-inner, -1), (-outer, 1)):
        at = (offsets + corner)[:, None]
        inside = xp.square(xp.clip(at - low, 0, None)) - xp.square(xp.clip(at - high, 0, None))
        total = total + sign / 2 * inside
    return total


@dataclass(frozen=True, slots=True)
class Approximation:
    """Approximation of the kernels: the terms that are left out. By default none is.

    Attributes:
        shadow: geometric shadows take the place of diffraction; nothing interferes.
        plane_wave: the light at the mask is parallel: a scene point at infinity.
        point_binning: an embedding value is read at its pixel's centre, not averaged over it.
        axial: light from every scene pixel is as bright as light along the axis.
    """

    shadow: bool = False
    plane_wave: bool = False
    point_binning: bool = False
    axial: bool = False


EXACT = Approximation()
"""Nothing left out."""


_MAX_FIELD_VALUES = 1e8
"""Of all apertures at all nodes: 1.6 GB."""

_POINT = 1e-6
"""Least side of a box, as a share of the pixel: a difference over less has few digits."""


class Axis(Generic[Array]):
    """One axis of camera and scene: the offsets, the integration nodes, and kernels made on them.

    Args:
        length: side of the sensor [m], cut into ``pixels`` embedding pixels.
        pixels: embedding pixels along this axis.
        fill: side of the averaged box of each, as a share of the pixel.
        scene_pixels: scene pixels along this axis, each ``scene_pixel`` [m] wide.
        scene_pixel: side of a scene pixel, in the scene [m].
        scene_distance: scene to mask [m].
        distance: mask to sensor [m].
        apertures: sub-pixels along this axis, ``pitch`` [m] apart and ``width`` [m] wide.
        pitch: distance of sub-pixels [m].
        width: open width of a sub-pixel [m].
        shift: displacement of the mask from the optical axis [m].
        centre: middle of the scene, from the optical axis [m].
        other: mean square of the scene's tangents along the other axis.
        step: largest distance of integration nodes [m].
        approximation: terms that are left out.
        like: any array of the library that computes.
    """

    def __init__(
        self,
        *,
        length: float,
        pixels: int,
        fill: float = 1.0,
        scene_pixels: int,
        scene_pixel: float,
        scene_distance: Scalar,
        distance: Scalar,
        apertures: int,
        pitch: Scalar,
        width: float,
        shift: Scalar,
        centre: float = 0.0,
        other: float = 0.0,
        step: float,
        approximation: Approximation = EXACT,
        like: Array,
    ) -> None:
        self._xp = xp = namespace(like)
        pitch_on_sensor = length / pixels
        self.pixel = pitch_on_sensor * max(fill, _POINT)
        if approximation.point_binning:
            self.pixel *= 1e-3
        self.image: Scalar = scene_pixel * distance / scene_distance
        # A scene point at s falls at -s d2/d1, so the offset to it is o + s d2/d1.
        embedding = (xp.arange(pixels, dtype=xp.float64) - (pixels - 1) / 2) * pitch_on_sensor
        scene = (xp.arange(scene_pixels, dtype=xp.float64) - (scene_pixels - 1) / 2)[:, None]
        self.offsets: Array = xp.reshape(scene * self.image + embedding, (-1,))
        points = (scene * scene_pixel + centre) / scene_distance
        self.tangents: Array = xp.reshape(points + 0 * embedding, (-1,))
        self._farthest = float(xp.max(xp.abs(detached(self.offsets))))
        self._farthest += (self.pixel + as_number(self.image)) / 2
        self.step = step
        index = xp.arange(apertures, dtype=xp.float64) - (apertures - 1) / 2
        # A scene moved by s is a mask moved by -s d2/(d1+d2): shadows fall where they would have.
        self._moved: Scalar = centre * distance / (scene_distance + distance)
        self.centres: Array = index * pitch + (shift - self._moved)
        self.width = width
        self.source_distance: Scalar = math.inf if approximation.plane_wave else scene_distance
        self.distance: Scalar = distance
        self.shadow = approximation.shadow
        self.scale: Scalar = 1 / (self.pixel * scene_pixels * self.image)
        self._scene_distance, self._square = scene_distance, 1 + other
        self._axial = approximation.axial

    def at(self, index: Array, other: float | None = None) -> Self:
        """Return the same axis with some of its offsets alone.

        Args:
            index: indices of offsets.
            other: square of their scene pixels' tangent along the other axis, where it is known.
        """
        found = copy(self)
        found.offsets, found.tangents = self.offsets[index], self.tangents[index]
        if other is not None:
            found._square = 1 + other  # noqa: SLF001 - of its own class
        return found

    @cached_property
    def nodes(self) -> Array:
        """Integration nodes [m].

        They are whole multiples of the step. So they stay put when the geometry moves a little, and
        a finite difference sees the integral change and not its quadrature error.

        Raises:
            OpticsError: nodes so many that the fields do not fit in memory.
        """
        half = 0 if self.shadow else math.floor(self._farthest / self.step) + 2
        if (2 * half + 1) * self.centres.shape[0] > _MAX_FIELD_VALUES:
            least = 2.1 * self._farthest * self.centres.shape[0] / _MAX_FIELD_VALUES
            raise invalid(
                "step",
                self.step,
                "m",
                f"at least {least:.2g} m: finer, the fields over the {2 * self._farthest:.2g} m "
                "that scene and sensor span together do not fit in memory",
            )
        nodes: Array = self.step * self._xp.arange(-half, half + 1, dtype=self._xp.float64)
        return nodes

    def brightness(self, of: Array) -> Array:
        """Return amplitudes of the light at apertures, over that at the middle of the mask.

        See "Off the axis" in docs/mathematics.md.

        Args:
            of: indices of apertures.

        Returns:
            (O, apertures).
        """
        tangents = self.tangents[:, None]
        there = tangents - (self.centres[of] + self._moved) / self._scene_distance
        if self._axial:
            there = tangents + 0 * there
        ratio = (self._square + tangents * tangents) / (self._square + there * there)
        bright: Array = ratio**MASK_POWER
        return bright

    def fields(self, wavelength: Scalar, of: Array | None = None) -> Array:
        """Fields of the apertures on the nodes, complex128 (nodes, apertures).

        With ``of``, the indices of some apertures, those of all others are left at zero.
        """
        if self.shadow:
            return self._empty(0)
        fields: Array = aperture_fields(
            self.nodes,
            self.centres if of is None else self.centres[of],
            self.width,
            wavelength=wavelength,
            source_distance=self.source_distance,
            distance=self.distance,
        )
        if of is None:
            return fields
        all_fields = self._empty(self.nodes.shape[0])
        all_fields[:, of] = fields
        return all_fields

    def kernel(self, fields: Array, first: Array, second: Array) -> Array:
        """Complex kernel (O, pairs) of the pairs of apertures (first, second)."""
        if self.shadow:
            return self._shadows(first, second)
        xp = self._xp
        products = fields[:, first] * xp.conj(fields[:, second])
        parts = xp.concat([xp.real(products), xp.imag(products)], axis=1)
        kernel = self.scale * box_kernel(
            self.offsets, parts, float(self.nodes[0]), self.step, pixel=self.pixel, image=self.image
        )
        pairs = first.shape[0]
        bright = self.brightness(first) * self.brightness(second)
        complex_kernel: Array = (kernel[:, :pairs] + 1j * kernel[:, pairs:]) * bright
        return complex_kernel

    def slope(self, fields: Array, first: Array, second: Array) -> Array:
        """Return the derivative of :meth:`kernel` with respect to the offset (numerically)."""
        offsets, small = self.offsets, self.step / 4
        kernels = []
        for sign in (1, -1):
            self.offsets = offsets + sign * small
            kernels.append(self.kernel(fields, first, second))
        self.offsets = offsets
        slope: Array = (kernels[0] - kernels[1]) / (2 * small)
        return slope

    def middles(self, first: Array, second: Array) -> Array:
        """Return the middles of pairs of apertures, from the middle of the mask [m]."""
        middle = self._xp.mean(self.centres)
        middles: Array = (self.centres[first] + self.centres[second]) / 2 - middle
        return middles

    @property
    def magnification(self) -> Scalar:
        """Magnification of a shadow."""
        return 1 + self.distance / self.source_distance

    def _shadows(self, first: Array, second: Array) -> Array:
        """Kernels without diffraction: the shadow of an aperture with itself, else nothing."""
        magnification = self.magnification
        low = (self.centres[first] - self.width / 2) * magnification
        high = (self.centres[first] + self.width / 2) * magnification
        shadows = shadow_kernel(self.offsets, low, high, pixel=self.pixel, image=self.image)
        # Spreading out by the magnification dims the light along each axis by as much.
        shadows = shadows * (first == second) * (self.scale / magnification)
        complex_shadows: Array = shadows * self.brightness(first) ** 2 + 0j
        return complex_shadows

    def _empty(self, nodes: int) -> Array:
        """Fields (nodes, apertures) of nothing."""
        xp = self._xp
        empty: Array = xp.zeros((nodes, self.centres.shape[0]), dtype=xp.complex128)
        return empty
