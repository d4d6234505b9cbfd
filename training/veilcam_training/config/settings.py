"""Settings from a TOML file: typed, and every unknown key is refused.

data = "mnist"
classifier = "FC800"

[recipe]
base = "default"        # by name; what follows takes the place of its values
epochs = 30
snr_db = "none"         # TOML has no null

[recipe.panel_errors]
shift = 5e-5
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

from pydantic import ValidationError

from veilcam_training.config.recipes import Recipe, Situation, find_recipe
from veilcam_training.errors import TrainingError
from veilcam_training.experiments.fit import Settings


def load_settings(path: Path | None, overrides: Mapping[str, Any]) -> Settings:
    """Settings of ``path``, with ``overrides`` in the place of what it says.

    Args:
        path: TOML file; None for the defaults alone.
        overrides: values by the names of :class:`Settings`; those of the recipe under ``recipe``,
            as in the file.

    Raises:
        TrainingError: a file that is missing or no TOML, an unknown key, or a bad value.
    """
    content = {} if path is None else _read(path)
    recipe = {**_recipe_table(content.pop("recipe", {})), **overrides.get("recipe", {})}
    content.update({key: value for key, value in overrides.items() if key != "recipe"})
    if isinstance(content.get("psf"), str):
        content["psf"] = Path(content["psf"])
    where = "settings" if path is None else str(path)
    try:
        # Names first: which recipe a name stands for depends on them.
        settings = Settings.model_validate(content)
        situation = Situation(
            settings.data,
            settings.encoder,
            settings.embedding,
            settings.classifier,
            settings.change,
        )
        base = find_recipe(str(recipe.pop("base", "default")), situation)
        merged = _merge(base.model_dump(), recipe)
        return settings.model_copy(update={"recipe": Recipe.model_validate(merged)})
    except ValidationError as error:
        raise refusal(where, error) from None


def refusal(where: str, error: ValidationError) -> TrainingError:
    """What is said of settings from ``where`` that are not valid."""
    first = error.errors(include_url=False, include_context=False)[0]
    reason = first["msg"].removeprefix("Value error, ")
    if not first["loc"]:  # several settings do not fit together, and the reason names them
        return TrainingError(f"{where}: {reason}")
    name = ".".join(str(step) for step in first["loc"])
    return TrainingError(f"{where}: {name} is not valid: {reason}")


def _read(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text())
    except FileNotFoundError:
        raise TrainingError(f"{path} is missing: give a TOML file as --config") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise TrainingError(f"{path} is not a TOML file ({error}): mend it") from None


def _recipe_table(recipe: object) -> dict[str, Any]:
    if isinstance(recipe, str):
        return {"base": recipe}
    if not isinstance(recipe, dict):
        raise TrainingError("recipe is not valid: use a name or a table")
    optional = {
        name
        for name, field in Recipe.model_fields.items()
        if type(None) in get_args(field.annotation)
    }
    return {
        name: None if name in optional and value == "none" else value
        for name, value in recipe.items()
    }


def _merge(base: dict[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """``base`` with ``changes`` in it, table by table."""
    merged = dict(base)
    for key, value in changes.items():
        inner = merged.get(key)
        merged[key] = (
            _merge(inner, value) if isinstance(inner, dict) and isinstance(value, dict) else value
        )
    return merged
