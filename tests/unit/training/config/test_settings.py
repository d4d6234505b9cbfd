"""Recipes by name, and settings from files, of which no unknown key passes."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from veilcam_optics.camera.geometry import Camera
from veilcam_training.config.recipes import RECIPES, TASKS, Recipe, Situation, find_recipe, scenes
from veilcam_training.config.settings import (
    FreshSettings,
    Settings,
    load_fresh_settings,
    load_settings,
)
from veilcam_training.data import Source
from veilcam_training.encoders.fresh import Misalignment
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.model import make_model


@pytest.mark.parametrize(
    ("situation", "batch", "optimiser", "every"),
    [
        (Situation(encoder="lens"), 64, "adam", None),
        (Situation(), 100, "adam", None),
        (Situation(classifier="FC800", encoder="diffuser"), 32, "adam", 20),
        (Situation(classifier="FC800"), 64, "adam", 20),
        (Situation("celeba-gender", "lens", classifier="FC800"), 64, "adam", 10),
        (Situation("celeba-smiling", classifier="FC800"), 64, "adam", 20),
        (Situation("cifar10", "lens", "27x36", "VGG11"), 32, "sgd", 10),
        (Situation("cifar10", "learned", "27x36", "VGG11"), 32, "sgd", 20),
    ],
)
def test_paper_recipes(situation: Situation, batch: int, optimiser: str, every: int | None) -> None:
    recipe = find_recipe("paper", situation)
    assert recipe.epochs == 50
    assert recipe.batch == batch
    assert recipe.optimiser == optimiser
    assert recipe.rate == (1e-2 if optimiser == "sgd" else 1e-3)
    assert recipe.schedule == ("constant" if every is None else "steps")
    assert every is None or recipe.steps_every == every
    assert recipe.normalisation == "shared"
    assert recipe.jitter.mirror == (situation.data == "cifar10")


@pytest.mark.parametrize(
    ("encoder", "embedding", "share"),
    [
        ("lens", "27x36", 4 / 27),
        ("diffuser", "27x36", 1 / 27),
        ("learned", "27x36", 2 / 27),
        ("lens", "6x8", 2 / 6),
        ("learned", "3x4", 0),
        ("learned", "24x32", 0),
    ],
)
def test_papers_padding_of_cifar10(encoder: str, embedding: str, share: float) -> None:
    recipe = find_recipe("paper", Situation("cifar10", encoder, embedding, "VGG11"))
    assert recipe.jitter.shift == pytest.approx(share)


def test_our_recipes() -> None:
    for classifier in ("LR", "FC800", "CNN16", "VGG11"):
        short, long = (
            find_recipe(name, Situation(classifier=classifier)) for name in ("default", "long")
        )
        assert (short.epochs, long.epochs) == (15, 50)
        assert short.model_copy(update={"epochs": 50}) == long
    gray, colour = (
        find_recipe("default", Situation("cifar10", classifier="Scene32", colour=colour))
        for colour in (False, True)
    )
    assert (gray.optimiser, gray.jitter.mirror, colour.jitter.mirror) == ("nesterov", False, True)
    with pytest.raises(TrainingError, match=f"use one of {', '.join(RECIPES)}"):
        find_recipe("worst", Situation())


SIZES = ("24x32", "12x16", "6x8", "3x4")


@pytest.mark.thorough
@pytest.mark.parametrize("encoder", ["learned", "fixed_simulated"])
@pytest.mark.parametrize("classifier", ["LR", "FC800", "CNN16"])
@pytest.mark.parametrize("change", ["none", "shift", "rotate"])
def test_best_recipes_are_valid(source: Source, encoder: str, classifier: str, change: str) -> None:
    for embedding in SIZES if change == "none" else SIZES[:1]:
        recipe = find_recipe("best", Situation("mnist", encoder, embedding, classifier, change))
        assert Recipe.model_validate(recipe.model_dump()) == recipe
        # What a recipe asks of encoder and classifier is the same at every size.
        settings = Settings(encoder=encoder, embedding="3x4", classifier=classifier, recipe=recipe)
        make_model(settings, source, Camera())


def test_best_recipe_depends_on_the_situation() -> None:
    for classifier in ("LR", "FC800"):
        recipes = [find_recipe("best", Situation("mnist", "learned", s, classifier)) for s in SIZES]
        assert all(a != b for a, b in pairwise(recipes))
        large = find_recipe("best", Situation("mnist", "learned", "30x40", classifier))
        assert large == recipes[0]
        # A camera that does not learn has settings of its own.
        fixed = [find_recipe("best", Situation("mnist", "lens", s, classifier)) for s in SIZES]
        assert not any(recipe in recipes for recipe in fixed)
    assert [recipe.jitter.any for recipe in fixed] == [True, True, False, False]
    shift = Situation("mnist", "learned", "24x32", "CNN16", "shift")
    assert find_recipe("best", shift).mask_start == "pinhole"
    assert find_recipe("best", replace(shift, encoder="lens")).mask_start == "random"
    fashion = Situation("fashion", classifier="FC800")
    assert find_recipe("best", fashion) == find_recipe("long", fashion)


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "settings.toml"
    path.write_text(text)
    return path


FILE = """
data = "fashion"
classifier = "FC800"
psf = "psf.npz"
seed = 3

[recipe]
base = "paper"
epochs = 7

[recipe.jitter]
rotation = 5.0

[recipe.panel_errors]
shift = 5e-5
"""


def test_file(tmp_path: Path) -> None:
    settings = load_settings(write(tmp_path, FILE), {})
    assert (settings.data, settings.classifier, settings.seed) == ("fashion", "FC800", 3)
    assert settings.psf == Path("psf.npz")
    paper = find_recipe("paper", Situation("fashion", classifier="FC800"))
    assert settings.recipe.epochs == 7
    assert settings.recipe.batch == paper.batch
    assert settings.recipe.jitter.rotation == 5
    assert settings.recipe.panel_errors.shift == 5e-5
    assert settings.recipe.panel_errors.places == 8
    by_name = load_settings(write(tmp_path, 'recipe = "long"'), {})
    assert by_name.recipe == find_recipe("long", Situation())
    assert load_settings(None, {}) == Settings(recipe=find_recipe("default", Situation()))
    with pytest.raises(TrainingError, match="missing: give a TOML file"):
        load_settings(tmp_path / "none.toml", {})


def test_options_go_before_the_file(tmp_path: Path) -> None:
    overrides = {"classifier": "LR", "recipe": {"epochs": 2}}
    settings = load_settings(write(tmp_path, FILE), overrides)
    assert settings.classifier == "LR"
    assert settings.recipe.epochs == 2
    assert settings.recipe.batch == find_recipe("paper", Situation("fashion")).batch
    assert load_settings(write(tmp_path, FILE), {"recipe": {"base": "default"}}).recipe.batch == 256


def test_none_in_a_file_where_a_setting_may_be_none(tmp_path: Path) -> None:
    text = 'classifier = "FC800"\nrecipe = {base = "best", snr_db = "none", patience = "none"}'
    recipe = load_settings(write(tmp_path, text), {}).recipe
    assert recipe.snr_db is None
    assert recipe.patience is None
    best = find_recipe("best", Situation(classifier="FC800"))
    assert recipe == best.model_copy(update={"snr_db": None, "patience": None})


WHITE = "[recipe]\nnormalisation = 'white'\n"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("encodr = 'lens'", "encodr is not valid: Extra"),
        ("[recipe]\nepoch = 3", "epoch is not valid: Extra"),
        ("[recipe.jitter]\ntwist = 3.0", "jitter.twist is not valid: Extra"),
        ("[recipe]\nepochs = '3'", "epochs is not valid"),
        ("[recipe]\nepochs = true", "epochs is not valid"),
        ("[recipe]\nrate = -1.0", "rate is not valid"),
        ("[recipe]\nrate = 'none'", "rate is not valid"),
        ("[recipe]\nepochs = 'none'", "epochs is not valid"),
        ("[recipe]\nsnr_db = 'None'", "snr_db is not valid"),
        (f"{WHITE}precision = 'mixed'", r"settings\.toml: normalisation .*: use precision 'full'"),
        (f"{WHITE}averaging = 0.9", "normalisation 'white' changes its .*: use averaging 0"),
        ("[recipe]\nbase = 'none'", "recipe 'none' is unknown"),
        ("recipe = 3", "use a name or a table"),
        ("change = 'twist'", "change is not valid"),
        ("seed = -1", "seed is not valid"),
        ("seed = ", "not a TOML file"),
    ],
)
def test_files_that_are_refused(tmp_path: Path, text: str, reason: str) -> None:
    with pytest.raises(TrainingError, match=reason) as caught:
        load_settings(write(tmp_path, text), {})
    assert "\n" not in str(caught.value)


def test_task_of_fresh_masks_is_the_ground_of_its_file(tmp_path: Path) -> None:
    for name in TASKS:
        load_fresh_settings(None, {"task": name})
    digits = FreshSettings(classifier="Scene16", recipe=scenes("mnist", colour=False))
    assert load_fresh_settings(None, {}) == digits
    text = 'task = "mnist_shift"\nrecipe = {epochs = 3}\n[misalignment]\nshift = 0.0\n'
    path = write(tmp_path, text)
    settings = load_fresh_settings(path, {"seed": 3})
    assert (settings.placement, settings.recipe.epochs, settings.seed) == ("anywhere", 3, 3)
    assert (settings.recipe.pooling, settings.recipe.jitter.crop) == (2, 2)
    assert settings.recipe.batch == scenes("mnist", colour=False).batch
    assert settings.misalignment == Misalignment(shift=0.0, panels=4)
    assert load_fresh_settings(path, {"task": "mnist_6x8"}).spread == 0.25
    none = write(tmp_path, 'task = "mnist_6x8"\nspread = "none"\nmisalignment = "none"')
    with pytest.raises(TrainingError, match="task mnist_6x8: sede is not valid"):
        load_fresh_settings(None, {"task": "mnist_6x8", "sede": 3})
    without = load_fresh_settings(none, {})
    assert (without.spread, without.misalignment) == (None, None)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("task = 'mnist'", "task 'mnist' is unknown"),
        ("sede = 3", r"settings\.toml: sede is not valid: Extra"),
        ("recipe = {epochs = 0}", "epochs is not valid"),
        ("recipe = 'best'", "recipe is not valid: use a table"),
        ("misalignment = 3", "misalignment is not valid"),
        ("masks = 0", "masks is not valid"),
        ("epochs = ", "not a TOML file"),
    ],
)
def test_files_of_fresh_masks_that_are_refused(tmp_path: Path, text: str, reason: str) -> None:
    with pytest.raises(TrainingError, match=reason) as caught:
        load_fresh_settings(write(tmp_path, text), {})
    assert "\n" not in str(caught.value)
