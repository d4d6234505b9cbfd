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

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from veilcam_optics.camera.geometry import CHANNELS, Camera, Embedding, Scene
from veilcam_optics.camera.imperfections import NOMINAL, Imperfections
from veilcam_optics.camera.inputs import check_scenes, check_weights
from veilcam_optics.errors import require, require_count, require_positive
from veilcam_optics.transfer.kernels import EXACT, Approximation, Axis
from veilcam_optics.transfer.pairs import Group, Measurement, dark
from veilcam_optics.transfer.regions import Region, embed_lit

_NUMBERS_AT_ONCE = 2**20
"""Of all masks that one product takes: more of them do not fit in a processor's cache."""


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
        self.camera, self.scene, self.embedding = camera, scene, embedding
        self.reach, self.colour = reach, colour
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
        measurements: list[Measurement] = []
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
                measurements.append(Measurement(groups, dtype))
                groups = []
        self.measurements, self._measurements = nn.ModuleList(measurements), tuple(measurements)

    def forward(self, weights: Tensor, region: Region | None = None) -> Tensor:
        """The transfer matrix of a mask, or of each of several.

        Args:
            weights: amplitude transmittances, ``camera.mask_shape``, or (masks, rows, columns).
                Differentiable. Several masks at once save what a call costs beside its products,
                which is most of it where scene and embedding are small.
            region: part of the scene that is asked for; None for all of it. Its cost is its own: an
                object that moves about in a large and black scene costs what the object does.

        Returns:
            (scene pixels, embedding pixels), or (3, scene pixels, embedding pixels) in colour, for
            each mask: irradiance of an embedding pixel relative to an all-white scene seen without
            a mask.

        Raises:
            OpticsError: the masks have another shape, or hold NaN or infinity; a region that is not
                wholly in the scene.
        """
        batched = weights.dim() == 3
        check_weights(weights, self.camera, batched=batched)
        if region is None:
            region = Region(0, 0, *self.scene.shape)
        else:
            region.check(self.scene)
        pixels, size = region.rows * region.columns, self.embedding.size
        at_once = max(1, _NUMBERS_AT_ONCE // (pixels * size))
        some = torch.split(weights, at_once) if batched else (weights,)
        transfers = []
        for measurement in self._measurements:
            parts = [self._laid_out(measurement, masks, region) for masks in some]
            transfer = parts[0] if len(parts) == 1 else torch.cat(parts)
            transfers.append(transfer.reshape(*weights.shape[:-2], pixels, size))
        # One gray measurement is taken as it is: stacking would copy the largest tensor of a step.
        return torch.stack(transfers, dim=-3) if self.colour else transfers[0]

    def _laid_out(self, measurement: Measurement, weights: Tensor, region: Region) -> Tensor:
        """Transfers (masks, scene rows, columns, embedding rows, columns), or that of one mask."""
        rows, columns = self.embedding.shape
        # Offsets are in the order of the scene's pixels, so those of a region lie side by side.
        y = slice(region.top * rows, (region.top + region.rows) * rows)
        x = slice(region.left * columns, (region.left + region.columns) * columns)
        if weights.dim() == 2:
            transfer = measurement.transfer(weights, y, x)
            return transfer.view(region.rows, rows, region.columns, columns).transpose(1, 2)
        transfer = measurement.transfer(weights.transpose(0, 1), y, x)
        shape = (region.rows, rows, len(weights), region.columns, columns)
        return transfer.view(shape).permute(2, 0, 3, 1, 4)

    def embed(self, scenes: Tensor, weights: Tensor) -> Tensor:
        """Noiseless embeddings of scenes behind a mask.

        Args:
            scenes: (batch, rows, columns), or (batch, 3, rows, columns) in colour, in [0, 1].
            weights: amplitude transmittances, ``camera.mask_shape``.

        Returns:
            (batch, rows, columns) or (batch, 3, rows, columns) of the embedding.

        Raises:
            OpticsError: the scenes or the mask have another shape.
        """
        self._check_scenes(scenes)
        if self.colour:
            pixels = self.scene.rows * self.scene.columns
            flat = torch.einsum("bcp,cpe->bce", scenes.reshape(-1, 3, pixels), self(weights))
            return flat.reshape(-1, 3, *self.embedding.shape)
        whole = Region(0, 0, *self.scene.shape)
        values = embed_lit(scenes, whole, lambda region: self(weights, region))
        return values.reshape(-1, *self.embedding.shape)

    def embed_by_factors(self, scenes: Tensor, weights: Tensor) -> Tensor:
        """As :meth:`embed`, factor by factor: for matrices too large to be formed.

        It needs ``pairs x rows x columns`` numbers at once, and more time for each scene.
        """
        self._check_scenes(scenes)
        check_weights(weights, self.camera)
        values = [
            measurement.embed(
                scenes[:, channel] if self.colour else scenes, weights, self.embedding.shape
            )
            for channel, measurement in enumerate(self._measurements)
        ]
        return torch.stack(values, dim=1) if self.colour else values[0]

    def _check_scenes(self, scenes: Tensor) -> None:
        expected = (3, *self.scene.shape) if self.colour else self.scene.shape
        check_scenes(scenes, "batch", *expected)


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
