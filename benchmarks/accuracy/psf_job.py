"""Job: from a mask to the point spread function on the paper's 380 x 507 grid."""

from collections.abc import Iterator
from functools import cache, partial

import torch
from torch import Tensor

from benchmarks.accuracy.fresnel import FresnelImpulse, FresnelTransfer
from benchmarks.accuracy.geometric import GeometricShadow
from benchmarks.accuracy.measure import PRECISIONS, Job, Prepared, Psf, Setting, example_mask
from benchmarks.accuracy.reference import reference_psf, sampled_psf
from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.propagation import AngularSpectrum, Propagator
from veilcam_optics.propagation.sampling import Grid, covering_grid
from veilcam_optics.transfer.grid import GridLight, mask_grid, sample_pitch
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.tables import Reach


class PsfJob:
    """Camera, mask, cells and truth of the job.

    The result is the irradiance of the three channels averaged over every 12.4 um cell: what a
    sensor sees. A method that samples finer is averaged down.

    Args:
        quick: fewer settings and a reference sampled 16 instead of 48 times finer.
    """

    def __init__(self, *, quick: bool) -> None:
        self.quick = quick
        self.camera, self.scene = Camera(), Scene()
        self.weights = example_mask(self.camera)
        self.cells = covering_grid(
            self.camera.sensor.height,
            self.camera.sensor.width,
            sample_pitch(self.camera),
        )
        self.reference = cache(self._reference)

    def job(self) -> Job:
        """The job with every setting of ours."""
        title = f"LCD mask to PSF, {self.cells.rows} x {self.cells.columns}, three wavelengths"
        skipped: dict[str, str] = {}
        settings = [*self._operators(), *self._factored(), *self._grids(skipped)]
        return Job("psf", title, self.reference, settings, skipped)

    def finer(self, oversampling: int) -> Grid:
        """The cells, each cut ``oversampling`` times along both axes."""
        return Grid.square(
            self.cells.rows * oversampling,
            self.cells.columns * oversampling,
            float(self.cells.pitch_y) / oversampling,
        )

    def averaged(self, psf: Psf, oversampling: int, dtype: torch.dtype) -> Prepared:
        """Time from weights to the PSF, averaged over the cells."""
        mask = self.weights.to(dtype)
        shape = (3, self.cells.rows, oversampling, self.cells.columns, oversampling)
        return Prepared(lambda: psf(mask).reshape(shape).mean((2, 4)))

    def _reference(self) -> Tensor:
        return reference_psf(
            self.camera,
            self.scene,
            self.weights,
            self.cells,
            oversampling=16 if self.quick else 48,
        )

    def _operators(self) -> Iterator[Setting]:
        reaches = [Reach(0, 0), Reach(3, 0), Reach(6, 1)]
        if not self.quick:
            reaches += [Reach(9, 2), Reach(15, 4)]
        for precision, dtype in PRECISIONS.items():
            for reach in reaches:
                dials = {"reach": f"{reach.rows},{reach.columns}", "dtype": precision}
                yield Setting(
                    "transfer operator", dials, partial(self._prepare_operator, reach, dtype)
                )

    def _prepare_operator(self, reach: Reach, dtype: torch.dtype) -> Prepared:
        # Cells as embedding pixels, and a scene so small that it is a point.
        operator = TransferOperator(
            self.camera,
            Scene(rows=1, columns=1, height=1e-6, distance=self.scene.distance),
            Embedding(*self.cells.shape),
            reach=reach,
            step=0.775e-6,
            colour=True,
            dtype=dtype,
        )
        mask = self.weights.to(dtype)
        return Prepared(lambda: operator(mask).reshape(3, *self.cells.shape))

    def _factored(self) -> Iterator[Setting]:
        for precision, dtype in PRECISIONS.items():
            for oversampling in (1, 2, 4) if self.quick else (1, 2, 4, 8, 16):
                dials = {"oversampling": oversampling, "dtype": precision}
                yield Setting(
                    "factored field", dials, partial(self._prepare_factored, oversampling, dtype)
                )

    def _prepare_factored(self, oversampling: int, dtype: torch.dtype) -> Prepared:
        psf = sampled_psf(self.camera, self.scene, self.finer(oversampling), dtype)
        return self.averaged(psf, oversampling, dtype)

    def _grids(self, skipped: dict[str, str]) -> Iterator[Setting]:
        """Every propagator that calls itself accurate here, and the shadow for comparison."""
        shadow = GeometricShadow(source_distance=self.scene.distance)
        methods: list[tuple[str, Propagator, dict[str, str]]] = [
            ("angular spectrum", AngularSpectrum(padding="reach"), {"padding": "reach"}),
            ("angular spectrum", AngularSpectrum(padding="full"), {"padding": "full"}),
            (FresnelTransfer.name, FresnelTransfer(), {}),
            (FresnelImpulse.name, FresnelImpulse(), {}),
            (shadow.name, shadow, {}),
        ]
        for name, propagator, extra in methods:
            for oversampling in (1, 2) if self.quick else (1, 2, 4):
                reason = self._reason_against(propagator, oversampling)
                if reason and propagator is not shadow:
                    skipped[f"{name}, oversampling {oversampling}"] = reason
                    continue
                if propagator is shadow and oversampling > 1:
                    continue  # its error is not one of sampling
                for precision, dtype in PRECISIONS.items():
                    if self.quick and precision == "float64" and oversampling > 1:
                        continue
                    yield Setting(
                        name,
                        {"oversampling": oversampling, **extra, "dtype": precision},
                        partial(self._prepare_grid, propagator, oversampling, dtype),
                        supported=not reason,
                    )

    def _prepare_grid(
        self, propagator: Propagator, oversampling: int, dtype: torch.dtype
    ) -> Prepared:
        light = GridLight(
            self.camera,
            self.scene,
            dtype=dtype,
            grid=self.finer(oversampling),
            propagator=propagator,
        )
        return self.averaged(light.psf, oversampling, dtype)

    def _reason_against(self, propagator: Propagator, oversampling: int) -> str:
        """Why a propagator says that it is not accurate here; empty where it is."""
        target = self.finer(oversampling)
        source = mask_grid(self.camera, float(target.pitch_y))
        for wavelength in self.camera.wavelengths:
            support = propagator.supports(source, target, self.camera.distance, wavelength)
            if not support:
                return support.reason
        return ""
