"""A model made to run: from scenes and a mask to embeddings."""

from dataclasses import replace

import torch
from torch import Tensor, nn

from veilcam_optics.camera.geometry import CHANNELS
from veilcam_optics.camera.inputs import check_scenes, check_weights
from veilcam_optics.effects import composition
from veilcam_optics.effects.light import Zone, fade, zones
from veilcam_optics.effects.mask import actual_camera
from veilcam_optics.effects.model import Model
from veilcam_optics.effects.sensor import channel_shares
from veilcam_optics.errors import OpticsError
from veilcam_optics.simulation.rotated_mask import RotatedMask
from veilcam_optics.transfer.grid import (
    GridLight,
    MaskOnGrid,
    SampledMask,
    check_oversampling,
    mask_grid,
    sample_pitch,
)
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.regions import Region
from veilcam_optics.transfer.tables import Reach

Response = tuple[Tensor, ...]
"""What a mask makes of the light; see :meth:`LightOperator.response`."""


class LightOperator(nn.Module):
    """Operator of a :class:`Model`, ready to be used many times, also in training.

    ``forward`` gives the transfer matrix where the model's method forms one. All results are
    differentiable in scenes and weights.

    Args:
        model: model that is computed.
        colour: True keeps the three channels of the transfer matrix apart.
    """

    fade: Tensor
    shares: Tensor

    def __init__(self, model: Model, *, colour: bool = False) -> None:
        super().__init__()
        self.model, self.colour = model, colour
        dtype = model.sampling.dtype
        self.register_buffer("fade", fade(model).to(dtype))
        self.register_buffer("shares", channel_shares(model).to(dtype).contiguous())
        self._parts = zones(model)
        self._zones: list[list[TransferOperator]] = []
        self._grids: list[tuple[float, Zone, GridLight]] = []
        if model.sampling.method == "grid":
            self._grids = list(_grids(model))
        else:
            apart = colour or model.conditions.bayer
            self._zones = [
                [_zone(model, zone, colour=apart) for zone in row] for row in self._parts
            ]
        self.zones = nn.ModuleList([zone for row in self._zones for zone in row])

    @property
    def has_transfer(self) -> bool:
        """Return whether calling it gives the transfer matrix."""
        return self.model.sampling.method == "transfer"

    @property
    def dtype(self) -> torch.dtype:
        """Type of every result."""
        return self.model.sampling.dtype

    def forward(self, weights: Tensor, region: Region | None = None) -> Tensor:
        """Return the transfer matrix of a mask, everything linear included.

        Args:
            weights: amplitude transmittances asked of the panel, ``camera.mask_shape``.
            region: part of the scene that is asked for; None for all of it.

        Returns:
            (scene pixels, embedding pixels), or (3, scene pixels, embedding pixels) in colour.

        Raises:
            OpticsError: the method forms no matrix, the mask has another shape or holds NaN, or the
                region is not wholly in the scene.
        """
        return composition.collected(self.model, self._transfer(weights, region), (-1,))

    def embed(
        self, scenes: Tensor, weights: Tensor, generator: torch.Generator | None = None
    ) -> Tensor:
        """Return the camera's readings of scenes behind a mask.

        Args:
            scenes: (batch, rows, columns), in [0, 1].
            weights: amplitude transmittances asked of the panel, ``camera.mask_shape``.
            generator: source of the noise, if the model has any.

        Returns:
            (batch, rows, columns) of the embedding.

        Raises:
            OpticsError: scenes or mask have another shape, or the mask holds NaN.
        """
        values = self.collect(scenes, self.response(weights))
        return composition.read(self.model, values, generator)

    def response(self, weights: Tensor) -> Response:
        """Return the response of the light to a mask, for :meth:`collect` with many scenes.

        Args:
            weights: amplitude transmittances asked of the panel, ``camera.mask_shape``.

        Returns:
            As the method has it: the transfer matrix (scene pixels, embedding pixels); the point
            spread functions of every sample of light, (rows, columns) in gray or (channels, rows,
            columns) behind a Bayer filter; or the mask itself, as shown.

        Raises:
            OpticsError: the mask has another shape or holds NaN.
        """
        if self.has_transfer:
            return (self._transfer(weights),)
        check_weights(weights, self.model.camera)
        shown = composition.shown(self.model, weights.to(self.dtype))
        if self.model.conditions.bayer:
            spread = tuple(light.psf_of_amplitudes(shown) for _, _, light in self._grids)
        else:
            spread = tuple(light.gray_psf_of_amplitudes(shown) for _, _, light in self._grids)
        return spread or (shown,)

    def collect(self, scenes: Tensor, response: Response) -> Tensor:
        """Return the light on the sensor, without the sensor's own effects.

        Args:
            scenes: (batch, rows, columns), in [0, 1].
            response: response of :meth:`response`.

        Returns:
            (batch, rows, columns) of the embedding.

        Raises:
            OpticsError: the scenes have another shape.
        """
        check_scenes(scenes, "batch", *self.model.scene.shape)
        scenes = scenes.to(self.dtype)
        return composition.collected(self.model, self._light(scenes, response), (1, 2))

    def _light(self, scenes: Tensor, response: Response) -> Tensor:
        """Embeddings of scenes without stray light, by whichever method the model has."""
        shape = (len(scenes), *self.model.embedding.shape)
        if self.has_transfer:
            return (scenes.flatten(1) @ response[0]).reshape(shape)
        total = scenes.new_zeros(shape)
        for row, operators in zip(self._parts, self._zones, strict=False):
            for part, zone in zip(row, operators, strict=True):
                values = zone.embed_by_factors(
                    _cut(scenes, part, coloured=self.model.conditions.bayer), response[0]
                )
                total = total + self._gray(values)
        for (share, part, light), psf in zip(self._grids, response, strict=False):
            # Only one zone's pixels are lit, but they keep their places.
            lit = torch.zeros_like(scenes)
            lit[:, part.rows, part.columns] = (scenes * self.fade)[:, part.rows, part.columns]
            total = total + share * self._blurred(light, lit, psf)
        return total

    def _blurred(self, light: GridLight, scenes: Tensor, psf: Tensor) -> Tensor:
        """Gray embeddings of scenes by one sample of light on a grid."""
        if self.model.conditions.bayer:
            coloured = scenes[:, None].expand(-1, len(CHANNELS), -1, -1)
            values = light.embed_colour(coloured, psf, self.model.embedding)
            return (values * self.shares).sum(1)
        # Every pixel has the same share of each colour: one convolution does for all of them.
        return light.embed_gray(scenes, psf, self.model.embedding)

    def _gray(self, values: Tensor) -> Tensor:
        return (values * self.shares).sum(1) if self.model.conditions.bayer else values

    def _transfer(self, weights: Tensor, region: Region | None = None) -> Tensor:
        """Return the matrix of all zones, or of a region's part of them, without stray light."""
        if not self.has_transfer:
            method = self.model.sampling.method
            raise OpticsError(f'method "{method}" forms no transfer matrix: use embed')
        check_weights(weights, self.model.camera)
        shown = composition.shown(self.model, weights.to(self.model.sampling.dtype))
        region = region or Region(0, 0, *self.model.scene.shape)
        region.check(self.model.scene)
        rows = []
        for row, operators in zip(self._parts, self._zones, strict=True):
            parts = [
                self._by_pixel(zone(shown, part), part)
                for zone, part in zip(
                    operators, (_common(zone, region) for zone in row), strict=True
                )
                if part is not None
            ]
            if parts:
                rows.append(parts[0] if len(parts) == 1 else torch.cat(parts, dim=-2))
        transfer = rows[0] if len(rows) == 1 else torch.cat(rows, dim=-3)
        return transfer.flatten(-3, -2)

    def _by_pixel(self, transfer: Tensor, part: Region) -> Tensor:
        """Return the transfer of a part, (..., rows, columns, embedding pixels)."""
        if self.model.conditions.bayer:
            transfer = torch.einsum("cpe,ce->pe", transfer, self.shares.flatten(1))
        return transfer.reshape(*transfer.shape[:-2], part.rows, part.columns, -1)


def _common(zone: Zone, region: Region) -> Region | None:
    """Return the part of a region that is in a zone, counted from the zone's corner."""
    top, left = max(zone.rows.start, region.top), max(zone.columns.start, region.left)
    rows = min(zone.rows.stop, region.top + region.rows) - top
    columns = min(zone.columns.stop, region.left + region.columns) - left
    if rows <= 0 or columns <= 0:
        return None
    return Region(top - zone.rows.start, left - zone.columns.start, rows, columns)


def _cut(scenes: Tensor, part: Zone, *, coloured: bool) -> Tensor:
    scenes = scenes[:, part.rows, part.columns]
    return scenes[:, None].expand(-1, len(CHANNELS), -1, -1) if coloured else scenes


def _zone(model: Model, zone: Zone, *, colour: bool) -> TransferOperator:
    """Return the operator of one zone: that of a smaller scene, off the axis."""
    scene = model.scene
    part = replace(
        scene,
        rows=zone.rows.stop - zone.rows.start,
        columns=zone.columns.stop - zone.columns.start,
        height=scene.pixel * (zone.rows.stop - zone.rows.start),
    )
    centre_y, centre_x = (
        ((used.start + used.stop - 1) / 2 - (count - 1) / 2) * scene.pixel
        for used, count in ((zone.rows, scene.rows), (zone.columns, scene.columns))
    )
    area = part.rows * part.columns / (scene.rows * scene.columns)
    return TransferOperator(
        model.camera,
        part,
        model.embedding,
        # Shadows do not interfere: their kernels would be zeros.
        reach=model.sampling.reach if model.sampling.diffraction else Reach(0, 0),
        step=model.sampling.step,
        colour=colour,
        dtype=model.sampling.dtype,
        centre=(centre_y, centre_x),
        beams=[replace(beam, share=beam.share * area) for beam in composition.beams(model, zone)],
        approximation=model.approximation,
        imperfections=model.conditions.imperfections,
    )


def _grids(model: Model) -> list[tuple[float, Zone, GridLight]]:
    """(share, zone, light) for every sample of spectrum, depth and field."""
    check_oversampling(model.camera, model.sampling.oversampling)
    lights = []
    mask = _mask(model)
    for row in zones(model):
        for zone in row:
            by_channel = [
                [beam for beam in composition.beams(model, zone) if beam.channel == channel]
                for channel in range(len(CHANNELS))
            ]
            most = max(by_channel, key=len)
            for index, sample in enumerate(most):
                # A channel without a spectrum repeats its one wavelength at each depth.
                beams = [
                    own[index if len(own) == len(most) else index % model.sampling.layers]
                    for own in by_channel
                ]
                distance = sample.scene_distance
                scene = model.scene
                camera = replace(
                    actual_camera(model),
                    wavelengths=tuple(
                        float(beam.wavelength) * (beam.stretch[0] * beam.stretch[1]) ** 0.5
                        for beam in beams
                    ),
                )
                light = GridLight(
                    camera,
                    scene if distance is None else replace(scene, distance=distance),
                    oversampling=model.sampling.oversampling,
                    dtype=model.sampling.dtype,
                    mask=mask,
                )
                lights.append((sample.share, zone, light))
    return lights


def _mask(model: Model) -> MaskOnGrid:
    pitch = sample_pitch(model.camera, model.sampling.oversampling)
    given = model.conditions.imperfections
    if given.rotation == given.shift_y == given.shift_x == 0:
        return SampledMask(model.camera, mask_grid(model.camera, pitch), model.sampling.dtype)
    return RotatedMask(
        model.camera,
        pitch,
        rotation=given.rotation,
        shift_y=given.shift_y,
        shift_x=given.shift_x,
        dtype=model.sampling.dtype,
    )
