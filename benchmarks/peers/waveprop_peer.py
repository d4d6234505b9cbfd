"""The camera as waveprop (MIT) simulates it, through its public functions alone.

waveprop is what "Privacy-Enhancing Optical Embeddings for Lensless Classification" was made with.
It gets every benefit of the doubt: an even number of samples (odd sizes come out shifted) whose
FFTs are fast, square cells, colours in the right order, its transfer functions, wavefronts and
object planes computed once and not timed, area binning instead of its bilinear resizing, and the
whole-sample shift and the factor that bring it nearest to the reference - a reference for its own
field of view, which is a whole number of sub-pixels and not the sensor.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from functools import cache, cached_property, partial
from itertools import product
from types import ModuleType
from typing import Any

import numpy as np
import torch
from benchmarks.accuracy.field_job import DISTANCE, PITCH, WAVELENGTH, FieldJob
from benchmarks.accuracy.measure import Prepared, Setting, relative_error
from benchmarks.accuracy.psf_job import PsfJob
from benchmarks.accuracy.reference import reference_psf, reference_transfer
from benchmarks.accuracy.transfer_job import TransferJob
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Sensor
from veilcam_optics.errors import OpticsError, invalid
from veilcam_optics.propagation.sampling import Grid, coverage

NAME = "waveprop"
SAMPLES = (358, 468)
"""Even, nearly square cells of 13 um, where the paper has 380 x 507 of about 12.4 um.

Its FFTs have the length 2 n - 1, whatever its factors: 715 = 5 x 11 x 13 and 935 = 5 x 11 x 17 are
the fastest near the paper's grid, by a third or more.
"""

_SHIFTS = range(-2, 3)
_SCENES_AT_ONCE = 16


def load(module: str) -> ModuleType:
    """Import a module of waveprop.

    waveprop imports torchvision for ``crop`` and ``resize``, which are plain Python; torchvision's
    compiled operators on PyPI want CUDA. With a CPU torch the import passes once the two operators
    that it registers fakes for are declared.

    Raises:
        ImportError: waveprop or something it needs is not installed.
    """
    try:
        importlib.import_module("torchvision")
    except RuntimeError:
        for name in ("nms", "qnms"):
            torch.library.define(
                f"torchvision::{name}",
                "(Tensor dets, Tensor scores, float iou_threshold) -> Tensor",
            )
        importlib.import_module("torchvision")
    return importlib.import_module(f"waveprop.{module}")


class WavepropCamera:
    """PSF and embeddings of a camera by waveprop.

    Args:
        camera: geometry; its window must be what waveprop takes for ``exposed``.
        scene: flat object.
        embedding: shape of the embedding.
        samples: even (rows, columns) of the simulation grid.
        exposed: exposed share of each side of the sensor.

    Raises:
        ImportError: waveprop is not installed.
        OpticsError: odd samples, or another window than waveprop would use.
    """

    def __init__(
        self,
        camera: Camera,
        scene: Scene,
        embedding: Embedding,
        *,
        samples: tuple[int, int] = SAMPLES,
        exposed: float = 0.8,
    ) -> None:
        if samples[0] % 2 or samples[1] % 2:
            raise invalid("samples", samples, "", "even numbers: odd ones come out shifted")
        self.camera, self.scene, self.embedding = camera, scene, embedding
        self.samples, self._exposed = samples, exposed
        self._slm, self._rs = load("slm"), load("rs")
        self._util, self._torch = load("util"), load("pytorch_util")
        devices = load("devices")
        panel, period = camera.panel, max(len(camera.panel.filter_cycle), 1)
        # waveprop counts sub-pixels from the far corner, so everything is turned around.
        filters = [
            [camera.row_amplitudes(channel)[-1 - row] for channel in range(3)]
            for row in range(period)
        ]
        pitch = np.array([panel.pitch_y, panel.pitch_x])
        cell = np.array([panel.aperture_y, panel.aperture_x])
        parameter = devices.SLMParam
        self._slm_config = {
            parameter.NAME: "panel",
            parameter.CELL_SIZE: cell,
            parameter.SHAPE: np.array([panel.rows, panel.columns]),
            parameter.SIZE: pitch * np.array([panel.rows, panel.columns]),
            parameter.PITCH: pitch,
            parameter.DEADSPACE: pitch - cell,
            parameter.COLOR_FILTER: np.array(filters)[:, np.newaxis],
        }
        size = np.array([camera.sensor.height, camera.sensor.width])
        self._sensor_config = {devices.SensorParam.SIZE: size}
        view, _, window = self._slm.get_active_pixel_dim(
            sensor_config=self._sensor_config, sensor_crop=exposed, slm_config=self._slm_config
        )
        if tuple(int(n) for n in window) != camera.mask_shape:
            raise OpticsError(
                f"waveprop takes a window of {tuple(window)}, not {camera.mask_shape}"
            )
        self.view = (float(view[0]), float(view[1]))
        """Height and width [m] that waveprop's grid covers."""
        self.pitches = (self.view[0] / samples[0], self.view[1] / samples[1])
        self._offset = (0, 0)

    @property
    def own_camera(self) -> Camera:
        """The camera with a sensor as large as waveprop's field of view."""
        columns = self.camera.sensor.columns
        pixel = self.view[1] / columns
        return Camera(
            panel=self.camera.panel,
            window=self.camera.window,
            sensor=Sensor(
                rows=round(self.view[0] / pixel),
                columns=columns,
                pixel=pixel,
                channel_weights=self.camera.sensor.channel_weights,
            ),
            distance=self.camera.distance,
            wavelengths=self.camera.wavelengths,
        )

    def psf(self, weights: Tensor) -> Tensor:
        """From weights, float32, to the irradiance (3, *samples). Differentiable."""
        mask = self._slm.get_slm_mask(
            slm_vals=weights.flip(0, 1),
            slm_config=self._slm_config,
            sensor_config=self._sensor_config,
            crop_fact=self._exposed,
            target_dim=np.array(self.samples),
            deadspace=True,
            dtype=weights.dtype,
        )
        channels = []
        for wavefront, transfer, wavelength, transmittance in zip(
            self._wavefronts, self._transfers, self.camera.wavelengths, mask, strict=True
        ):
            arrived, _, _ = self._rs.angular_spectrum(
                u_in=transmittance * wavefront,
                wv=wavelength,
                d1=list(self.pitches),
                dz=self.camera.distance,
                H=transfer,
                dtype=weights.dtype,
                device="cpu",
            )
            channels.append(arrived.abs().square())
        return torch.stack(channels).roll(self._offset, (1, 2))

    def object_planes(self, scenes: Tensor) -> Tensor:
        """Scenes (batch, rows, columns) as waveprop convolves them: scaled and padded."""
        # Its convolution shows the scene upright.
        plane: Tensor = self._util.prepare_object_plane(
            obj=scenes.flip(-1, -2),
            object_height=self.scene.height,
            scene2mask=self.scene.distance,
            mask2sensor=self.camera.distance,
            sensor_size=np.array(self.view),
            sensor_dim=np.array(self.samples),
        )
        return plane

    def embed(self, planes: Tensor, psf: Tensor) -> Tensor:
        """From object planes (batch, *samples) and a PSF to gray embeddings (batch, pixels)."""
        shares = torch.tensor(self.camera.sensor.channel_weights, dtype=psf.dtype)
        gray = torch.einsum("c,cyx->yx", shares, psf)
        image = self._torch.RealFFTConvolve2D(gray[None])(planes)
        rows, columns = self._binning
        binned: Tensor = rows @ image @ columns.T
        return binned.flatten(1)

    def transfer(self, weights: Tensor) -> Tensor:
        """The transfer matrix, one unit scene after another."""
        count = self.scene.rows * self.scene.columns
        units = torch.eye(count, dtype=weights.dtype).reshape(count, *self.scene.shape)
        psf = self.psf(weights)
        parts = [units[i : i + _SCENES_AT_ONCE] for i in range(0, count, _SCENES_AT_ONCE)]
        return torch.cat([self.embed(self.object_planes(part), psf) for part in parts])

    def register(self, weights: Tensor, use: Callable[[Tensor], Tensor], truth: Tensor) -> None:
        """Choose the whole-sample shift of the PSF that brings ``use(psf)`` nearest to a truth."""
        psf = self.psf(weights)
        errors = {
            shift: relative_error(use(psf.roll(shift, (1, 2))), truth, free_factor=True)
            for shift in product(_SHIFTS, _SHIFTS)
        }
        dy, dx = min(errors, key=lambda shift: errors[shift])
        self._offset = (self._offset[0] + dy, self._offset[1] + dx)

    @cached_property
    def _wavefronts(self) -> list[Any]:
        spherical = load("spherical")
        return [
            spherical.spherical_prop(
                in_shape=self.samples,
                d1=list(self.pitches),
                wv=wavelength,
                dz=self.scene.distance,
                return_psf=True,
                dtype=np.float64,
                is_torch=True,
            )[0].to(torch.complex64)
            for wavelength in self.camera.wavelengths
        ]

    @cached_property
    def _transfers(self) -> list[Any]:
        blank = torch.zeros(self.samples, dtype=torch.float64)
        return [
            self._rs.angular_spectrum(
                u_in=blank,
                wv=wavelength,
                d1=list(self.pitches),
                dz=self.camera.distance,
                return_H=True,
                dtype=torch.float64,
                device="cpu",
            ).to(torch.complex64)
            for wavelength in self.camera.wavelengths
        ]

    @cached_property
    def _binning(self) -> tuple[Tensor, Tensor]:
        matrices = []
        for count, samples in zip(self.embedding.shape, self.samples, strict=True):
            edges = torch.linspace(-samples / 2, samples / 2, count + 1, dtype=torch.float64)
            shares = coverage(edges[:-1], edges[1:], samples, 1.0)
            matrices.append((shares / shares.sum(1, keepdim=True)).float())
        return matrices[0], matrices[1]


def transfer_settings(job: TransferJob) -> Iterator[Setting]:
    """Waveprop in the transfer job: its PSF and FFT convolution, timed for *one* scene."""
    truth: Callable[[], Tensor] | None = None
    for oversampling in (1,) if job.quick else (1, 2):
        samples = (SAMPLES[0] * oversampling, SAMPLES[1] * oversampling)
        peer = WavepropCamera(job.camera, job.scene, job.embedding, samples=samples)
        if truth is None:
            # Good to 4e-4, far below what is to be seen.
            truth = cache(
                partial(
                    reference_transfer,
                    peer.own_camera,
                    job.scene,
                    job.embedding,
                    job.weights,
                    oversampling=20,
                )
            )
        yield Setting(
            "waveprop PSF + FFT convolution",
            {"oversampling": oversampling, "dtype": "float32", "timed": "one scene"},
            partial(_prepare_transfer, job, peer, truth),
            source=NAME,
            free_factor=True,
            reference=truth,
        )


def _prepare_transfer(
    job: TransferJob, peer: WavepropCamera, truth: Callable[[], Tensor]
) -> Prepared:
    weights = job.weights.float()
    draw = torch.Generator().manual_seed(0)
    scenes = torch.rand(2, *job.scene.shape, generator=draw)
    planes = peer.object_planes(scenes)
    peer.register(
        weights, lambda psf: peer.embed(planes, psf), scenes.flatten(1).double() @ truth()
    )
    one = planes[:1]
    return Prepared(lambda: peer.embed(one, peer.psf(weights)), lambda: peer.transfer(weights))


def psf_settings(job: PsfJob) -> Iterator[Setting]:
    """Waveprop in the PSF job, on cells that differ a little from ours."""
    for oversampling in (1,) if job.quick else (1, 2):
        samples = (SAMPLES[0] * oversampling, SAMPLES[1] * oversampling)
        peer = WavepropCamera(job.camera, job.scene, Embedding(), samples=samples)
        cells = Grid(*SAMPLES, peer.view[0] / SAMPLES[0], peer.view[1] / SAMPLES[1])
        truth = cache(
            partial(reference_psf, job.camera, job.scene, job.weights, cells, oversampling=16)
        )
        yield Setting(
            "waveprop angular spectrum",
            {"oversampling": oversampling, "dtype": "float32"},
            partial(_prepare_psf, job, peer, oversampling, truth),
            source=NAME,
            free_factor=True,
            reference=truth,
        )


def _prepare_psf(
    job: PsfJob, peer: WavepropCamera, oversampling: int, truth: Callable[[], Tensor]
) -> Prepared:
    weights = job.weights.float()
    shape = (3, SAMPLES[0], oversampling, SAMPLES[1], oversampling)

    def averaged(psf: Tensor) -> Tensor:
        return psf.reshape(shape).mean((2, 4))

    peer.register(weights, averaged, truth())
    return Prepared(lambda: averaged(peer.psf(weights)))


def field_settings(job: FieldJob) -> Iterator[Setting]:
    """Waveprop's propagators in the free-field job: source and target share one grid."""
    for oversampling in (1, 3, 5) if job.quick else (1, 3, 5, 9):
        for precision, dtype in (("float32", torch.complex64), ("float64", torch.complex128)):
            dials = {"oversampling": oversampling, "dtype": precision}
            yield Setting(
                "waveprop angular spectrum",
                dials,
                partial(_prepare_spectrum, job, oversampling, dtype),
                source=NAME,
                free_factor=True,
            )
            yield Setting(
                "waveprop Fresnel convolution",
                dials,
                partial(_prepare_fresnel, job, oversampling, dtype),
                source=NAME,
                free_factor=True,
            )


def _prepare_spectrum(job: FieldJob, oversampling: int, dtype: torch.dtype) -> Prepared:
    propagate = load("rs").angular_spectrum
    pattern = job.pattern(job.target(oversampling)).to(dtype)
    pitch = PITCH / oversampling
    transfer = propagate(
        u_in=pattern, wv=WAVELENGTH, d1=pitch, dz=DISTANCE, return_H=True, dtype=dtype, device="cpu"
    )

    def run() -> Tensor:
        field, _, _ = propagate(
            u_in=pattern,
            wv=WAVELENGTH,
            d1=pitch,
            dz=DISTANCE,
            H=transfer,
            dtype=dtype,
            device="cpu",
        )
        return job.at_points(field, oversampling)

    return Prepared(run)


def _prepare_fresnel(job: FieldJob, oversampling: int, dtype: torch.dtype) -> Prepared:
    propagate = load("fresnel").fresnel_conv
    pattern = job.pattern(job.target(oversampling)).to(dtype)

    def run() -> Tensor:
        field, _, _ = propagate(
            u_in=pattern, wv=WAVELENGTH, d1=PITCH / oversampling, dz=DISTANCE, device="cpu"
        )
        return job.at_points(field, oversampling)

    return Prepared(run)
