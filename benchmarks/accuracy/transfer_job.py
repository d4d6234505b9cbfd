"""Job: from a mask to the transfer matrix of a camera, by every way there is."""

import math
from collections.abc import Iterator
from functools import cache, partial
from typing import get_args

import torch
from torch import Tensor

from benchmarks.accuracy.algorithm1 import Algorithm1, Resampling
from benchmarks.accuracy.measure import PRECISIONS, Job, Prepared, Psf, Setting, example_mask
from benchmarks.accuracy.reference import reference_transfer, sampled_psf
from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.plan import plan
from veilcam_optics.propagation.sampling import Grid, covering_grid
from veilcam_optics.transfer.binning import TransferBinning
from veilcam_optics.transfer.field_angle import fading
from veilcam_optics.transfer.grid import GridLight, sample_pitch
from veilcam_optics.transfer.kernels import Approximation
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.tables import Reach

PLAN = "plan"
TOLERANCES = (1e-1, 1e-2, 1e-3, 1e-4)

_SCENES_AT_ONCE = 16


class TransferJob:
    """Camera, scene, mask and truth of the job, and how any PSF on a grid becomes a result.

    Args:
        quick: a coarser scene (8 x 8 pixels instead of 28 x 28) and fewer settings.
    """

    def __init__(self, *, quick: bool) -> None:
        self.quick = quick
        self.camera, self.embedding = Camera(), Embedding()
        self.scene = Scene(rows=8, columns=8) if quick else Scene()
        self.weights = example_mask(self.camera)
        self.reference = cache(self._reference)

    def job(self) -> Job:
        """The job with every setting of ours."""
        title = f"LCD mask to transfer, {self.scene.rows} x {self.scene.columns} scene to 24 x 32"
        settings = [
            *self._operators(),
            *self._factored(),
            *self._grids(),
            *self._algorithm1(),
            *self._plans(),
        ]
        return Job("transfer", title, self.reference, settings)

    def grid(self, oversampling: int) -> Grid:
        """Cells that cover the sensor and the scene's image around it."""
        height, width = self.camera.lit_sides(self.scene)
        return covering_grid(height, width, sample_pitch(self.camera, oversampling))

    def units(self, dtype: torch.dtype) -> Tensor:
        """Every scene of a single lit pixel, (pixels, rows, columns)."""
        pixels = self.scene.rows * self.scene.columns
        return torch.eye(pixels, dtype=dtype).reshape(pixels, *self.scene.shape)

    def gray_transfer(self, psf: Psf, grid: Grid, dtype: torch.dtype) -> Prepared:
        """Time from weights to transfer by way of a PSF on a grid: its boxes are computed once."""
        binning = TransferBinning(
            self.camera,
            self.scene,
            self.embedding,
            shape=grid.shape,
            pitch=float(grid.pitch_y),
            dtype=dtype,
        )
        shares = torch.tensor(self.camera.sensor.channel_weights, dtype=dtype)
        mask = self.weights.to(dtype)
        fade = self.fade(dtype)
        return Prepared(lambda: fade * binning(torch.einsum("c,cyx->yx", shares, psf(mask))))

    def fade(self, dtype: torch.dtype) -> Tensor:
        """Share of each scene pixel's light, (scene pixels, 1): one PSF knows no angle."""
        return torch.from_numpy(fading(self.scene)).to(dtype).reshape(-1, 1)

    def _reference(self) -> Tensor:
        """The whole field, brightened and faded as the angle of each scene pixel has it."""
        whole = reference_transfer(
            self.camera, self.scene, self.embedding, self.weights, oversampling=32
        )
        with torch.no_grad():
            oblique, axial = (
                TransferOperator(
                    self.camera,
                    self.scene,
                    self.embedding,
                    approximation=Approximation(axial=axial),
                    dtype=torch.float64,
                )(self.weights.double())
                for axial in (False, True)
            )
        reference: Tensor = whole * oblique / axial
        return reference

    def _operators(self) -> Iterator[Setting]:
        dials = [(Reach(0, 0), 1.55e-6), (Reach(3, 0), 1.55e-6), (Reach(3, 1), 1.55e-6)]
        if not self.quick:
            dials += [(Reach(0, 0), 1.24e-5), (Reach(3, 1), 6.2e-6), (Reach(9, 2), 0.775e-6)]
        for precision, dtype in PRECISIONS.items():
            for reach, step in dials:
                yield Setting(
                    "transfer operator",
                    {
                        "reach": f"{reach.rows},{reach.columns}",
                        "step": f"{step * 1e6:g} um",
                        "dtype": precision,
                    },
                    partial(self._prepare_operator, reach, step, dtype),
                )

    def _prepare_operator(self, reach: Reach, step: float, dtype: torch.dtype) -> Prepared:
        operator = TransferOperator(
            self.camera, self.scene, self.embedding, reach=reach, step=step, dtype=dtype
        )
        mask = self.weights.to(dtype)
        return Prepared(lambda: operator(mask))

    def _factored(self) -> Iterator[Setting]:
        for precision, dtype in PRECISIONS.items():
            for oversampling in (1, 2, 4) if self.quick else (1, 2, 4, 8):
                dials = {"oversampling": oversampling, "dtype": precision}
                yield Setting(
                    "factored field", dials, partial(self._prepare_factored, oversampling, dtype)
                )

    def _prepare_factored(self, oversampling: int, dtype: torch.dtype) -> Prepared:
        grid = self.grid(oversampling)
        return self.gray_transfer(sampled_psf(self.camera, self.scene, grid, dtype), grid, dtype)

    def _grids(self) -> Iterator[Setting]:
        for precision, dtype in PRECISIONS.items():
            for oversampling in (1, 2) if self.quick else (1, 2, 4):
                dials = {"oversampling": oversampling, "padding": "reach", "dtype": precision}
                yield Setting(
                    "angular spectrum", dials, partial(self._prepare_grid, oversampling, dtype)
                )

    def _prepare_grid(self, oversampling: int, dtype: torch.dtype) -> Prepared:
        light = GridLight(self.camera, self.scene, oversampling=oversampling, dtype=dtype)
        return self.gray_transfer(light.psf, light.grid, dtype)

    def _plans(self) -> Iterator[Setting]:
        """One setting for each tolerance: planning and building are set-up, the run is timed."""
        for tolerance in TOLERANCES:
            yield Setting(
                PLAN, {"tolerance": f"{tolerance:.0e}"}, partial(self._prepare_plan, tolerance)
            )

    def _prepare_plan(self, tolerance: float) -> Prepared:
        chosen = plan(self.camera, self.scene, self.embedding, tolerance)
        operator = chosen.operator
        weights = self.weights.to(chosen.model.sampling.dtype)
        if operator.has_transfer:
            return Prepared(lambda: operator(weights))
        # A way that forms no matrix shows it one scene pixel at a time.
        units = self.units(weights.dtype)
        return Prepared(lambda: operator.embed(units, weights).flatten(1))

    def _algorithm1(self) -> Iterator[Setting]:
        """The paper's own algorithm: its PSF and FFT convolution, timed for *one* scene."""
        for precision, dtype in PRECISIONS.items():
            for resampling in get_args(Resampling):
                dials = {"resampling": resampling, "dtype": precision, "timed": "one scene"}
                yield Setting(
                    "Algorithm 1", dials, partial(self._prepare_algorithm1, resampling, dtype)
                )

    def _prepare_algorithm1(self, resampling: Resampling, dtype: torch.dtype) -> Prepared:
        simulation = Algorithm1(
            self.camera, self.scene, self.embedding, resampling, snr_db=math.inf
        )
        mask, units = self.weights.to(dtype), self.units(dtype)

        def transfer() -> Tensor:
            psf = simulation.psf(mask)
            parts = [simulation(some, psf) for some in torch.split(units, _SCENES_AT_ONCE)]
            return self.fade(dtype) * torch.cat(parts).flatten(1)

        return Prepared(lambda: simulation(units[:1], simulation.psf(mask)), transfer)
