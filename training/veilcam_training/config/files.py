"""Settings from TOML files: typed, and every unknown key is refused.

data = "mnist"
classifier = "FC800"
recipe = "default"      # by name; what follows takes the place of its values
epochs = 30
snr_db = "none"         # TOML has no null

[panel_errors]
shift = 5e-5

[fresh]                 # a table, also an empty one, asks for masks that are drawn anew
exponent = 4.0
"""

import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from veilcam_training.config.recipes import find_recipe
from veilcam_training.config.settings import FitSettings, FreshMasks
from veilcam_training.errors import TrainingError, require


def load_settings(
    path: Path | None,
    overrides: Mapping[str, Any],
    *,
    found: str | None = None,
    colour: bool = False,
) -> FitSettings:
    """Read the settings of ``path``, with ``overrides`` in the place of what it says.

    Args:
        path: TOML file; None for the defaults alone.
        overrides: values by the names of :class:`FitSettings`, and the name of a ``recipe``.
        found: somebody's own pictures, by that name of a data set: used where nothing names one.
        colour: True where the data set has colour.

    Raises:
        TrainingError: a file that is missing or no TOML, an unknown key, or a bad value.
    """
    content = _merge(_read(path), overrides)
    recipe = content.pop("recipe", "default")
    require(isinstance(recipe, str), "recipe is not valid: use a name")
    if found is not None:
        content.setdefault("data", found)
    if found is not None or "fresh" in content:
        digits = content.get("data", "mnist") in ("mnist", "fashion")
        content.setdefault("classifier", "Scene16" if digits else "Scene32")
    content = _with_nulls(FitSettings, content)
    if isinstance(content.get("fresh"), dict):
        content["fresh"] = _with_nulls(FreshMasks, content["fresh"])
    if isinstance(content.get("psf"), str):
        content["psf"] = Path(content["psf"])
    with _refused("settings" if path is None else str(path)):
        # Names first: which values a recipe stands for depends on them.
        base = find_recipe(recipe, FitSettings.model_validate(content), colour=colour)
        # A seed that nobody gave is not set: one is drawn.
        return FitSettings.model_validate(_merge(base.model_dump(exclude={"seed"}), content))


@contextmanager
def _refused(where: str) -> Iterator[None]:
    """Say in one line which of the settings from ``where`` is not valid, and why."""
    try:
        yield
    except ValidationError as error:
        found: dict[str, list[str]] = {}
        for each in error.errors(include_url=False, include_context=False):
            # A step that is no name tells which of several types was tried.
            name = ".".join(step for step in map(str, each["loc"]) if step.isidentifier())
            found.setdefault(name, []).append(each["msg"].removeprefix("Value error, "))
        # Several settings that do not fit together have no place, and the reason names them.
        name, reasons = next(iter(found.items()))
        reason = " or ".join(reasons)
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
