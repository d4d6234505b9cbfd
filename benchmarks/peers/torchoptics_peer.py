"""torchoptics (MIT) in the jobs, through its public ``Field`` alone.

It models no LCD: it gets our sampled mask, and our box binning for the transfer. It computes its
transfer function on every call and offers no way to keep it.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from functools import partial

import torch
from benchmarks.accuracy.field_job import DISTANCE, PITCH, WAVELENGTH, FieldJob
from benchmarks.accuracy.measure import Prepared, Psf, Setting
from benchmarks.accuracy.psf_job import PsfJob
from benchmarks.accuracy.transfer_job import TransferJob
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Scene
from veilcam_optics.propagation.illumination import spherical_wave
from veilcam_optics.propagation.sampling import Grid
from veilcam_optics.transfer.grid import SampledMask

NAME = "torchoptics"


def propagate(
    field: Tensor,
    *,
    pitch: float,
    wavelength: float,
    distance: float,
    shape: tuple[int, int],
    method: str,
    padding: tuple[int, int] | None,
) -> Tensor:
    """One call of torchoptics, in double precision (its default).

    Args:
        field: complex, (rows, columns).
        pitch: of the samples of both planes [m].
        wavelength: [m].
        distance: [m].
        shape: samples of the target plane, of the same parity as the field's.
        method: ASM, ASM_FRESNEL, DIM or DIM_FRESNEL.
        padding: zeros on each side, for the ASM methods; None is its default, twice the field.
    """
    library = importlib.import_module("torchoptics")
    light = library.Field(field, wavelength=wavelength, z=0, spacing=pitch)
    arrived: Tensor = light.propagate(
        shape, distance, pitch, propagation_method=method, asm_pad=padding
    ).data
    return arrived


def field_settings(job: FieldJob) -> Iterator[Setting]:
    """Every method of torchoptics in the free-field job."""
    for method in ("ASM", "ASM_FRESNEL", "DIM", "DIM_FRESNEL"):
        for oversampling in (1, 3, 5) if job.quick else (1, 3, 5, 9):
            yield Setting(
                f"torchoptics {method}",
                {"oversampling": oversampling, "dtype": "float64"},
                partial(_prepare_field, job, method, oversampling),
                source=NAME,
                free_factor=True,
            )


def _prepare_field(job: FieldJob, method: str, oversampling: int) -> Prepared:
    pattern, target = job.pattern(job.source(oversampling)), job.target(oversampling)
    run = partial(
        propagate,
        pattern,
        pitch=PITCH / oversampling,
        wavelength=WAVELENGTH,
        distance=DISTANCE,
        shape=target.shape,
        method=method,
        padding=None,
    )
    return Prepared(lambda: job.at_points(run(), oversampling))


def _psf(camera: Camera, scene: Scene, grid: Grid, padding: tuple[int, int] | None) -> Psf:
    """From weights to the PSF on a grid that the sampled mask shares."""
    mask = SampledMask(camera, grid, torch.float64)
    filters = [
        torch.tensor(camera.row_amplitudes(channel), dtype=torch.float64)[:, None]
        for channel in range(3)
    ]
    waves = [spherical_wave(grid, scene.distance, length) for length in camera.wavelengths]

    def psf(weights: Tensor) -> Tensor:
        fields = [
            propagate(
                mask(weights * passed) * wave,
                pitch=float(grid.pitch_y),
                wavelength=wavelength,
                distance=camera.distance,
                shape=grid.shape,
                method="ASM",
                padding=padding,
            )
            for passed, wave, wavelength in zip(filters, waves, camera.wavelengths, strict=True)
        ]
        return torch.stack(fields).abs().square()

    return psf


def _paddings(grid: Grid) -> dict[str, tuple[int, int] | None]:
    return {"its default": None, "half": (grid.rows // 2, grid.columns // 2)}


def _dials(oversampling: int, padding: str) -> dict[str, str | int | float]:
    return {"oversampling": oversampling, "padding": padding, "dtype": "float64"}


def psf_settings(job: PsfJob) -> Iterator[Setting]:
    """Torchoptics' angular spectrum in the PSF job, with two paddings."""
    for oversampling in (1,) if job.quick else (1, 2):
        grid = job.finer(oversampling)
        for name, padding in _paddings(grid).items():
            if padding is None and (job.quick or oversampling > 1):
                continue  # ten seconds a run, and more

            def prepare(
                grid: Grid = grid,
                padding: tuple[int, int] | None = padding,
                oversampling: int = oversampling,
            ) -> Prepared:
                psf = _psf(job.camera, job.scene, grid, padding)
                return job.averaged(psf, oversampling, torch.float64)

            dials = _dials(oversampling, name)
            yield Setting("torchoptics ASM", dials, prepare, source=NAME, free_factor=True)


def transfer_settings(job: TransferJob) -> Iterator[Setting]:
    """Torchoptics' angular spectrum and our binning in the transfer job."""
    for oversampling in (1,) if job.quick else (1, 2):
        grid = job.grid(oversampling)
        padding = _paddings(grid)["half"]

        def prepare(grid: Grid = grid, padding: tuple[int, int] | None = padding) -> Prepared:
            psf = _psf(job.camera, job.scene, grid, padding)
            return job.gray_transfer(psf, grid, torch.float64)

        dials = _dials(oversampling, "half")
        yield Setting("torchoptics ASM", dials, prepare, source=NAME, free_factor=True)
