"""Settings of fits, from TOML files: typed, and every unknown key is refused.

data = "mnist"
classifier = "FC800"

[recipe]
base = "default"        # by name; what follows takes the place of its values
epochs = 30
snr_db = "none"         # TOML has no null

[recipe.panel_errors]
shift = 5e-5

A fit for fresh masks has its own settings, beside the name of a ``task``, and the same recipe.
"""

import hashlib
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import torch
from pydantic import BaseModel, Field, ValidationError

from veilcam_optics.camera.geometry import Embedding
from veilcam_optics.errors import OpticsError
from veilcam_training.config.recipes import (
    OWN_CLASSIFIER,
    TASKS,
    Recipe,
    Situation,
    find_recipe,
    scenes,
)
from veilcam_training.data import Source
from veilcam_training.encoders.fresh import Misalignment
from veilcam_training.encoders.psf import PsfFile
from veilcam_training.errors import TrainingError, require

Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=1, le=2**20)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]


def parse_embedding(text: str) -> Embedding:
    """Embedding from rows, columns and fill, as :meth:`.Embedding.parse` reads it.

    Raises:
        TrainingError: not of that form, or out of range.
    """
    try:
        return Embedding.parse(text)
    except OpticsError as error:
        valid = str(error).partition(": ")[2]
        raise TrainingError(f"embedding {text!r} is not valid: {valid}") from None


class Settings(BaseModel, frozen=True, extra="forbid", strict=True):
    """All that the result of a fit depends on, besides the files of the data set."""

    data: str = "mnist"
    encoder: str = "learned"
    psf: Path | None = None
    """File of a measured point spread function; the encoder ``fixed_measured`` needs it."""
    psf_pitch: Positive | None = None
    """Side of its cells, where the file does not say it [m]."""
    psf_distance: Positive | None = None
    """From the coding element to the sensor, where the file does not say it [m]."""
    embedding: str = "24x32"
    binning: Literal["area", "point"] = "area"
    """Averaged over each embedding pixel, or at its centre as in the paper's code."""
    change: Literal["none", "shift", "rescale", "rotate", "perspective"] = "none"
    """How images are shown to the camera, in training and in testing."""
    classifier: str = "LR"
    seed: Seed = 0
    recipe: Recipe = Recipe()

    def fingerprint(self, source: Source) -> str:
        """SHA-256 of the settings and of the data: two fits are the same if these are."""
        files = sorted(source.digests().items())
        if self.psf is not None:
            files.append(("psf", hashlib.sha256(self.psf.read_bytes()).hexdigest()))
        # What is in the file counts, not where it lies.
        return _digest(self.model_copy(update={"psf": None}).model_dump_json(), files)

    @property
    def psf_file(self) -> PsfFile | None:
        """The measured point spread function.

        Raises:
            TrainingError: a pitch or a distance of none.
        """
        if self.psf is None:
            require(
                self.psf_pitch is None and self.psf_distance is None,
                "there is no measured PSF: leave out --psf-pitch and --psf-distance",
            )
            return None
        return PsfFile(self.psf, self.psf_pitch, self.psf_distance)


class FreshSettings(BaseModel, frozen=True, extra="forbid", strict=True):
    """Settings of a fit of one classifier to many masks, each used for a moment only."""

    data: str = "mnist"
    embedding: str = "24x32"
    placement: Literal["centred", "anywhere"] = "centred"
    """``anywhere``: the object lies anywhere fully in the field of view."""
    exponent: Positive = 1.0
    """Masks are ``u ** exponent`` for uniform ``u``, rounded to the panel's levels."""
    spread: Annotated[float, Field(gt=0, le=1)] | None = None
    """Learn a range of ``u`` for each sub-pixel, this much to both sides of a centre."""
    misalignment: Misalignment | None = Misalignment()
    model_error: NotNegative = 0.0
    """Relative error of the response that the decoder expects."""
    classifier: str = "Scene32"
    masks: Count = 100
    """Masks that each view of the training images is measured behind."""
    validation_masks: Count = 20
    seed: Seed = 0
    recipe: Recipe = Recipe()

    def fingerprint(self, source: Source) -> str:
        """SHA-256 of the settings and of the data: two fits are the same if these are."""
        return _digest(self.model_dump_json(), sorted(source.digests().items()))


def _digest(chosen: str, files: list[tuple[str, str]]) -> str:
    text = f"{chosen} {files} torch {torch.__version__}"
    return hashlib.sha256(text.encode()).hexdigest()


def load_settings(
    path: Path | None,
    overrides: Mapping[str, Any],
    *,
    found: str | None = None,
    colour: bool = False,
) -> Settings:
    """Read the settings of ``path``, with ``overrides`` in the place of what it says.

    Args:
        path: TOML file; None for the defaults alone.
        overrides: values by the names of :class:`Settings`; those of the recipe under ``recipe``,
            as in the file.
        found: somebody's own pictures, by that name of a data set: used where nothing names one,
            with a classifier that suits few pictures.
        colour: True where the data set has colour.

    Raises:
        TrainingError: a file that is missing or no TOML, an unknown key, or a bad value.
    """
    content = _read(path)
    if found is not None and "data" not in content:
        content = {"data": found, "classifier": OWN_CLASSIFIER} | content
    table = content.pop("recipe", {})
    if not isinstance(table, str | dict):
        raise TrainingError("recipe is not valid: use a name or a table")
    recipe = {"base": table} if isinstance(table, str) else _with_nulls(Recipe, table)
    recipe |= overrides.get("recipe", {})
    content |= {key: value for key, value in overrides.items() if key != "recipe"}
    if isinstance(content.get("psf"), str):
        content["psf"] = Path(content["psf"])
    with _refused("settings" if path is None else str(path)):
        # Names first: which recipe a name stands for depends on them.
        settings = Settings.model_validate(content)
        situation = Situation(
            settings.data,
            settings.encoder,
            settings.embedding,
            settings.classifier,
            settings.change,
            colour,
        )
        base = find_recipe(str(recipe.pop("base", "default")), situation)
        merged = _merge(base.model_dump(), recipe)
        return settings.model_copy(update={"recipe": Recipe.model_validate(merged)})


def load_fresh_settings(
    path: Path | None,
    overrides: Mapping[str, Any],
    *,
    found: str | None = None,
    colour: bool = False,
) -> FreshSettings:
    """Read the settings of ``path``, with ``overrides`` in their place, over those of the task.

    Args:
        path: TOML file; None for a task alone.
        overrides: values by the names of :class:`FreshSettings`, and ``task``.
        found: data set that the folder was seen to hold; used where nothing names one or a task.
        colour: True where the data set has colour.

    Raises:
        TrainingError: a file that is missing or no TOML, an unknown task or key, or a bad value.
    """
    content = _merge(_with_nulls(FreshSettings, _read(path)), overrides)
    if found is not None and "task" not in content:
        content = {"data": found} | content
    task = str(content.pop("task", "mnist_24x32"))
    require(task in TASKS, f"task {task!r} is unknown: use one of {', '.join(TASKS)}")
    merged = _merge(TASKS[task], content)
    table = merged.pop("recipe", {})
    require(isinstance(table, dict), "recipe is not valid: use a table")
    base = scenes(str(merged.get("data", "mnist")), colour=colour)
    with _refused(f"task {task}" if path is None else str(path)):
        recipe = Recipe.model_validate(_merge(base.model_dump(), _with_nulls(Recipe, table)))
        return FreshSettings.model_validate(merged | {"recipe": recipe})


@contextmanager
def _refused(where: str) -> Iterator[None]:
    """Say in one line which of the settings from ``where`` is not valid, and why."""
    try:
        yield
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
        reason = first["msg"].removeprefix("Value error, ")
        # Several settings that do not fit together have no place, and the reason names them.
        name = ".".join(str(step) for step in first["loc"])
        said = f"{name} is not valid: {reason}" if name else reason
        raise TrainingError(f"{where}: {said}") from None


def _read(path: Path | None) -> dict[str, Any]:
    if path is None:
        return {}
    try:
        return tomllib.loads(path.read_text())
    except FileNotFoundError:
        raise TrainingError(f"{path} is missing: give a TOML file as --config") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise TrainingError(f"{path} is not a TOML file ({error}): mend it") from None


def _with_nulls(model: type[BaseModel], table: Mapping[str, Any]) -> dict[str, Any]:
    """``table`` with None where it says "none" and ``model`` may have it."""
    optional = {
        name
        for name, field in model.model_fields.items()
        if type(None) in get_args(field.annotation)
    }
    return {
        name: None if name in optional and value == "none" else value
        for name, value in table.items()
    }


def _merge(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``base`` with ``changes`` in it, table by table."""
    merged = dict(base)
    for key, value in changes.items():
        inner = merged.get(key)
        merged[key] = (
            _merge(inner, value) if isinstance(inner, dict) and isinstance(value, dict) else value
        )
    return merged
