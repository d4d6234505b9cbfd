"""The transfer of a camera: the tables that make the matrix from scene to embedding of any mask.

An embedding is linear in the scene, ``v = x T(w)``, and ``T`` is a quadratic form in the mask's
weights. The point spread function is ``|F w G^T|^2``, so with ``kappa`` the box of an embedding
pixel convolved with that of a scene pixel's image,

    T = sum over (dr, dc) of  Re  Ky[dr] (w * shift(w; dr, dc)) Kx[dc]^T
    Ky[dr][o, r] = integral of kappa_y(o - y) F_r(y) conj(F_{r+dr}(y)) dy,   Kx likewise,

equation (6) of docs/mathematics.md, ``o`` running over every offset between an embedding pixel and
a scene pixel's image. Sub-pixels far apart interfere in fringes much finer than an embedding pixel,
which average out: a few offsets (dr, dc) are enough, and how many is the dial between accuracy and
time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from veilcam_optics.arrays import Array, Scalar, is_torch_array, namespace
from veilcam_optics.camera.geometry import CHANNELS, Camera, Embedding, Scene
from veilcam_optics.camera.imperfections import NOMINAL, Imperfections
from veilcam_optics.errors import require, require_count, require_positive
from veilcam_optics.transfer.field_angle import fading, scene_tangents
from veilcam_optics.transfer.kernels import EXACT, Approximation, Axis
from veilcam_optics.transfer.pairs import Group, dark, stack_groups
from veilcam_optics.transfer.product import Measurement, Transfer

if TYPE_CHECKING:
    from torch import Tensor


@dataclass(frozen=True, slots=True)
class Reach:
    """Greatest distance of two sub-pixels that are counted as interfering, in sub-pixels."""

    rows: int = 1
    columns: int = 0


NEIGHBOURS = Reach()
"""Sub-pixels of neighbouring rows."""


@dataclass(frozen=True)
class Variables:
    """Tensors that take the place of the camera's numbers, so that gradients reach them.

    Each is a float64 scalar (``wavelengths``: shape (3,)) in metres (``rotation``: radians); None
    keeps the value of the camera and its imperfections.
    """

    distance: Tensor | None = None
    wavelengths: Tensor | None = None
    pitch_y: Tensor | None = None
    pitch_x: Tensor | None = None
    shift_y: Tensor | None = None
    shift_x: Tensor | None = None
    rotation: Tensor | None = None


NO_VARIABLES = Variables()
"""Nothing to differentiate with respect to."""


@dataclass(frozen=True, slots=True)
class Beam:
    """Light of one wavelength, from one distance, that a channel adds up.

    Attributes:
        channel: 0 (R), 1 (G) or 2 (B).
        wavelength: [m].
        share: share of the channel's light.
        scene_distance: scene to mask [m]; None keeps the scene's.
        stretch: factors on the wavelength along y and x. A tilted beam spreads like one of a longer
            wavelength, more along the tilt than across it.
    """

    channel: int
    wavelength: Scalar
    share: float = 1.0
    scene_distance: float | None = None
    stretch: tuple[float, float] = (1.0, 1.0)


def make_transfer(
    camera: Camera,
    scene: Scene,
    embedding: Embedding,
    *,
    reach: Reach = NEIGHBOURS,
    step: float = 1.55e-6,
    colour: bool = False,
    variables: Variables = NO_VARIABLES,
    beams: Sequence[Beam] | None = None,
    approximation: Approximation = EXACT,
    centre: tuple[float, float] = (0.0, 0.0),
    imperfections: Imperfections = NOMINAL,
    like: Array,
) -> Transfer[Array]:
    """``T(w)`` for one camera, scene and embedding; everything but ``w`` is computed once.

    Args:
        camera: geometry, filters and wavelengths; nominal.
        scene: flat object; a scene pixel needs to be no finer than the embedding can tell apart.
        embedding: shape of the embedding.
        reach: pairs of sub-pixels that interfere. With ideal colour filters, rows of one colour
            are 3 sub-pixels apart, so a smaller reach along rows counts none.
        step: distance of integration nodes on the sensor [m].
        colour: True keeps the three channels apart, False sums them to a gray measurement.
        variables: tensors to differentiate with respect to, where torch computes.
        beams: beams that each channel adds up; by default its one wavelength.
        approximation: terms that are left out.
        centre: middle of the scene, from the optical axis along y and x [m].
        imperfections: real places of mask and sensor. The rotation counts to first order, so it
            has to be small. Weights are what the panel *shows*, and no stray light is added.
        like: any array of the library and type that the result is of; the kernels are made in
            float64 and then cast.

    Raises:
        OpticsError: a negative reach or step, beams that miss a channel, or imperfections that
            this camera cannot have.
    """
    require_count("reach.rows", reach.rows, least=0)
    require_count("reach.columns", reach.columns, least=0)
    require_positive("step", step, "m")
    if beams is None:
        wavelengths: Sequence[float | Tensor] = (
            camera.wavelengths if variables.wavelengths is None else variables.wavelengths.unbind()
        )
        beams = [Beam(channel, wavelength) for channel, wavelength in enumerate(wavelengths)]
    require(
        {beam.channel for beam in beams} == set(range(len(CHANNELS))),
        "beams",
        f"{len(beams)} beams",
        "",
        "at least one for each of R, G and B",
    )
    axes: dict[float | None, tuple[Axis[Array], Axis[Array]]] = {
        distance: make_axes(
            camera,
            scene if distance is None else replace(scene, distance=distance),
            embedding,
            step=step,
            variables=variables,
            approximation=approximation,
            centre=centre,
            imperfections=imperfections,
            like=like,
        )
        for distance in {beam.scene_distance for beam in beams}
    }
    rotation = imperfections.rotation if variables.rotation is None else variables.rotation
    measurements: list[Measurement[Array]] = []
    groups: list[Group[Array]] = []
    for channel, share in enumerate(camera.sensor.channel_weights):
        for beam in beams:
            if beam.channel != channel or not (colour or share):
                continue
            light = beam.share if colour else beam.share * share
            groups.extend(
                replace(group, rows=group.rows * light)
                for group in _groups(camera, axes[beam.scene_distance], beam, reach, rotation)
            )
        if colour or channel == len(CHANNELS) - 1:
            if not groups:  # no row passes this light: a measurement without pairs
                groups.append(dark(*axes[beams[0].scene_distance]))
            measurements.append(stack_groups(groups, camera.mask_shape, like.dtype))
            groups = []
    shade = np.ones(scene.shape) if approximation.axial else fading(scene, centre)
    fade = namespace(like).asarray(shade, dtype=like.dtype)
    return Transfer(camera, scene, embedding, tuple(measurements), fade)


def make_axes(
    camera: Camera,
    scene: Scene,
    embedding: Embedding,
    *,
    step: float = 1.55e-6,
    variables: Variables = NO_VARIABLES,
    approximation: Approximation = EXACT,
    centre: tuple[float, float] = (0.0, 0.0),
    imperfections: Imperfections = NOMINAL,
    like: Array,
) -> tuple[Axis[Array], Axis[Array]]:
    """Return the two axes (y, x) of a camera, scene and embedding."""
    imperfections.check(camera)
    distance: Scalar
    actual = imperfections.actual(camera).distance
    distance = actual if variables.distance is None else variables.distance
    shift_y: Scalar = imperfections.shift_y if variables.shift_y is None else variables.shift_y
    shift_x: Scalar = imperfections.shift_x if variables.shift_x is None else variables.shift_x
    other_x, other_y = (float(np.mean(at**2)) for at in scene_tangents(scene, centre))
    pitch_y: Scalar = camera.panel.pitch_y if variables.pitch_y is None else variables.pitch_y
    pitch_x: Scalar = camera.panel.pitch_x if variables.pitch_x is None else variables.pitch_x
    y: Axis[Array] = Axis(
        length=camera.sensor.height,
        pixels=embedding.rows,
        fill=embedding.fill,
        scene_pixels=scene.rows,
        scene_pixel=scene.pixel,
        scene_distance=scene.distance,
        distance=distance,
        apertures=camera.window.rows,
        pitch=pitch_y,
        width=camera.panel.aperture_y,
        shift=shift_y,
        centre=centre[0],
        other=other_y,
        step=step,
        approximation=approximation,
        like=like,
    )
    x: Axis[Array] = Axis(
        length=camera.sensor.width,
        pixels=embedding.columns,
        fill=embedding.fill,
        scene_pixels=scene.columns,
        scene_pixel=scene.pixel,
        scene_distance=scene.distance,
        distance=distance,
        apertures=camera.window.columns,
        pitch=pitch_x,
        width=camera.panel.aperture_x,
        shift=shift_x,
        centre=centre[1],
        other=other_x,
        step=step,
        approximation=approximation,
        like=like,
    )
    return y, x


def _groups(
    camera: Camera,
    axes: tuple[Axis[Array], Axis[Array]],
    beam: Beam,
    reach: Reach,
    rotation: Scalar,
) -> Iterator[Group[Array]]:
    """All groups of interfering pairs of one beam.

    Each pair of different sub-pixels is taken once, with a factor 2: its mirror image is its
    complex conjugate. So dc >= 0, and dr < 0 occurs with dc > 0 only.

    In a mask turned by a small angle, row ``r`` moves along x by ``-angle y_r`` and column ``c``
    along y by ``angle x_c``. To first order that adds two products of kernels and slopes.
    """
    y, x = axes
    xp = namespace(y.offsets)
    # At an angle of zero, too, a gradient needs the slopes.
    rotated = is_torch_array(rotation) or rotation != 0
    amplitudes = xp.asarray(camera.row_amplitudes(beam.channel), dtype=xp.float64)
    # A row that its filter closes needs no field.
    fields_y = y.fields(beam.wavelength * beam.stretch[0], of=xp.nonzero(amplitudes)[0])
    fields_x = x.fields(beam.wavelength * beam.stretch[1])
    rows, columns = camera.mask_shape
    below: list[tuple[Array, Array, Array, Array]] = []
    for dr in range(min(reach.rows, rows - 1) + 1):
        product = amplitudes[: rows - dr] * amplitudes[dr:]
        first = xp.nonzero(product)[0]
        if not first.shape[0]:
            continue
        down = y.kernel(fields_y, first, first + dr) * product[first]
        # Without a rotation nothing asks for the slopes.
        slope = y.slope(fields_y, first, first + dr) * product[first] if rotated else down
        below.append((first, first + dr, down, slope))
    if not below:
        return
    # The same pairs, the other way round.
    above: list[tuple[Array, Array, Array, Array]] = [
        (second, first, xp.conj(down), xp.conj(slope))
        for first, second, down, slope in below
        if not bool(xp.all(first == second))
    ]
    for dc in range(min(reach.columns, columns - 1) + 1):
        used = [*below, *above] if dc else below
        first, second = (xp.concat([pair[k] for pair in used]) for k in (0, 1))
        # A pair and its mirror image count, a sub-pixel with itself once.
        # Subtracted, since a choice of two numbers would be made in single precision.
        twice = 2 - xp.astype((first == second) & (dc == 0), first.dtype)
        down = xp.concat([pair[2] for pair in used], axis=1) * twice
        column = xp.arange(columns - dc)
        other = column + dc
        across = x.kernel(fields_x, column, other)
        terms = [(down, across)]
        if rotated:
            slope_x = x.slope(fields_x, column, other)
            slope_y = xp.concat([pair[3] for pair in used], axis=1) * twice
            terms += [
                (slope_y * (-rotation * y.magnification), across * x.middles(column, other)),
                (down * y.middles(first, second), slope_x * (rotation * x.magnification)),
            ]
        for down, across in terms:
            yield Group(first, second, dc, xp.real(across).T, xp.real(down))
            if dc:  # Re(A B) = Re A Re B - Im A Im B; without an offset B is real
                yield Group(first, second, dc, xp.imag(across).T, -xp.imag(down))
