"""A job: what a fit depends on, what it may see, and bad data found before it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import torch

from veilcam_optics.camera.geometry import Camera, Embedding, Panel, Scene, Sensor, Window
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.effects import Model, Sampling
from veilcam_optics.errors import OpticsError
from veilcam_optics.simulation.operator import LightOperator
from veilcam_optics.transfer.tables import Reach
from veilcam_training.bundle.layers import BatchNorm, LayerNorm, ReLU
from veilcam_training.config.settings import FitSettings, FreshMasks
from veilcam_training.data import Images, Source, open_source
from veilcam_training.data.idx import DIGITS, IdxSource
from veilcam_training.encoders import LearnedMask, Mask, Setup
from veilcam_training.errors import TrainingError
from veilcam_training.experiments import fit as fitting
from veilcam_training.experiments.fit import FitResult, light_plan, run_fit, transfer_error
from veilcam_training.experiments.model import make_model
from veilcam_training.seeding import stream
from veilcam_training.trainer.callbacks import Callback, Epoch

SMALL = FitSettings(embedding="3x4", epochs=3, batch=90, rate=1e-2, mask_rate=5e-2)
Writer = Callable[..., Path]


def settings(**changes: Any) -> FitSettings:
    return SMALL.model_copy(update=changes)


class Unfitted(Callback):
    """An observer of a fit that must not begin."""

    def step(self, epoch: int, done: int, steps: int) -> None:
        raise AssertionError

    def epoch(self, epoch: Epoch) -> None:
        raise AssertionError


def refused(chosen: FitSettings, source: Source) -> str:
    """What a job says that is refused before its fit begins."""
    with pytest.raises(TrainingError) as caught:
        run_fit(chosen, source, Camera(), callbacks=[Unfitted()])
    return str(caught.value)


# --- bad data


def test_bad_test_set_costs_no_fit(plain_folder: Path) -> None:
    class Untested(IdxSource):
        def test(self) -> Images:
            return super().test().take(torch.arange(0))

    untested = Untested("mnist", DIGITS, plain_folder)
    assert "mnist has no test images" in refused(settings(), untested)
    path = plain_folder / "t10k-images-idx3-ubyte"
    path.write_bytes(path.read_bytes()[:-1])
    assert "bytes but says" in refused(settings(), open_source("mnist", plain_folder))


@pytest.mark.parametrize(
    ("people", "reason"),
    [(3, "has groups: 3, too few"), (5, "leaves 0 of 4 groups to validate with: use more")],
)
def test_too_few_faces_for_parts(
    faces_file: Writer, tmp_path: Path, people: int, reason: str
) -> None:
    faces_file(tmp_path, identity=np.arange(120) % people)
    assert reason in refused(settings(data="faces-gender"), open_source("faces-gender", tmp_path))


# --- what a fit sees


@pytest.fixture(scope="module")
def outcome(source: Source) -> FitResult:
    return run_fit(settings(), source, Camera())


def test_test_set_has_no_part_in_a_fit(digit_folder: Path, outcome: FitResult) -> None:
    class Mistaken(IdxSource):
        def test(self) -> Images:
            images = super().test()
            return Images(images.pixels, (images.labels + 1) % len(DIGITS))

    mistaken = run_fit(settings(), Mistaken("mnist", DIGITS, digit_folder), Camera())
    losses, best = (
        [[epoch.validation_loss for epoch in each.fit.history] for each in (mistaken, outcome)],
        [(each.fit.best.validation_accuracy, each.fit.best.number) for each in (mistaken, outcome)],
    )
    assert losses[0] == losses[1]
    assert best[0] == best[1]
    weights = outcome.fit.model.state_dict()
    for name, value in mistaken.fit.model.state_dict().items():
        assert torch.equal(value, weights[name])
    assert mistaken.accuracy.value != outcome.accuracy.value


# --- how far its transfer is from the full field


@pytest.fixture(autouse=True)
def transfer_check() -> None:
    """Leave the check of a transfer as it is."""


SMALL_CAMERA = Camera(
    panel=Panel(32, 32, 8e-6, 8e-6, 7e-6, 7e-6, filter_cycle=()),
    window=Window(8, 8, 0, 0),
    sensor=Sensor(60, 80),
    distance=1e-3,
)
"""Of fine sub-pixels, whose light interferes far beyond the nearest."""
SMALL_SETUP = Setup(SMALL_CAMERA, Scene(3, 2, height=0.05), Embedding(4, 5), tolerance=0.03)


def whole_error(encoder: Mask) -> float:
    """Every entry, every pair."""
    weights = torch.from_numpy(to_weights(encoder.levels(), SMALL_CAMERA.panel)).double()
    every = Sampling(reach=Reach(8, 8), step=0.1e-6, dtype=torch.float64)
    geometry = (SMALL_CAMERA, SMALL_SETUP.scene, SMALL_SETUP.embedding)
    full = LightOperator(Model(*geometry, sampling=every))(weights)
    trained = encoder.eval().transfer().detach()
    if encoder.setup.colour:
        shares = torch.tensor(SMALL_CAMERA.sensor.channel_weights)
        trained = torch.einsum("c,cpe->pe", shares, trained)
    return float((trained - full).norm() / full.norm())


@pytest.mark.slow
@pytest.mark.parametrize("colour", [False, True])
def test_transfer_s_error_is_that_of_all_pairs(*, colour: bool) -> None:
    """One interval of ten may miss: what has to hold is three times as wide."""
    setup = replace(SMALL_SETUP, colour=colour)
    encoder = LearnedMask(setup, stream(0, "encoder"))
    found, true, planned = transfer_error(encoder), whole_error(encoder), light_plan(setup)
    assert found is not None
    assert planned is not None
    assert found.low < planned.error < min(found.high, setup.tolerance)
    assert abs(math.log(true / found.value)) < 3 * math.log(found.high / found.value)
    assert true > 5e-3, "training left something out"
    told = [found.value, found.low, found.high]
    assert told == [float(f"{value:.2g}") for value in told], "two digits leave"


@pytest.mark.slow
def test_worst_grid_counts() -> None:
    finer = replace(SMALL_SETUP, finer=(Scene(3, 2, height=0.005),))
    encoder = LearnedMask(finer, stream(0, "encoder"))
    alone = LearnedMask(SMALL_SETUP, stream(0, "encoder"))
    small = LearnedMask(replace(SMALL_SETUP, scene=finer.finer[0]), stream(0, "encoder"))
    planned = [light_plan(each.setup) for each in (alone, small)]
    assert light_plan(finer) == planned[1] != planned[0]
    errors = [transfer_error(each) for each in (alone, small)]
    assert errors[0] != errors[1]
    assert transfer_error(encoder) == max(filter(None, errors), key=lambda error: error.value)


def test_without_a_panel_or_of_points_there_is_no_mask_to_check(
    source: Source, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A check that cannot be costs no fit.
    monkeypatch.setattr(fitting, "check", Mock(side_effect=OpticsError))
    assert transfer_error(LearnedMask(SMALL_SETUP, stream(0, "encoder"))) is None
    setup = replace(SMALL_SETUP, point_binning=True)
    assert transfer_error(LearnedMask(setup, stream(0, "encoder"))) is None
    fitted = run_fit(settings(encoder="lens", epochs=1), source, Camera())
    assert (fitted.light, fitted.transfer_error, light_plan(setup)) == (None, None, None)


# --- what a model is made of


@pytest.mark.parametrize("normalisation", ["per_pixel", "shared"])
@pytest.mark.parametrize(
    ("encoder", "rectified"),
    [("learned", True), ("digital", True), ("fixed_simulated", False), ("lens", False)],
)
def test_learned_is_rectified(
    source: Source, encoder: str, normalisation: str, *, rectified: bool
) -> None:
    chosen = settings(encoder=encoder, normalisation=normalisation)
    model = make_model(chosen, source, Camera())
    kinds = [type(layer) for layer in model.layers]
    assert (kinds[kinds.index(BatchNorm) + 1] is ReLU) == rectified
    assert kinds.count(ReLU) == int(rectified)
    assert kinds.count(LayerNorm) == 0
    automatic = chosen.model_copy(update={"exposure": "automatic"})
    model = make_model(automatic, source, Camera())
    assert [type(layer) for layer in model.layers].count(LayerNorm) == 1


# --- what it is known by


@dataclass(frozen=True)
class Files(IdxSource):
    """A data set of which only the digests are known."""

    def digests(self) -> Mapping[str, str]:
        return {"images": "00", "labels": "11"}


FILES = Files("mnist", DIGITS, Path())


def test_fingerprint_tells_settings_and_torch_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    changes: list[dict[str, object]] = [{}, {"seed": 1}, {"embedding": "3x4"}]
    changes += [{"epochs": 3}, {"rank": 10}, {"fresh": FreshMasks()}]
    chosen = [FitSettings().model_copy(update=change) for change in changes]
    monkeypatch.setattr(torch, "__version__", "2.13.0")
    found = {each.fingerprint(FILES) for each in chosen}
    assert len(found) == len(changes)
    assert chosen[0].model_copy().fingerprint(FILES) in found
    monkeypatch.setattr(torch, "__version__", "2.13.1")
    assert chosen[0].fingerprint(FILES) not in found


def test_of_a_psf_the_content_counts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    contents = {"a.npz": b"one", "b.npz": b"one", "c.npz": b"two"}
    for name, content in contents.items():
        (tmp_path / name).write_bytes(content)

    def fingerprint(psf: Path | None) -> str:
        return settings(encoder="fixed_measured", psf=psf).fingerprint(FILES)

    same = {fingerprint(path) for path in (Path("a.npz"), tmp_path / "a.npz", Path("b.npz"))}
    assert len(same | {fingerprint(Path("c.npz"))}) == 2
    assert len(same | {fingerprint(None)}) == 2
    for told in ({"psf_pitch": 1e-5}, {"psf_distance": 1e-3}):
        beside = settings(encoder="fixed_measured", psf=Path("a.npz"), **told)
        assert len(same | {beside.fingerprint(FILES)}) == 2
        with pytest.raises(TrainingError, match="there is no measured PSF"):
            _ = settings(**told).psf_file


@pytest.mark.parametrize(
    ("seen", "starts"),
    [
        ((0.0,), (7,)),
        ((0.04, 0.04), (7, 7)),  # more than a fit allows itself, less than a daemon does
        ((0.2, 0.2, 0.0), (7, 7, 8)),
        ((0.2, 0.2, 0.2, 0.2), (7, 7, 8, 9)),
    ],
)
def test_mask_that_shows_the_scene_is_learned_again_from_another_start(
    source: Source, monkeypatch: pytest.MonkeyPatch, seen: tuple[float, ...], starts: tuple[int]
) -> None:
    made: list[int] = []

    def make(chosen: FitSettings, *rest: Any) -> Any:
        made.append(chosen.seed)
        return make_model(chosen, *rest)

    eye = Mock(random=0.0, seen=lambda _: seen[len(made) - 1])
    monkeypatch.setattr(fitting, "_eye", lambda _: eye)
    monkeypatch.setattr(fitting, "make_model", make)
    monkeypatch.setattr(fitting, "prepare", lambda *_: None)
    monkeypatch.setattr(fitting, "_in_stages", lambda model, *_, **__: Mock(model=model))
    run_fit(settings(seed=7, classifier="Scene8"), source, Camera())
    assert tuple(made) == starts
