"""Decoding in NumPy and in torch: one formula, so one result but for rounding."""

from __future__ import annotations

import hashlib
import math
import random
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import torch
from torch import Tensor

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.decoding import (
    Decoder,
    MeasurementNoise,
    Precision,
    SceneDecoding,
    SceneStatistics,
    fit_statistics,
)
from veilcam_optics.keys.masks import draw_levels
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_optics.transfer.product import Transfer

Values = npt.NDArray[Any]
KEY = hashlib.sha256(b"turn").digest()
UNIT = 2.0**-53
JOBS = 16


@dataclass(frozen=True)
class Job:
    """What decodes behind a mask, in both libraries, and measurements."""

    decoding: SceneDecoding
    in_numpy: SceneDecoding[Transfer[Values]]
    mask: Tensor
    gain: float | Tensor
    measurements: Tensor

    def prepared(self) -> tuple[Decoder, Decoder[Values]]:
        gain = self.gain.numpy() if isinstance(self.gain, Tensor) else self.gain
        return (
            self.decoding.prepare(self.mask, gain=self.gain),
            self.in_numpy.prepare(self.mask.numpy(), gain=gain),
        )


def numpy_of(decoding: SceneDecoding) -> SceneDecoding[Transfer[Values]]:
    operator, known = decoding.operator, decoding.statistics
    tables = {name: table.numpy() for name, table in operator.transfer.arrays().items()}
    return SceneDecoding(
        Transfer.from_arrays(operator.camera, operator.scene, operator.embedding, tables),
        SceneStatistics(known.mean.numpy(), known.basis.numpy(), known.residual.numpy()),
        decoding.noise,
        precision=decoding.precision,
    )


def scenes_of(scene: Scene, generator: torch.Generator, planes: tuple[int, ...] = ()) -> Tensor:
    """Random brightness over random noise: components of many strengths."""
    shape = (*planes, *scene.shape)
    count = 4 * math.prod(shape) + 2
    bright = torch.rand(count, *(1 for _ in shape), generator=generator)
    return bright * (0.5 + 0.5 * torch.rand(count, *shape, generator=generator))


def draw(seed: int, precision: Precision = Precision.DOUBLE) -> Job:
    """Any small camera and scenes of it, more components than pixels measured or fewer."""
    drawn, generator = random.Random(seed), torch.Generator().manual_seed(seed)
    dtype = getattr(torch, precision.products)
    camera = Camera(
        panel=Panel(filter_cycle=drawn.choice([(), (2, 1, 0)])),
        window=Window(drawn.randint(1, 9), drawn.randint(1, 5)),
        sensor=Sensor(rows=480, columns=640),
    )
    scene = Scene(drawn.choice([1, 3, 5]), drawn.choice([1, 4]), height=0.03)
    embedding = Embedding(drawn.choice([1, 3, 6]), drawn.choice([1, 5]))
    planes = drawn.choice([(), (3,)])
    colour, channels = bool(planes), 3 if planes else 1
    operator = TransferOperator(camera, scene, embedding, step=6e-6, dtype=dtype, colour=colour)
    values = channels * scene.rows * scene.columns
    seen = scenes_of(scene, generator, planes)
    statistics = fit_statistics([seen], drawn.randint(1, values))
    noise = MeasurementNoise(drawn.choice([10.0, 40.0]), drawn.choice([0.0, 0.02]))
    decoding = SceneDecoding(operator, statistics, noise, precision=precision)
    double = torch.float64
    mask = torch.rand(camera.mask_shape, generator=generator, dtype=double)
    mask[drawn.randrange(camera.window.rows)] = drawn.choice([0.0, 0.7])  # a dead row
    gain = drawn.choice([1.0, 3.0, None])
    return Job(
        decoding,
        numpy_of(decoding),
        mask.to(dtype),
        gain or 0.5 + torch.rand(channels * embedding.size, generator=generator),
        (torch.rand(3, *planes, *embedding.shape, generator=generator, dtype=double) / 20).to(
            dtype
        ),
    )


def condition(decoder: Decoder) -> float:
    """Of the matrix that is factored: its smallest eigenvalue is 1."""
    scaled = decoder.response / decoder.noise.sqrt()[:, None]
    return 1 + float(scaled.square().sum())


def arrays_of(decoder: Decoder[Any]) -> dict[str, Values]:
    names = ("mean_measurement", "estimator", "noise", "response", "mean", "basis")
    return {name: np.asarray(getattr(decoder, name)) for name in names}


@pytest.mark.parametrize("seed", range(JOBS))
def test_numpy_and_torch_give_the_same_decoder(seed: int) -> None:
    job = draw(seed)
    torch_s, numpy_s = job.prepared()
    # Cholesky factors, substitution and products of up to 30 terms are stable backwards: each
    # array is off by some roundings of so many terms, times the condition of what is factored.
    allowed = 100 * 30 * UNIT * condition(torch_s)
    assert allowed < 1e-6
    for name, wanted in arrays_of(torch_s).items():
        found = getattr(numpy_s, name)
        assert isinstance(found, np.ndarray), name
        assert found.dtype == wanted.dtype, name
        assert np.abs(found - wanted).max() <= allowed * np.abs(wanted).max(), name
    estimate = job.prepared()[0](job.measurements)
    found = numpy_s(job.measurements.numpy())
    assert found.shape == tuple(estimate.shape)
    # Coordinates cancel: they are as large as the estimator's rows and the measurement allow.
    size = float(torch_s.estimator.abs().sum(1).max() * torch_s.basis.abs().sum(1).max())
    assert np.abs(found - estimate.numpy()).max() <= allowed * (1 + size)
    told = [np.asarray(torch_s.innovation(job.measurements))]
    told.append(numpy_s.innovation(job.measurements.numpy()))
    assert np.abs(told[1] - told[0]).max() <= allowed * (1 + size) * (1 + told[0].max())
    assert numpy_s(job.measurements.numpy()[:0]).shape == (0, *estimate.shape[1:])


@pytest.mark.parametrize("precision", [Precision.SINGLE, Precision.MIXED])
@pytest.mark.parametrize("seed", range(6))
def test_single_precision_is_as_good_in_numpy(seed: int, precision: Precision) -> None:
    """Both are off the estimate in float64 by what rounding the response makes of it."""
    job, exact = draw(seed, precision), draw(seed)
    pair = job.prepared()
    wanted = exact.prepared()[0]
    truth = wanted(job.measurements.double()).numpy()
    found = [np.asarray(pair[0](job.measurements)), pair[1](job.measurements.numpy())]
    assert found[0].dtype == found[1].dtype == np.float32
    size = float(wanted.estimator.abs().sum(1).max() * wanted.basis.abs().sum(1).max())
    allowed = 100 * 30 * 2.0**-24 * condition(wanted) * (1 + size)
    assert max(np.abs(each - truth).max() for each in found) <= allowed


@pytest.mark.parametrize("precision", list(Precision))
def test_numpy_overwrites_what_is_erased(
    precision: Precision, monkeypatch: pytest.MonkeyPatch
) -> None:
    job, made = draw(2, precision), []
    call = Transfer.__call__

    def noted(transfer: Transfer[Values], weights: Values) -> Values:
        made.append(call(transfer, weights))
        return made[-1]

    monkeypatch.setattr(Transfer, "__call__", noted)
    decoder = job.in_numpy.prepare(job.mask.numpy())
    assert len(made) == 1
    assert not made[0].any()
    secret = ("mean_measurement", "estimator", "noise", "response")
    assert all(getattr(decoder, name).any() for name in secret)
    decoder.erase()
    assert not any(getattr(decoder, name).any() for name in secret)
    assert decoder.basis.any()


def test_statistics_are_the_same() -> None:
    scene = Scene(3, 4)
    scenes = scenes_of(scene, torch.Generator().manual_seed(0))
    known, found = fit_statistics([scenes], 5), fit_statistics([scenes.numpy()], 5)
    assert isinstance(found.basis, np.ndarray)
    for name in ("mean", "residual", "variance"):
        assert np.allclose(getattr(found, name), getattr(known, name).numpy(), atol=1e-7)
    # A component's sign is free.
    assert np.allclose(found.basis @ found.basis.T, known.basis @ known.basis.T, atol=1e-6)
    assert found.share == pytest.approx(known.share)


_DEVICE = """
import sys
from benchmarks.deploy.device_path import NotInstalled

sys.meta_path.insert(0, NotInstalled())

import numpy as np
from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Sensor, Window
from veilcam_optics.decoding import Precision, SceneDecoding, SceneStatistics
from veilcam_optics.keys.masks import draw_levels
from veilcam_optics.transfer.product import Transfer

held = dict(np.load(sys.argv[1]))
camera = Camera(window=Window(9, 5), sensor=Sensor(rows=480, columns=640))
known = SceneStatistics(*(held.pop(name) for name in ("mean", "basis", "residual")))
key, seen = held.pop("key").tobytes(), held.pop("seen")
transfer = Transfer.from_arrays(camera, Scene(5, 4, height=0.03), Embedding(3, 5), held)
mask = draw_levels(key, camera=camera) / (camera.panel.levels - 1)
decoder = SceneDecoding(transfer, known, precision=Precision.DOUBLE).prepare(mask)
np.savez(
    sys.argv[2],
    transfer=transfer(mask),
    estimate=decoder(seen),
)
"""


def test_device_without_torch_does_what_training_does(tmp_path: Path) -> None:
    """In a process that cannot import torch or SciPy, from a file of plain arrays."""
    camera = Camera(window=Window(9, 5), sensor=Sensor(rows=480, columns=640))
    scene, embedding = Scene(5, 4, height=0.03), Embedding(3, 5)
    generator = torch.Generator().manual_seed(0)
    operator = TransferOperator(camera, scene, embedding, step=6e-6, dtype=torch.float64)
    decoding = SceneDecoding(
        operator, fit_statistics([scenes_of(scene, generator)], 12), precision=Precision.DOUBLE
    )
    levels = draw_levels(KEY, camera=camera)
    mask = torch.from_numpy(levels / (camera.panel.levels - 1))
    seen = torch.rand(3, *embedding.shape, generator=generator, dtype=torch.float64) / 20
    decoder = decoding.prepare(mask)
    wanted = {
        "transfer": operator(mask),
        "estimate": decoder(seen),
    }
    known = decoding.statistics
    held = {
        "mean": known.mean.numpy(),
        "basis": known.basis.numpy(),
        "residual": known.residual.numpy(),
        "key": np.frombuffer(KEY, np.uint8),
        "seen": seen.numpy(),
        **{name: table.numpy() for name, table in operator.transfer.arrays().items()},
    }
    np.savez(tmp_path / "held.npz", allow_pickle=False, **held)
    subprocess.run(
        [sys.executable, "-c", _DEVICE, tmp_path / "held.npz", tmp_path / "found.npz"], check=True
    )
    found = np.load(tmp_path / "found.npz")
    for name, tensor in wanted.items():
        assert np.abs(found[name] - tensor.numpy()).max() <= 1e-6, name
        assert found[name].any()
