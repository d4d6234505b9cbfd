"""A fit learns, repeats exactly, survives being killed, and obeys every option of its recipe."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import torch

from veilcam_optics.camera.geometry import Camera
from veilcam_training.bundle.layers import Affine
from veilcam_training.config.recipes import Recipe
from veilcam_training.data import Source, split
from veilcam_training.encoders import PanelErrors
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.fit import Settings, make_model, run_job
from veilcam_training.seeding import derive, seeded
from veilcam_training.trainer import checkpoint as checkpoints
from veilcam_training.trainer.evaluation import evaluate
from veilcam_training.trainer.loop import Epoch, Fit, fit
from veilcam_training.trainer.step import make_optimiser
from veilcam_training.transforms.augmentation import Augmentation

SMALL = Recipe(epochs=3, batch=90, rate=1e-2, mask_rate=5e-2)


def settings(recipe: Recipe = SMALL, **changes: Any) -> Settings:
    return Settings(embedding="6x8", recipe=recipe).model_copy(update=changes)


def run(source: Source, chosen: Settings, **options: Any) -> Fit:
    model = make_model(chosen, source, Camera())
    return fit(model, split(source.training()), chosen.recipe, chosen.seed, **options)


def weights_of(result: Fit) -> torch.Tensor:
    return torch.cat([tensor.flatten().double() for tensor in result.model.state_dict().values()])


@pytest.fixture(scope="module")
def reference(source: Source) -> Fit:
    return run(source, settings())


@pytest.mark.parametrize("encoder", ["learned", "fixed_simulated", "digital"])
def test_it_learns(source: Source, encoder: str) -> None:
    outcome = run_job(
        settings(SMALL.model_copy(update={"epochs": 8, "batch": 30}), encoder=encoder),
        source,
        Camera(),
    )
    assert outcome.accuracy.value > 0.9
    assert outcome.accuracy.samples == 100
    assert outcome.fit.history[-1].loss < 0.5 * outcome.fit.history[0].loss


def test_the_same_seed_gives_the_same_result(source: Source, reference: Fit) -> None:
    torch.manual_seed(1)  # what ran before does not matter
    assert torch.equal(weights_of(run(source, settings())), weights_of(reference))
    assert not torch.equal(weights_of(run(source, settings(seed=1))), weights_of(reference))


def test_a_fit_leaves_global_random_numbers_alone(source: Source) -> None:
    torch.manual_seed(5)
    expected = torch.rand(3)
    torch.manual_seed(5)
    run(source, settings(SMALL.model_copy(update={"epochs": 1})))
    assert torch.equal(torch.rand(3), expected)


@pytest.mark.parametrize(
    "changes",
    [
        {"epochs": 2},
        {"batch": 30},
        {"optimiser": "sgd"},
        {"rate": 2e-2},
        {"mask_rate": 1e-2},
        {"mask_start": "pinhole"},
        {"weight_decay": 0.5},
        {"schedule": "constant"},
        {"warm_up": 0.5},
        {"label_smoothing": 0.2},
        {"precision": "mixed"},
        {"jitter": Augmentation(rotation=5.0)},
        {"jitter": Augmentation(scale=0.1)},
        {"jitter": Augmentation(shift=0.05)},
        {"jitter": Augmentation(mirror=True)},
        {"panel_errors": PanelErrors(gamma=0.1)},
        {"panel_errors": PanelErrors(floor=0.1)},
        {"panel_errors": PanelErrors(shift=5e-5, places=2)},
        {"panel_errors": PanelErrors(distance=5e-5, places=2)},
        {"snr_db": 20.0},
        {"snr_db": None},
        {"normalisation": "shared"},
    ],
    ids=lambda changes: "-".join(f"{k}={v}" for k, v in changes.items()),
)
def test_every_option_changes_the_result(
    source: Source, reference: Fit, changes: dict[str, Any]
) -> None:
    changed = run(source, settings(SMALL.model_copy(update=changes)))
    before, after = weights_of(reference), weights_of(changed)
    assert before.shape != after.shape or not torch.equal(before, after)


@pytest.mark.parametrize(
    "changes", [{"classifier": "FC20"}, {"embedding": "3x4"}, {"reading": "point"}]
)
def test_every_setting_changes_the_result(
    source: Source, reference: Fit, changes: dict[str, Any]
) -> None:
    after = weights_of(run(source, settings(**changes)))
    assert after.shape != weights_of(reference).shape or not torch.equal(
        after, weights_of(reference)
    )


@pytest.mark.parametrize("name", ["rescale", "rotate", "perspective"])
def test_changes_of_the_scene(source: Source, reference: Fit, name: str) -> None:
    """Training and testing both see the change, and it makes the task harder."""
    outcome = run_job(settings(change=name), source, Camera())
    assert outcome.fit.best.validation_loss > reference.best.validation_loss
    model, test = outcome.fit.model, source.test()
    first, again = (evaluate(model, test, 0, "test") for _ in range(2))
    assert torch.equal(first.predictions, again.predictions)
    assert first.loss != evaluate(model, test, 1, "test").loss


def test_dropout_in_training_alone(source: Source) -> None:
    chosen = settings(classifier="FC20")
    with_dropout = chosen.model_copy(update={"recipe": SMALL.model_copy(update={"dropout": 0.4})})
    plain, dropped = run(source, chosen), run(source, with_dropout)
    assert not torch.equal(weights_of(plain), weights_of(dropped))
    test = source.test()
    first, again = (evaluate(dropped.model, test, 0, "test") for _ in range(2))
    assert first.loss == again.loss


def test_early_stop(source: Source) -> None:
    # With learning rates like these nothing gets better.
    recipe = SMALL.model_copy(
        update={"rate": 1e-12, "mask_rate": 1e-12, "epochs": 30, "patience": 2}
    )
    result = run(source, settings(recipe))
    assert len(result.history) < 30
    assert len(result.history) - 1 - result.best.number == 2


@pytest.mark.parametrize("encoder", ["learned", "lens", "digital"])
def test_the_unit_of_a_reading_does_not_matter(source: Source, encoder: str) -> None:
    model = make_model(settings(encoder=encoder), source, Camera())
    assert isinstance(model.layers[0], Affine)
    white = model.encoder(torch.ones(1, 28, 28)).detach() * model.layers[0].scale
    assert float(white.square().mean().sqrt()) == pytest.approx(1, rel=0.01)


def test_schedules() -> None:
    steps = Recipe(epochs=50, schedule="steps", steps_every=20)
    assert [steps.rate_factor(epoch / 50) for epoch in (0, 19, 20, 39, 40)] == pytest.approx(
        [1, 1, 0.1, 0.1, 0.01]
    )
    cycle = Recipe(schedule="one_cycle", warm_up=0.25)
    factors = [cycle.rate_factor(i / 100) for i in range(100)]
    assert max(factors) == factors[25] == 1.0
    assert factors[:26] == sorted(factors[:26])
    assert factors[25:] == sorted(factors[25:], reverse=True)
    assert factors[0] < 0.1
    assert 0 < factors[-1] < 0.01
    assert Recipe(schedule="constant").rate_factor(0.9) == 1.0


def test_weight_decay_spares_the_mask_and_the_vectors(source: Source) -> None:
    model = make_model(settings(), source, Camera())
    optimiser = make_optimiser(model, SMALL.model_copy(update={"weight_decay": 0.1}))
    decay = {
        id(parameter): group["weight_decay"]
        for group in optimiser.param_groups
        for parameter in group["params"]
    }
    for name, parameter in model.named_parameters():
        matrix = name.startswith("classifier") and parameter.ndim > 1
        assert decay[id(parameter)] == (0.1 if matrix else 0.0)


class InterruptionError(Exception):
    pass


class StopAfter:
    """Breaks a fit off in the middle of an epoch."""

    def __init__(self, epoch: int, step: int) -> None:
        self._at = (epoch, step)
        self.seen: list[tuple[int, int]] = []

    def step(self, epoch: int, done: int, steps: int) -> None:
        assert 1 <= done <= steps
        self.seen.append((epoch, done))
        if (epoch, done) == self._at:
            raise InterruptionError

    def epoch(self, epoch: Epoch) -> None:
        assert 0 <= epoch.validation_accuracy <= 1


@pytest.mark.parametrize(
    "chosen",
    [
        settings(),
        settings(encoder="fixed_simulated", classifier="FC20"),
        settings(SMALL.model_copy(update={"normalisation": "white"}), classifier="FC20"),
        settings(
            SMALL.model_copy(
                update={
                    "dropout": 0.2,
                    "jitter": Augmentation(rotation=10.0, shift=0.05),
                    "panel_errors": PanelErrors(gamma=0.1, floor=0.05, shift=2e-5, places=2),
                    "patience": 5,
                }
            ),
            classifier="FC20",
            change="rotate",
        ),
    ],
    ids=["plain", "fixed", "white", "everything"],
)
def test_resumed_is_the_same_as_unbroken(source: Source, tmp_path: Path, chosen: Settings) -> None:
    path = tmp_path / "work" / "fit.checkpoint"
    with pytest.raises(InterruptionError):
        run(source, chosen, checkpoint=path, fingerprint="a", observers=[StopAfter(1, 2)])
    observer = StopAfter(-1, -1)
    resumed = run(source, chosen, checkpoint=path, fingerprint="a", observers=[observer])
    assert observer.seen[0] == (1, 1)
    unbroken = run(source, chosen)
    assert torch.equal(weights_of(resumed), weights_of(unbroken))
    assert [(e.loss, e.validation_loss) for e in resumed.history] == [
        (e.loss, e.validation_loss) for e in unbroken.history
    ]
    # One that is done is not done again.
    again = StopAfter(-1, -1)
    done = run(source, chosen, checkpoint=path, fingerprint="a", observers=[again])
    assert again.seen == []
    assert torch.equal(weights_of(done), weights_of(unbroken))
    assert [file.name for file in path.parent.iterdir()] == [path.name]


KILLED = """
import os, signal, sys
from pathlib import Path
from veilcam_optics.camera.geometry import Camera
from veilcam_training.data import open_source
from veilcam_training.experiments.fit import Settings, run_job

class Kill:
    def step(self, epoch, done, steps):
        if (epoch, done) == (2, 3):
            os.kill(os.getpid(), signal.SIGKILL)
    def epoch(self, epoch):
        pass

settings = Settings.model_validate_json(sys.argv[1])
source = open_source("mnist", Path(sys.argv[2]))
run_job(settings, source, Camera(), checkpoint=Path(sys.argv[3]), observers=[Kill()])
"""


def test_killed_and_started_again(source: Source, digit_folder: Path, tmp_path: Path) -> None:
    chosen, path = settings(), tmp_path / "fit.checkpoint"
    arguments = [chosen.model_dump_json(), str(digit_folder), str(path)]
    killed = subprocess.run([sys.executable, "-c", KILLED, *arguments], check=False)
    assert killed.returncode == -signal.SIGKILL
    saved = checkpoints.load_checkpoint(path, chosen.fingerprint(source))
    assert saved is not None
    assert len(saved["history"]) == 2
    resumed = run_job(chosen, source, Camera(), checkpoint=path)
    unbroken = run_job(chosen, source, Camera())
    assert torch.equal(weights_of(resumed.fit), weights_of(unbroken.fit))
    assert resumed.accuracy == unbroken.accuracy


def test_a_checkpoint_of_another_fit_is_refused(source: Source, tmp_path: Path) -> None:
    path = tmp_path / "fit.checkpoint"
    run_job(settings(SMALL.model_copy(update={"epochs": 1})), source, Camera(), checkpoint=path)
    with pytest.raises(TrainingError, match="of another fit"):
        run_job(settings(), source, Camera(), checkpoint=path)


@pytest.mark.parametrize("data", [b"", b"nothing", b"PK\x03\x04 broken"])
def test_a_damaged_checkpoint_is_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "fit.checkpoint"
    path.write_bytes(data)
    with pytest.raises(TrainingError, match=r"cannot be read .* remove it") as caught:
        checkpoints.load_checkpoint(path, "a")
    assert "\n" not in str(caught.value)


def test_the_epoch_that_validates_best_is_kept(source: Source) -> None:
    # At this rate the last epochs of a constant schedule are no better than earlier ones.
    recipe = Recipe(epochs=6, batch=90, rate=1.0, mask_rate=0.5, schedule="constant")
    result = run(source, settings(recipe))
    accuracies = [epoch.validation_accuracy for epoch in result.history]
    assert result.best.validation_accuracy == max(accuracies)
    validation = split(source.training()).validation
    again = evaluate(result.model, validation, 0, "validation")
    assert again.accuracy == max(accuracies)
    assert not result.model.training


def test_a_loss_that_is_no_number(source: Source) -> None:
    recipe = Recipe(epochs=2, batch=90, optimiser="sgd", rate=10.0, mask_rate=1e-3)
    model = make_model(settings(recipe), source, Camera())
    with torch.no_grad():
        next(model.classifier.parameters()).fill_(float("nan"))
    with pytest.raises(TrainingError, match="use lower learning rates"):
        fit(model, split(source.training()), recipe, 0)


def test_nothing_to_evaluate(source: Source) -> None:
    model = make_model(settings(), source, Camera())
    with pytest.raises(TrainingError, match="no images"):
        evaluate(model, source.test().take(torch.arange(0)), 0, "test")


def test_noise_is_fresh_in_every_epoch_and_step(source: Source) -> None:
    model = make_model(settings(SMALL.model_copy(update={"rate": 1e-9})), source, Camera())
    seen: list[torch.Tensor] = []
    model.encoder.add_noise = (  # type: ignore[method-assign]
        lambda values, snr_db, generator: seen.append(torch.rand(2, generator=generator)) or values  # type: ignore[func-returns-value]
    )
    fit(model, split(source.training()), SMALL, 0)
    steps = SMALL.epochs * (810 // SMALL.batch)
    assert len({tuple(draw.tolist()) for draw in seen}) == steps + 1  # validation always the same
    assert len(seen) == steps + SMALL.epochs


def test_streams_depend_on_seed_and_purpose_alone() -> None:
    assert derive(1, "noise", 2) == derive(1, "noise", 2)
    others = {derive(2, "noise", 2), derive(1, "order", 2), derive(1, "noise", 1), derive(1)}
    assert len(others | {derive(1, "noise", 2)}) == 5
    with seeded(1, "a"):
        first = torch.rand(1)
    with seeded(1, "a"):
        assert torch.equal(torch.rand(1), first)
    with seeded(1, "b"):
        assert not torch.equal(torch.rand(1), first)
