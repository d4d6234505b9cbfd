"""Accuracy chart: its methods, errors, fronts, other libraries, and the command."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
import torch
import typer
from benchmarks.accuracy import __main__ as command
from benchmarks.accuracy.algorithm1 import Algorithm1, Resampling
from benchmarks.accuracy.field_job import FieldJob
from benchmarks.accuracy.fresnel import FresnelImpulse, FresnelTransfer
from benchmarks.accuracy.measure import (
    Job,
    measure,
)
from benchmarks.accuracy.rayleigh_sommerfeld import RayleighSommerfeld
from benchmarks.accuracy.transfer_job import TransferJob
from benchmarks.peers import accuracy
from tests.unit.optics.propagation.test_closed_forms import RAYLEIGH, WAVELENGTH, gaussian
from tests.unit.optics.tensors import mask, relative
from torch import Tensor
from typer.testing import CliRunner

from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Sensor, Window
from veilcam_optics.propagation import Propagator
from veilcam_optics.propagation.sampling import Grid
from veilcam_optics.transfer.grid import GridLight


@pytest.fixture(scope="module")
def transfer() -> tuple[Job, Tensor]:
    """The quick job of transfers with its truth, which takes longer than all that is held to it."""
    job = TransferJob(quick=True).job()
    return job, job.reference()


@pytest.mark.thorough
def test_algorithm_of_the_paper_is_one_of_the_methods(transfer: tuple[Job, Tensor]) -> None:
    job, truth = transfer
    errors = {
        s.dials["resampling"]: measure(s, truth, least=1, budget=1e-9).error
        for s in job.settings
        if s.method == "Algorithm 1" and s.dials["dtype"] == "float32"
    }
    assert 4 * errors["area"] < errors["bilinear"] < 0.5


@pytest.mark.thorough
def test_quick_run_writes_table_json_and_charts(tmp_path: Path) -> None:
    app, out = typer.Typer(), tmp_path / "results"
    app.command()(command.main)
    ran = CliRunner().invoke(app, ["--quick", "--job", "field", "--out", str(out)])
    assert ran.exit_code == 0, ran.output
    assert "Free field" in ran.stdout
    names = {file.name for file in out.iterdir()}
    assert names == {"accuracy.json", "accuracy.png", "accuracy-field.png"}
    points = json.loads((out / "accuracy.json").read_text())["jobs"]["field"]["points"]
    exact = [
        each["error"]
        for each in points
        if each["method"] == "angular spectrum"
        and each["dials"]["padding"] == "full"
        and each["dials"]["dtype"] == "float64"
    ]
    assert exact[0] > 5 * exact[1] > 10 * exact[2]


PEERS = accuracy.PEERS


@pytest.mark.parametrize("peer", PEERS, ids=lambda peer: peer.name)
def test_peers_solve_the_same_problem(peer):  # type: ignore[no-untyped-def]
    """Independent code, same physics: each peer's field comes as near as sampling allows."""
    if reason := peer.missing():
        pytest.skip(reason)
    field = FieldJob(quick=True)
    errors = [
        measure(s, field.reference(), least=1, budget=1e-9).error
        for s in peer.field(field)
        if s.dials["oversampling"] == 3
    ]
    assert errors
    assert max(errors) < 5e-2


def test_waveprop_sees_the_same_scene_as_we_do() -> None:
    """Inversion, colours and scale agree: what is left is its sampling of the mask."""
    peer = next(peer for peer in PEERS if peer.name == "waveprop")
    if reason := peer.missing():
        pytest.skip(reason)
    job = TransferJob(quick=True)
    (chosen,) = peer.transfer(job)
    assert 1e-2 < measure(chosen, torch.empty(0), least=1, budget=1e-9).error < 0.1


@pytest.mark.parametrize(
    ("method", "rayleigh_ranges"),
    [
        (FresnelTransfer(), 0.2),
        (FresnelTransfer(guard=1), 1.0),
        (FresnelImpulse(), 2.0),
        (FresnelImpulse(), 3.0),
        (RayleighSommerfeld(), 1.0),
    ],
    ids=repr,
)
@pytest.mark.parametrize("pitch", [3.6e-6, 3e-6], ids=["same pitch", "other pitch"])
def test_gaussian_beam_arrives_as_its_closed_form(
    method: Propagator, rayleigh_ranges: float, pitch: float
) -> None:
    distance = RAYLEIGH * rayleigh_ranges
    source = Grid.square(40, 41, 3.6e-6)
    target = Grid(40, 38, pitch, pitch, centre_x=4e-6)
    assert method.supports(source, target, distance, WAVELENGTH)
    got = method.prepare(source, target, distance, WAVELENGTH)(gaussian(source, 0))
    wanted = gaussian(target, distance)
    assert relative(got, wanted) < 3e-3


SCENE = Scene(14, 14, 0.12, 0.4)
EMBEDDING = Embedding(12, 16)
# The algorithm knows the PSF on the sensor only, so the mask's shadow has to lie within.
SMALL = Camera(window=Window(25, 11, 180, 74), sensor=Sensor(1520, 2028), distance=2e-3)


def pictures(*shape: int) -> Tensor:
    return torch.rand(shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)


def test_grid_is_the_papers() -> None:
    grid = Algorithm1(Camera(), SCENE, EMBEDDING).grid
    assert grid.shape == (380, 507)
    assert float(grid.pitch_y) == pytest.approx(12.4e-6)


def test_area_variant_agrees_with_the_grid_path_and_bilinear_does_not() -> None:
    light = GridLight(SMALL, SCENE, 2)
    weights, scene = mask(SMALL), pictures(3, 14, 14)
    wanted = light.embed(scene, light.psf(weights), EMBEDDING)
    errors = {}
    both: tuple[Resampling, ...] = ("area", "bilinear")
    for resampling in both:
        simulation = Algorithm1(SMALL, SCENE, EMBEDDING, resampling, snr_db=math.inf)
        errors[resampling] = relative(simulation(scene, simulation.psf(weights)), wanted)
    assert errors["area"] < 1e-2
    assert errors["bilinear"] > 4 * errors["area"]
