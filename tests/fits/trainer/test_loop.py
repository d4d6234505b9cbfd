"""A fit learns, repeats exactly, survives being killed, and obeys every option of its recipe."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from tests.unit.training.conftest import write_digits

from veilcam_optics.camera.geometry import Camera, Window
from veilcam_training.bundle.layers import Affine
from veilcam_training.config.recipes import SCENES
from veilcam_training.config.settings import FitSettings, FreshMasks
from veilcam_training.data import Source, Split, open_source, split
from veilcam_training.encoders import PanelErrors
from veilcam_training.encoders.fresh import Misalignment
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.fit import run_fit
from veilcam_training.experiments.model import fresh_statistics, make_fresh_model, make_model
from veilcam_training.seeding import derive, seeded
from veilcam_training.trainer.callbacks import Callback, Epoch, MovingAverage
from veilcam_training.trainer.loop import Fit, fit
from veilcam_training.trainer.step import evaluate, make_optimiser
from veilcam_training.transforms.augmentation import Augmentation

WINDOW = Camera(window=Window(rows=8, columns=4))
SMALL = FitSettings(embedding="6x8", epochs=3, batch=90, rate=1e-2, mask_rate=5e-2)


def settings(**changes: Any) -> FitSettings:
    return SMALL.model_copy(update=changes)


def fresh(**changes: Any) -> FitSettings:
    """The same for fresh masks; what these have of ``changes`` goes there."""
    masks: dict[str, Any] = {
        "misalignment": Misalignment(panels=2),
        "masks": 4,
        "validation_masks": 4,
    }
    masks |= {name: changes.pop(name) for name in FreshMasks.model_fields if name in changes}
    small = {"rank": 20, "epochs": 3, "batch": 64, "rate": 0.1, "averaging": 0.9}
    chosen = FitSettings(embedding="3x4", classifier="Scene2", fresh=FreshMasks(**masks))
    return chosen.model_copy(update={**SCENES, **small, **changes})


def run(source: Source, chosen: FitSettings, **options: Any) -> Fit:
    parts = split(source.training())
    if chosen.fresh is None:
        model = make_model(chosen, source, Camera())
        return fit(model, parts, chosen, **options)
    statistics = fresh_statistics(chosen, WINDOW, source.scene, parts.training)
    model = make_fresh_model(chosen, source, WINDOW, statistics)
    model.encoder.learn_range()
    return fit(model, parts, chosen, **options)


def weights_of(result: Fit) -> torch.Tensor:
    return torch.cat([tensor.flatten().double() for tensor in result.model.state_dict().values()])


@pytest.fixture(scope="module")
def few(tmp_path_factory: pytest.TempPathFactory) -> Source:
    """Images for three steps of an epoch: enough where results are compared, not judged."""
    return open_source("mnist", write_digits(tmp_path_factory.mktemp("few"), 300, 100, packed=True))


@pytest.fixture(scope="module")
def reference(few: Source) -> Fit:
    return run(few, settings(epochs=1))


@pytest.fixture(scope="module")
def fresh_reference(few: Source) -> Fit:
    return run(few, fresh())


@pytest.mark.parametrize("encoder", ["learned", "fixed_simulated", "digital"])
def test_fit_learns(source: Source, encoder: str) -> None:
    outcome = run_fit(settings(epochs=8, batch=30, encoder=encoder), source, Camera())
    assert outcome.accuracy.value > 0.9
    assert outcome.accuracy.samples == 100
    assert outcome.fit.history[-1].loss < 0.5 * outcome.fit.history[0].loss


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("chosen", "other"),
    [(settings(), settings(seed=1)), (fresh(epochs=1), fresh(epochs=1, seed=1))],
)
def test_same_seed_gives_the_same_result(
    few: Source, chosen: FitSettings, other: FitSettings
) -> None:
    first = run(few, chosen)
    torch.manual_seed(1)  # what ran before does not matter
    expected = torch.rand(3)
    torch.manual_seed(1)
    again = run(few, chosen)
    assert torch.equal(torch.rand(3), expected)  # and random numbers of others are left alone
    assert torch.equal(weights_of(again), weights_of(first))
    assert again.history[0].loss == first.history[0].loss
    assert not torch.equal(weights_of(run(few, other)), weights_of(first))


@pytest.mark.thorough
@pytest.mark.parametrize(
    "changes",
    [
        *({"epochs": 2}, {"batch": 30}, {"optimiser": "sgd"}, {"rate": 2e-2}, {"mask_rate": 1e-2}),
        *({"mask_start": "pinhole"}, {"weight_decay": 0.5}, {"schedule": "constant"}),
        *({"warm_up": 0.5}, {"label_smoothing": 0.2}, {"averaging": 0.9}),
        *({"jitter": Augmentation(rotation=5.0)}, {"jitter": Augmentation(scale=0.1)}),
        *({"jitter": Augmentation(shift=0.05)}, {"jitter": Augmentation(mirror=True)}),
        *({"panel_errors": PanelErrors(gamma=0.1)}, {"panel_errors": PanelErrors(floor=0.1)}),
        {"panel_errors": PanelErrors(shift=5e-5, places=2)},
        {"panel_errors": PanelErrors(distance=5e-5, places=2)},
        *({"snr_db": 20.0}, {"snr_db": None}, {"normalisation": "shared"}),
        *({"classifier": "FC20"}, {"embedding": "3x4"}, {"binning": "point"}),
    ],
    ids=lambda changes: "-".join(f"{k}={v}" for k, v in changes.items()),
)
def test_every_option_has_an_effect(few: Source, reference: Fit, changes: dict[str, Any]) -> None:
    after = weights_of(run(few, settings(**{"epochs": 1, **changes})))
    before = weights_of(reference)
    assert before.shape != after.shape or not torch.equal(before, after)


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        *({"exponent": 4.0}, {"rank": 10}, {"snr_db": 20.0}, {"model_error": 0.05}),
        *({"misalignment": None}, {"misalignment": Misalignment(panels=3)}),
        {"misalignment": Misalignment(shift=5e-5, panels=2)},
        {"misalignment": Misalignment(distance=2e-4, panels=2)},
        *({"jitter": Augmentation()}, {"epochs": 2}, {"batch": 128}, {"masks": 2}, {"pooling": 2}),
        *({"optimiser": "sgd"}, {"rate": 2e-3}, {"weight_decay": 0.5}, {"label_smoothing": 0.3}),
        *({"averaging": 0.0}, {"spread": 0.4}, {"seed": 1}),
        {"validation_masks": 8},
    ],
    ids=lambda changes: "-".join(map(str, changes)),
)
def test_every_setting_for_fresh_masks_changes_the_result(
    few: Source, fresh_reference: Fit, changes: dict[str, Any]
) -> None:
    other = run(few, fresh(**{"epochs": 1, **changes}))
    first, after = fresh_reference.history[0], other.history[0]
    assert len(other.history) == changes.get("epochs", 1)
    assert (after.loss, after.validation_loss) != (first.loss, first.validation_loss)


@pytest.fixture(scope="module")
def unchanged(source: Source) -> Fit:
    return run(source, settings())


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rescale", "rotate", "perspective"])
def test_changes_of_the_scene(source: Source, unchanged: Fit, name: str) -> None:
    """Training and testing both see the change, and it makes the task harder."""
    outcome = run_fit(settings(change=name), source, Camera())
    assert outcome.fit.best.validation_loss > unchanged.best.validation_loss
    model, test = outcome.fit.model, source.test()
    first, again = (evaluate(model, test, 0, "test") for _ in range(2))
    assert torch.equal(first.logits, again.logits)
    assert first.loss != evaluate(model, test, 1, "test").loss


def test_dropout_in_training_alone(source: Source) -> None:
    plain, dropped = (run(source, settings(classifier="FC20", dropout=p)) for p in (0.0, 0.4))
    assert not torch.equal(weights_of(plain), weights_of(dropped))
    test = source.test()
    first, again = (evaluate(dropped.model, test, 0, "test") for _ in range(2))
    assert first.loss == again.loss


# With learning rates like these nothing gets better.
STILL = {"rate": 1e-12, "epochs": 30, "patience": 2}


@pytest.mark.slow
@pytest.mark.parametrize(
    "chosen",
    [
        settings(**STILL, mask_rate=1e-12),
        fresh(**STILL, averaging=0.0),
    ],
    ids=["pair", "fresh"],
)
def test_early_stop(source: Source, chosen: FitSettings) -> None:
    result = run(source, chosen)
    assert len(result.history) < 30
    assert len(result.history) - 1 - result.best.number == 2


@pytest.mark.parametrize("encoder", ["learned", "lens", "digital"])
def test_unit_of_a_measurement_does_not_matter(source: Source, encoder: str) -> None:
    model = make_model(settings(encoder=encoder), source, Camera())
    assert isinstance(model.layers[0], Affine)
    white = model.encoder(torch.ones(1, 28, 28)).detach() * model.layers[0].scale
    assert float(white.square().mean().sqrt()) == pytest.approx(1, rel=0.01)


def test_schedules() -> None:
    steps = FitSettings(epochs=50, schedule="steps", steps_every=20)
    assert [steps.rate_factor(epoch / 50) for epoch in (0, 19, 20, 39, 40)] == pytest.approx(
        [1, 1, 0.1, 0.1, 0.01]
    )
    cycle = FitSettings(schedule="one_cycle", warm_up=0.25)
    factors = [cycle.rate_factor(i / 100) for i in range(100)]
    assert max(factors) == factors[25] == 1.0
    assert factors[:26] == sorted(factors[:26])
    assert factors[25:] == sorted(factors[25:], reverse=True)
    assert factors[0] < 0.1
    assert 0 < factors[-1] < 0.01
    assert FitSettings(schedule="constant").rate_factor(0.9) == 1.0


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


class StopAfter(Callback):
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
        assert epoch.processor_seconds > 0


@pytest.mark.thorough
@pytest.mark.parametrize(
    "chosen",
    [
        settings(),
        settings(normalisation="white", classifier="FC20"),
        settings(
            dropout=0.2,
            jitter=Augmentation(rotation=10.0, shift=0.05),
            panel_errors=PanelErrors(gamma=0.1, floor=0.05, shift=2e-5, places=2),
            patience=5,
            classifier="FC20",
            change="rotate",
        ),
        fresh(spread=0.3),
    ],
    ids=["plain", "white", "everything", "fresh ranges"],
)
def test_resumed_is_as_unbroken(few: Source, tmp_path: Path, chosen: FitSettings) -> None:
    path = tmp_path / "work" / "fit.checkpoint"
    with pytest.raises(InterruptionError):
        run(few, chosen, checkpoint=path, fingerprint="a", callbacks=[StopAfter(1, 2)])
    observer = StopAfter(-1, -1)
    resumed = run(few, chosen, checkpoint=path, fingerprint="a", callbacks=[observer])
    assert observer.seen[0] == (1, 1)
    unbroken = run(few, chosen)
    assert torch.equal(weights_of(resumed), weights_of(unbroken))
    assert [(e.loss, e.validation_loss) for e in resumed.history] == [
        (e.loss, e.validation_loss) for e in unbroken.history
    ]
    # One that is done is not done again.
    again = StopAfter(-1, -1)
    done = run(few, chosen, checkpoint=path, fingerprint="a", callbacks=[again])
    assert again.seen == []
    assert torch.equal(weights_of(done), weights_of(unbroken))
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_checkpoint_of_another_fit_is_refused(source: Source, tmp_path: Path) -> None:
    path = tmp_path / "fit.checkpoint"
    run_fit(settings(epochs=1), source, Camera(), checkpoint=path)
    with pytest.raises(TrainingError, match="of another fit"):
        run_fit(settings(), source, Camera(), checkpoint=path)


def test_epoch_that_validates_best_is_kept(source: Source) -> None:
    # At this rate the last epochs of a constant schedule are no better than earlier ones.
    chosen = settings(epochs=6, rate=1.0, mask_rate=0.5, schedule="constant")
    result = run(source, chosen)
    accuracies = [epoch.validation_accuracy for epoch in result.history]
    assert result.best.validation_accuracy == max(accuracies)
    validation = split(source.training()).validation
    again = evaluate(result.model, validation, 0, "validation")
    assert again.accuracy == max(accuracies)
    assert not result.model.training


def test_running_mean_of_weights(source: Source) -> None:
    model = make_model(settings(), source, Camera())
    weight = next(model.classifier.parameters())
    with torch.no_grad():
        weight.fill_(1.0)
    average, resumed = MovingAverage(model, 0.5), MovingAverage(model, 0.5)
    with torch.no_grad():
        weight.fill_(11.0)
    # The first steps count for more than half: 9/10, 9/11, ...
    for done, expected in ((1, 1 + 0.9 * 10), (2, 10 + 9 / 11)):
        average.step(0, done, 2)
        with average.applied():
            mean = next(model.classifier.parameters())
            assert mean[0].item() == pytest.approx(expected, rel=1e-6)
        assert next(model.classifier.parameters()) is weight
    resumed.load_state_dict(average.state_dict())
    for each in (average, resumed):
        each.step(0, 3, 3)
    assert str(resumed.state_dict()) == str(average.state_dict())


def test_loss_that_is_no_number(source: Source) -> None:
    chosen = settings(epochs=2, optimiser="sgd", rate=10.0, mask_rate=1e-3)
    model = make_model(chosen, source, Camera())
    with torch.no_grad():
        next(model.classifier.parameters()).fill_(float("nan"))
    with pytest.raises(TrainingError, match="use lower learning rates"):
        fit(model, split(source.training()), chosen)
    with pytest.raises(TrainingError, match="no images"):
        evaluate(model, source.test().take(torch.arange(0)), 0, "test")


def test_noise_is_fresh_in_every_epoch_and_step(source: Source) -> None:
    model = make_model(settings(rate=1e-9), source, Camera())
    seen: list[torch.Tensor] = []
    model.encoder.add_noise = (  # type: ignore[method-assign]
        lambda values, snr_db, generator: seen.append(torch.rand(2, generator=generator)) or values  # type: ignore[func-returns-value]
    )
    fit(model, split(source.training()), SMALL)
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


@pytest.mark.parametrize("encoder", ["fixed_simulated", "lens", "learned"])
def test_noise_is_fresh_each_time_an_image_is_seen(source: Source, encoder: str) -> None:
    """One image, many times over: whatever differs between two measurements of it is noise."""
    # The camera stays what it is.
    chosen = settings(embedding="3x4", encoder=encoder, epochs=2, batch=30, mask_rate=1e-12)
    model, first = make_model(chosen, source, Camera()), source.test().take(torch.zeros(60).long())
    seen: list[torch.Tensor] = []

    def look(_: object, measurements: tuple[torch.Tensor]) -> None:
        if model.training:
            seen.append(measurements[0].detach())

    model.classifier.register_forward_pre_hook(look)
    fit(model, Split(first, first), chosen)
    measurements = {tuple(measurement) for measurement in torch.cat(seen).tolist()}
    assert len(measurements) == 2 * len(first)
