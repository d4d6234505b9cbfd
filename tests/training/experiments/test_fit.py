"""A job: what a fit depends on, what it may see, and bad data found before it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from veilcam_optics.camera.geometry import Camera
from veilcam_training.bundle.layers import BatchNorm, LayerNorm, ReLU
from veilcam_training.config.recipes import Recipe
from veilcam_training.config.settings import Settings
from veilcam_training.data import Images, Source, open_source
from veilcam_training.data.idx import DIGITS, IdxSource
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.fit import FitResult, run_fit
from veilcam_training.experiments.model import make_model
from veilcam_training.trainer.callbacks import Epoch

SMALL = Recipe(epochs=3, batch=90, rate=1e-2, mask_rate=5e-2)
Writer = Callable[..., Path]


def settings(**changes: Any) -> Settings:
    return Settings(embedding="3x4", recipe=SMALL).model_copy(update=changes)


class Unfitted:
    """An observer of a fit that must not begin."""

    def step(self, epoch: int, done: int, steps: int) -> None:
        raise AssertionError

    def epoch(self, epoch: Epoch) -> None:
        raise AssertionError


def refused(chosen: Settings, source: Source) -> str:
    """What a job says that is refused before its fit begins."""
    with pytest.raises(TrainingError) as caught:
        run_fit(chosen, source, Camera(), callbacks=[Unfitted()])
    return str(caught.value)


# --- bad data


def test_a_damaged_test_set_costs_no_fit(plain_folder: Path) -> None:
    path = plain_folder / "t10k-images-idx3-ubyte"
    path.write_bytes(path.read_bytes()[:-1])
    assert "bytes but says" in refused(settings(), open_source("mnist", plain_folder))


def test_an_empty_test_set_costs_no_fit(digit_folder: Path) -> None:
    class Untested(IdxSource):
        def test(self) -> Images:
            return super().test().take(torch.arange(0))

    assert "mnist has no test images" in refused(
        settings(), Untested("mnist", DIGITS, digit_folder)
    )


@pytest.mark.parametrize(
    ("people", "reason"),
    [(3, "has 3 identities, too few"), (5, "leaves 0 of 4 groups to validate with: use more")],
)
def test_too_few_faces_for_all_parts(
    faces_file: Writer, tmp_path: Path, people: int, reason: str
) -> None:
    faces_file(tmp_path, identity=np.arange(120) % people)
    assert reason in refused(settings(data="faces-gender"), open_source("faces-gender", tmp_path))


# --- what a fit sees


@pytest.fixture(scope="module")
def outcome(source: Source) -> FitResult:
    return run_fit(settings(), source, Camera())


def test_the_test_set_has_no_part_in_a_fit(digit_folder: Path, outcome: FitResult) -> None:
    class Mistaken(IdxSource):
        def test(self) -> Images:
            images = super().test()
            return Images(images.pixels, (images.labels + 1) % len(DIGITS))

    mistaken = run_fit(settings(), Mistaken("mnist", DIGITS, digit_folder), Camera())
    assert [epoch.validation_loss for epoch in mistaken.fit.history] == [
        epoch.validation_loss for epoch in outcome.fit.history
    ]
    assert mistaken.fit.best.validation_accuracy == outcome.fit.best.validation_accuracy
    assert mistaken.fit.best.number == outcome.fit.best.number
    weights = outcome.fit.model.state_dict()
    for name, value in mistaken.fit.model.state_dict().items():
        assert torch.equal(value, weights[name])
    assert mistaken.accuracy.value != outcome.accuracy.value


# --- what a model is made of


@pytest.mark.parametrize("normalisation", ["per_pixel", "shared"])
@pytest.mark.parametrize(
    ("encoder", "rectified"),
    [("learned", True), ("digital", True), ("fixed_simulated", False), ("lens", False)],
)
def test_a_learned_sensor_is_rectified(
    source: Source, encoder: str, normalisation: str, *, rectified: bool
) -> None:
    recipe = SMALL.model_copy(update={"normalisation": normalisation})
    model = make_model(settings(encoder=encoder, recipe=recipe), source, Camera())
    kinds = [type(layer) for layer in model.layers]
    assert (kinds[kinds.index(BatchNorm) + 1] is ReLU) == rectified
    assert kinds.count(ReLU) == int(rectified)


@pytest.mark.parametrize(("exposure", "count"), [("fixed", 0), ("automatic", 1)])
def test_exposure(source: Source, exposure: str, count: int) -> None:
    recipe = SMALL.model_copy(update={"exposure": exposure})
    model = make_model(settings(recipe=recipe), source, Camera())
    assert [type(layer) for layer in model.layers].count(LayerNorm) == count


# --- what it is known by


@dataclass(frozen=True)
class Files(IdxSource):
    """A data set of which only the digests are known."""

    def digests(self) -> Mapping[str, str]:
        return {"images": "00", "labels": "11"}


FILES = Files("mnist", DIGITS, Path())


@pytest.mark.parametrize(
    ("chosen", "digest"),
    [
        (Settings(), "136d4ae7e94c2a2eaa3cd22a3158475e76ca9d474f64b792ff274a5fe00b6a84"),
        (
            Settings(data="fashion", embedding="3x4", seed=7),
            "86ca671c91ea1b3c7e5789b678570bed094f9f6961582ac59e975e9ad45fdc5f",
        ),
    ],
)
def test_fingerprints_stay_what_they_are(
    monkeypatch: pytest.MonkeyPatch, chosen: Settings, digest: str
) -> None:
    """Another fingerprint disowns every checkpoint and cell there is."""
    monkeypatch.setattr(torch, "__version__", "2.13.0")
    assert chosen.fingerprint(FILES) == digest
    monkeypatch.setattr(torch, "__version__", "2.13.1")
    assert chosen.fingerprint(FILES) != digest


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
