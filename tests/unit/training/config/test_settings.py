"""Recipes by name, and settings from files, of which no unknown key passes."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from veilcam_optics.camera.geometry import Camera
from veilcam_training.config.files import load_settings
from veilcam_training.config.recipes import RECIPES, SCENES, find_recipe
from veilcam_training.config.settings import FitSettings, FreshMasks
from veilcam_training.data import Source
from veilcam_training.encoders.fresh import Misalignment
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.model import make_model


@pytest.mark.parametrize(
    ("situation", "batch", "optimiser", "every"),
    [
        (FitSettings(encoder="lens"), 64, "adam", None),
        (FitSettings(), 100, "adam", None),
        (FitSettings(classifier="FC800", encoder="diffuser"), 32, "adam", 20),
        (FitSettings(classifier="FC800"), 64, "adam", 20),
        (FitSettings(data="celeba-gender", encoder="lens", classifier="FC800"), 64, "adam", 10),
        (FitSettings(data="celeba-smiling", classifier="FC800"), 64, "adam", 20),
        (
            FitSettings(data="cifar10", encoder="lens", embedding="27x36", classifier="VGG11"),
            32,
            "sgd",
            10,
        ),
        (
            FitSettings(data="cifar10", encoder="learned", embedding="27x36", classifier="VGG11"),
            32,
            "sgd",
            20,
        ),
    ],
)
def test_paper_recipes(
    situation: FitSettings, batch: int, optimiser: str, every: int | None
) -> None:
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
    recipe = find_recipe(
        "paper",
        FitSettings(data="cifar10", encoder=encoder, embedding=embedding, classifier="VGG11"),
    )
    assert recipe.jitter.shift == pytest.approx(share)


def test_our_recipes() -> None:
    for classifier in ("LR", "FC800", "CNN16", "VGG11"):
        short, long = (
            find_recipe(name, FitSettings(classifier=classifier)) for name in ("default", "long")
        )
        assert (short.epochs, long.epochs) == (15, 50)
        assert short.model_copy(update={"epochs": 50}) == long
    gray, colour = (
        find_recipe("default", FitSettings(data="cifar10", classifier="Scene32"), colour=colour)
        for colour in (False, True)
    )
    assert (gray.optimiser, gray.jitter.mirror, colour.jitter.mirror) == ("nesterov", False, True)
    with pytest.raises(TrainingError, match=f"use one of {', '.join(RECIPES)}"):
        find_recipe("worst", FitSettings())


SIZES = ("24x32", "12x16", "6x8", "3x4")


@pytest.mark.thorough
@pytest.mark.parametrize("encoder", ["learned", "fixed_simulated"])
@pytest.mark.parametrize("classifier", ["LR", "FC800", "CNN16"])
@pytest.mark.parametrize("change", ["none", "shift", "rotate"])
def test_best_recipes_are_valid(source: Source, encoder: str, classifier: str, change: str) -> None:
    for embedding in SIZES if change == "none" else SIZES[:1]:
        names: dict[str, Any] = {"encoder": encoder, "classifier": classifier, "change": change}
        recipe = find_recipe("best", FitSettings(embedding=embedding, **names))
        assert FitSettings.model_validate(recipe.model_dump()) == recipe
        # What a recipe asks of encoder and classifier is the same at every size.
        make_model(recipe.model_copy(update={"embedding": "3x4"}), source, Camera())


def values(name: str, **names: Any) -> FitSettings:
    """Values of a recipe, without the names that it goes by."""
    plain = {"encoder": "learned", "embedding": "24x32"}
    return find_recipe(name, FitSettings(**names)).model_copy(update=plain)


def test_best_recipe_depends_on_the_situation() -> None:
    for classifier in ("LR", "FC800"):
        recipes = [
            values("best", encoder="learned", embedding=s, classifier=classifier) for s in SIZES
        ]
        assert all(a != b for a, b in pairwise(recipes))
        large = values("best", embedding="30x40", classifier=classifier)
        assert large == recipes[0]
        # A camera that does not learn has settings of its own.
        fixed = [values("best", encoder="lens", embedding=s, classifier=classifier) for s in SIZES]
        assert not any(recipe in recipes for recipe in fixed)
    assert [recipe.jitter.any for recipe in fixed] == [True, True, False, False]
    shift = FitSettings(
        data="mnist", encoder="learned", embedding="24x32", classifier="CNN16", change="shift"
    )
    assert find_recipe("best", shift).mask_start == "pinhole"
    assert find_recipe("best", shift.model_copy(update={"encoder": "lens"})).mask_start == "random"
    fashion = FitSettings(data="fashion", classifier="FC800")
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
recipe = "paper"
epochs = 7

[jitter]
rotation = 5.0

[panel_errors]
shift = 5e-5
"""


def test_file(tmp_path: Path) -> None:
    settings = load_settings(write(tmp_path, FILE), {})
    assert (settings.data, settings.classifier, settings.seed) == ("fashion", "FC800", 3)
    assert settings.psf == Path("psf.npz")
    paper = find_recipe("paper", FitSettings(data="fashion", classifier="FC800"))
    assert settings.epochs == 7
    assert settings.batch == paper.batch
    assert settings.jitter.rotation == 5
    assert settings.panel_errors.shift == 5e-5
    assert settings.panel_errors.places == 8
    by_name = load_settings(write(tmp_path, 'recipe = "long"'), {})
    assert by_name == find_recipe("long", FitSettings())
    assert load_settings(None, {}) == find_recipe("default", FitSettings())
    with pytest.raises(TrainingError, match="missing: give a TOML file"):
        load_settings(tmp_path / "none.toml", {})


def test_options_go_before_the_file(tmp_path: Path) -> None:
    overrides = {"classifier": "LR", "epochs": 2}
    settings = load_settings(write(tmp_path, FILE), overrides)
    assert settings.classifier == "LR"
    assert settings.epochs == 2
    assert settings.batch == find_recipe("paper", FitSettings(data="fashion")).batch
    assert load_settings(write(tmp_path, FILE), {"recipe": "default"}).batch == 256


def test_none_in_a_file_where_a_setting_may_be_none(tmp_path: Path) -> None:
    text = 'classifier = "FC800"\nrecipe = "best"\nsnr_db = "none"\npatience = "none"'
    recipe = load_settings(write(tmp_path, text), {})
    assert recipe.snr_db is None
    assert recipe.patience is None
    best = find_recipe("best", FitSettings(classifier="FC800"))
    assert recipe == best.model_copy(update={"snr_db": None, "patience": None})


WHITE = "normalisation = 'white'\n"


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("encodr = 'lens'", "encodr is not valid: Extra"),
        ("epoch = 3", "epoch is not valid: Extra"),
        ("[jitter]\ntwist = 3.0", "jitter.twist is not valid: Extra"),
        ("epochs = '3'", "epochs is not valid"),
        ("epochs = true", "epochs is not valid"),
        ("rate = -1.0", "rate is not valid"),
        ("rate = 'none'", "rate is not valid"),
        ("epochs = 'none'", "epochs is not valid"),
        ("snr_db = 'None'", "snr_db is not valid"),
        (f"{WHITE}precision = 'mixed'", r"settings\.toml: normalisation .*: use precision 'full'"),
        (f"{WHITE}averaging = 0.9", "normalisation 'white' changes its .*: use averaging 0"),
        ("recipe = 'none'", "recipe 'none' is unknown"),
        ("recipe = 3", "use a name"),
        ("change = 'twist'", "change is not valid"),
        ("seed = -1", "seed is not valid"),
        ("[fresh]\nmasks = 0", "fresh.masks is not valid"),
        ("[fresh]\nmisalignment = 3", "fresh.misalignment is not valid"),
        ("fresh = 3", "fresh is not valid"),
        ("recipe = 'best'\n[fresh]", "fresh masks have no recipe 'best'"),
        ("encoder = 'lens'\n[fresh]", "fresh masks have no encoder: leave it out"),
        ("seed = ", "not a TOML file"),
    ],
)
def test_files_that_are_refused(tmp_path: Path, text: str, reason: str) -> None:
    with pytest.raises(TrainingError, match=reason) as caught:
        load_settings(write(tmp_path, text), {})
    assert "\n" not in str(caught.value)


def test_fresh_masks_suit_data_and_embedding(tmp_path: Path) -> None:
    digits = load_settings(None, {"fresh": {}})
    assert digits.classifier == "Scene16"
    assert digits.fresh == FreshMasks()
    assert digits.epochs == SCENES["epochs"]
    small = load_settings(None, {"fresh": {}, "embedding": "6x8"}).fresh
    assert small == FreshMasks(exponent=4.0, spread=0.25)
    text = 'embedding = "6x8"\n[fresh]\nspread = "none"\nmisalignment = "none"'
    none = load_settings(write(tmp_path, text), {}).fresh
    assert none == FreshMasks(exponent=4.0, misalignment=None)
    text = "epochs = 3\n[fresh]\nplacement = 'anywhere'\nmisalignment = {shift = 0.0}"
    anywhere = load_settings(write(tmp_path, text), {"seed": 3})
    assert (anywhere.pooling, anywhere.jitter.crop, anywhere.epochs, anywhere.seed) == (2, 2, 3, 3)
    assert anywhere.fresh is not None
    assert anywhere.fresh.misalignment == Misalignment(shift=0.0, panels=4)
