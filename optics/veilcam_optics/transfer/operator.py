"""The transfer operator: from a mask straight to the matrix that maps a scene to its embedding.

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

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Self

import torch
from torch import Tensor, nn

from veilcam_optics.camera.geometry import CHANNELS, Camera, Embedding, Scene
from veilcam_optics.camera.imperfections import NOMINAL, Imperfections
from veilcam_optics.errors import require, require_count, require_positive
from veilcam_optics.transfer.kernels import EXACT, Approximation, Axis
from veilcam_optics.transfer.pairs import Group, dark, stack_groups
from veilcam_optics.transfer.product import Measurement, Transfer
from veilcam_optics.transfer.regions import Region


@dataclass(frozen=True, slots=True)
class Reach:
    """How far apart two sub-pixels may be, in sub-pixels, and still be counted as interfering."""

    rows: int = 1
    columns: int = 0


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


@dataclass(frozen=True, slots=True)
class Beam:
    """Light of one wavelength, from one distance, that a channel adds up.

    Attributes:
        channel: 0 (R), 1 (G) or 2 (B).
        wavelength: [m].
        share: of the channel's light.
        scene_distance: scene to mask [m]; None keeps the scene's.
        stretch: factors on the wavelength along y and x. A tilted beam spreads like one of a longer
            wavelength, more along the tilt than across it.
    """

    channel: int
    wavelength: float | Tensor
    share: float = 1.0
    scene_distance: float | None = None
    stretch: tuple[float, float] = (1.0, 1.0)


class TransferOperator(nn.Module):
    """``T(w)`` for one camera, scene and embedding; everything but ``w`` is computed once.

    It makes the tables, and holds them as buffers; the product is that of :class:`Transfer`, which
    computes in NumPy just as well.

    Args:
        camera: geometry, filters and wavelengths; nominal.
        scene: flat object; a scene pixel needs to be no finer than the embedding can tell apart.
        embedding: shape of the embedding.
        reach: which pairs of sub-pixels interfere. With ideal colour filters, rows of one colour
            are 3 sub-pixels apart, so a smaller reach along rows counts none.
        step: distance of integration nodes on the sensor [m].
        colour: True keeps the three channels apart, False sums them to a gray measurement.
        dtype: of the result; the kernels are made in float64 and then cast.
        variables: tensors to differentiate with respect to.
        beams: what each channel adds up; by default its one wavelength.
        approximation: what is left out.
        centre: where the middle of the scene is, from the optical axis along y and x [m].
        imperfections: where mask and sensor really are. The rotation counts to first order, so it
            has to be small. Weights are what the panel *shows*, and no stray light is added.

    Raises:
        OpticsError: a negative reach or step, beams that miss a channel, or imperfections that
            this camera cannot have.
    """

    def __init__(
        self,
        camera: Camera,
        scene: Scene,
        embedding: Embedding,
        *,
        reach: Reach = Reach(),
        step: float = 1.55e-6,
        colour: bool = False,
        dtype: torch.dtype = torch.float32,
        variables: Variables = Variables(),
        beams: Sequence[Beam] | None = None,
        approximation: Approximation = EXACT,
        centre: tuple[float, float] = (0.0, 0.0),
        imperfections: Imperfections = NOMINAL,
    ) -> None:
        super().__init__()
        require_count("reach.rows", reach.rows, least=0)
        require_count("reach.columns", reach.columns, least=0)
        require_positive("step", step, "m")
        if beams is None:
            wavelengths: Sequence[float | Tensor] = (
                camera.wavelengths
                if variables.wavelengths is None
                else variables.wavelengths.unbind()
            )
            beams = [Beam(channel, wavelength) for channel, wavelength in enumerate(wavelengths)]
        require(
            {beam.channel for beam in beams} == set(range(len(CHANNELS))),
            "beams",
            f"{len(beams)} beams",
            "",
            "at least one for each of R, G and B",
        )
        axes = {
            distance: make_axes(
                camera,
                scene if distance is None else replace(scene, distance=distance),
                embedding,
                step=step,
                variables=variables,
                approximation=approximation,
                centre=centre,
                imperfections=imperfections,
            )
            for distance in {beam.scene_distance for beam in beams}
        }
        rotation = imperfections.rotation if variables.rotation is None else variables.rotation
        measurements: list[Measurement[Tensor]] = []
        groups: list[Group] = []
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
                measurements.append(stack_groups(groups, camera.mask_shape, dtype))
                groups = []
        self.reach = reach
        self.transfer = Transfer(camera, scene, embedding, tuple(measurements))
        """What computes, on this module's buffers."""
        for name, table in self.transfer.arrays().items():
            self.register_buffer(name, table)

    @property
    def camera(self) -> Camera:
        """Whose transfer it is."""
        return self.transfer.camera

    @property
    def scene(self) -> Scene:
        """What is before the camera."""
        return self.transfer.scene

    @property
    def embedding(self) -> Embedding:
        """What is made of it."""
        return self.transfer.embedding

    @property
    def colour(self) -> bool:
        """Whether the three channels are kept apart."""
        return self.transfer.colour

    @property
    def dtype(self) -> torch.dtype:
        """Of every result."""
        dtype: torch.dtype = self.transfer.dtype
        return dtype

    def forward(self, weights: Tensor, region: Region | None = None) -> Tensor:
        """The transfer matrix of a mask, or of each of several; see :class:`Transfer`."""
        return self.transfer(weights, region)

    def embed(self, scenes: Tensor, weights: Tensor) -> Tensor:
        """Noiseless embeddings of scenes behind a mask; see :meth:`Transfer.embed`."""
        return self.transfer.embed(scenes, weights)

    def embed_by_factors(self, scenes: Tensor, weights: Tensor) -> Tensor:
        """The same without the matrix; see :meth:`Transfer.embed_by_factors`."""
        return self.transfer.embed_by_factors(scenes, weights)

    def _apply(self, fn: Callable[[Tensor], Tensor], recurse: bool = True) -> Self:
        """Compute on what a type or device that is asked for makes of the buffers."""
        super()._apply(fn, recurse)  # type: ignore[no-untyped-call]
        self.transfer = Transfer.from_arrays(
            self.camera, self.scene, self.embedding, dict(self.named_buffers())
        )
        return self


def make_axes(
    camera: Camera,
    scene: Scene,
    embedding: Embedding,
    *,
    step: float,
    variables: Variables = Variables(),
    approximation: Approximation = EXACT,
    centre: tuple[float, float] = (0.0, 0.0),
    imperfections: Imperfections = NOMINAL,
) -> tuple[Axis, Axis]:
    """The two axes (y, x) of a camera, a scene and an embedding; arguments as for the operator."""
    imperfections.check(camera)
    actual = imperfections.actual(camera).distance
    distance = actual if variables.distance is None else variables.distance
    shift_y = imperfections.shift_y if variables.shift_y is None else variables.shift_y
    shift_x = imperfections.shift_x if variables.shift_x is None else variables.shift_x
    # A scene moved by s is a mask moved by -s d2/(d1+d2): shadows fall where they would have.
    share = distance / (scene.distance + distance)
    y = Axis(
        length=camera.sensor.height,
        pixels=embedding.rows,
        scene_pixels=scene.rows,
        scene_pixel=scene.pixel,
        scene_distance=scene.distance,
        distance=distance,
        apertures=camera.window.rows,
        pitch=camera.panel.pitch_y if variables.pitch_y is None else variables.pitch_y,
        width=camera.panel.aperture_y,
        shift=shift_y - centre[0] * share,
        step=step,
        approximation=approximation,
    )
    x = Axis(
        length=camera.sensor.width,
        pixels=embedding.columns,
        scene_pixels=scene.columns,
        scene_pixel=scene.pixel,
        scene_distance=scene.distance,
        distance=distance,
        apertures=camera.window.columns,
        pitch=camera.panel.pitch_x if variables.pitch_x is None else variables.pitch_x,
        width=camera.panel.aperture_x,
        shift=shift_x - centre[1] * share,
        step=step,
        approximation=approximation,
    )
    return y, x


def _groups(
    camera: Camera,
    axes: tuple[Axis, Axis],
    beam: Beam,
    reach: Reach,
    rotation: float | Tensor,
) -> Iterator[Group]:
    """All groups of interfering pairs of one beam.

    Each pair of different sub-pixels is taken once, with a factor 2: its mirror image is its
    complex conjugate. So dc >= 0, and dr < 0 occurs with dc > 0 only.

    In a mask turned by a small angle, row ``r`` moves along x by ``-angle y_r`` and column ``c``
    along y by ``angle x_c``. To first order that adds two products of kernels and slopes.
    """
    y, x = axes
    # At an angle of zero, too, a gradient needs the slopes.
    rotated = isinstance(rotation, Tensor) or rotation != 0
    amplitudes = torch.tensor(camera.row_amplitudes(beam.channel), dtype=torch.float64)
    # A row that its filter closes needs no field.
    fields_y = y.fields(beam.wavelength * beam.stretch[0], of=amplitudes.nonzero().flatten())
    fields_x = x.fields(beam.wavelength * beam.stretch[1])
    rows, columns = camera.mask_shape
    below = []
    for dr in range(min(reach.rows, rows - 1) + 1):
        product = amplitudes[: rows - dr] * amplitudes[dr:]
        first = product.nonzero().flatten()
        if not len(first):
            continue
        down = y.kernel(fields_y, first, first + dr) * product[first]
        # Without a rotation nothing asks for the slopes.
        slope = y.slope(fields_y, first, first + dr) * product[first] if rotated else down
        below.append((first, first + dr, down, slope))
    if not below:
        return
    # The same pairs, the other way round.
    above = [
        (second, first, down.conj(), slope.conj())
        for first, second, down, slope in below
        if not torch.equal(first, second)
    ]
    for dc in range(min(reach.columns, columns - 1) + 1):
        used = [*below, *above] if dc else below
        first, second = (torch.cat([pair[k] for pair in used]) for k in (0, 1))
        # A pair and its mirror image count, a sub-pixel with itself once.
        twice = 2 - ((first == second) & (dc == 0)).double()
        down = torch.cat([pair[2] for pair in used], dim=1) * twice
        column = torch.arange(columns - dc)
        other = column + dc
        across = x.kernel(fields_x, column, other)
        terms = [(down, across)]
        if rotated:
            slope_x = x.slope(fields_x, column, other)
            slope_y = torch.cat([pair[3] for pair in used], dim=1) * twice
            terms += [
                (slope_y * (-rotation * y.magnification), across * x.middles(column, other)),
                (down * y.middles(first, second), slope_x * (rotation * x.magnification)),
            ]
        for down, across in terms:
            yield Group(first, second, dc, across.real.T, down.real)
            if dc:  # Re(A B) = Re A Re B - Im A Im B; without an offset B is real
                yield Group(first, second, dc, across.imag.T, -down.imag)
