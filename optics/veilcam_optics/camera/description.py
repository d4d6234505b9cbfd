"""A camera as a TOML file: lengths in metres, and every key with its unit and plausible range."""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from veilcam_optics.camera.geometry import (
    CHANNELS,
    LENGTHS,
    WAVELENGTHS,
    Camera,
    Panel,
    Sensor,
    Window,
)
from veilcam_optics.errors import OpticsError, invalid, require

TABLES = ("panel", "window", "sensor")

MAX_BYTES = 2**16


@dataclass(frozen=True, slots=True)
class _Key:
    """Key of a camera file: its kind of value, unit and plausible range."""

    kind: type
    unit: str
    valid: str
    optional: bool = False


_LENGTH = f"{LENGTHS[0]:g} to {LENGTHS[1]:g}"
_WAVELENGTH = f"{WAVELENGTHS[0]:g} to {WAVELENGTHS[1]:g}"

KEYS: Mapping[str, _Key] = {
    "distance": _Key(float, "m", "above 0, from mask to sensor"),
    "wavelengths": _Key(list, "m", f"[R, G, B], each {_WAVELENGTH}", optional=True),
    "wavelength": _Key(float, "m", f"{_WAVELENGTH}, of a monochrome camera", optional=True),
    "panel.rows": _Key(int, "", "1 or more"),
    "panel.columns": _Key(int, "", "1 or more"),
    "panel.pitch_y": _Key(float, "m", _LENGTH),
    "panel.pitch_x": _Key(float, "m", _LENGTH),
    "panel.aperture_y": _Key(float, "m", f"{_LENGTH}, at most the pitch", optional=True),
    "panel.aperture_x": _Key(float, "m", f"{_LENGTH}, at most the pitch", optional=True),
    "panel.fill_factor": _Key(float, "", "above 0, at most 1, instead of apertures", optional=True),
    "panel.levels": _Key(int, "", "2 or more"),
    "panel.filter_cycle": _Key(list, "", "0 (R), 1 and 2 (B) of row 0, 1, ...; [] without filters"),
    "panel.filter_leakage": _Key(float, "", "0 to 1", optional=True),
    "panel.filter_amplitudes": _Key(list, "", "3 x 3 numbers from 0 to 1", optional=True),
    "window.rows": _Key(int, "", "1 to the panel's rows"),
    "window.columns": _Key(int, "", "1 to the panel's columns"),
    "window.first_row": _Key(int, "", "0 or more; centred by default", optional=True),
    "window.first_column": _Key(int, "", "0 or more; centred by default", optional=True),
    "sensor.rows": _Key(int, "", "1 or more"),
    "sensor.columns": _Key(int, "", "1 or more"),
    "sensor.pixel": _Key(float, "m", _LENGTH),
    "sensor.bit_depth": _Key(int, "", "1 or more", optional=True),
    "sensor.channel_weights": _Key(list, "", "three shares that sum to 1", optional=True),
}
"""By name, the table before the point."""


def read_camera(path: Path) -> Camera:
    """Read the camera that a file describes.

    Raises:
        OpticsError: a file that cannot be read or is no TOML; a key that is missing, unknown or of
            another kind; a value that no camera can have. The message names file and key.
    """
    try:
        with path.open("rb") as file:
            content = file.read(MAX_BYTES + 1)
        if len(content) > MAX_BYTES:
            raise OpticsError(f"more than {MAX_BYTES} bytes: is this a camera?")
        return parse_camera(content.decode())
    except (OSError, UnicodeDecodeError) as error:
        raise OpticsError(f"{path} cannot be read: {error}") from None
    except OpticsError as error:
        raise OpticsError(f"{path}: {error}") from None


def parse_camera(text: str) -> Camera:
    """Read the camera that a TOML text describes; errors as for :func:`read_camera`."""
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise OpticsError(f"no TOML: {error}") from None
    values = _checked(content)
    panel = _panel(_table(values, "panel"))
    window, sensor = _table(values, "window"), _table(values, "sensor")
    for name, count in (("row", panel.rows), ("column", panel.columns)):
        window.setdefault(f"first_{name}", max(0, (count - window[f"{name}s"]) // 2))
    parts = panel, Window(**window), Sensor(**sensor), values["distance"]
    several = values.get("wavelengths")
    require(
        (several is None) == ("wavelength" in values),
        "wavelengths",
        several,
        "m",
        "either wavelengths or wavelength",
    )
    if several is not None:
        require(
            len(several) == len(CHANNELS), "wavelengths", several, "m", KEYS["wavelengths"].valid
        )
        return Camera(*parts, wavelengths=several)
    for name in ("panel.filter_cycle", "sensor.channel_weights"):
        there = values.get(name)
        require(not there, name, there, "", "none beside wavelength: colours want wavelengths")
    return Camera(*parts).monochrome(values["wavelength"])


def _panel(values: dict[str, Any]) -> Panel:
    """Make a panel of its apertures or of its fill factor."""
    share = values.pop("fill_factor", None)
    for axis in ("y", "x"):
        name = f"aperture_{axis}"
        require(
            (name in values) == (share is None),
            f"panel.{name}",
            values.get(name, "nothing"),
            "m",
            "both apertures, or panel.fill_factor alone",
        )
        values.setdefault(name, values[f"pitch_{axis}"])
    panel = Panel(**values)
    return panel if share is None else panel.with_fill_factor(share)


def describe_camera(camera: Camera) -> str:
    """Write a camera as TOML, with the unit and the plausible range of every key."""
    lines = [_line("distance", camera.distance), _line("wavelengths", camera.wavelengths)]
    for name in TABLES:
        part = getattr(camera, name)
        lines += ["", f"[{name}]"]
        lines += [_line(f"{name}.{key.name}", getattr(part, key.name)) for key in fields(part)]
    return "\n".join(lines) + "\n"


def _line(name: str, value: object) -> str:
    key = KEYS[name]
    shown = _listed(value)
    unit = f"[{key.unit}] " if key.unit else ""
    return f"{name.rpartition('.')[2]} = {shown}  # {unit}{key.valid}"


def _listed(value: object) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(map(_listed, value)) + "]"
    return repr(value)


def _checked(content: Mapping[str, Any]) -> dict[str, Any]:
    """Values by their whole names; every one there that has to be, of its kind, none else."""
    values: dict[str, Any] = {}
    for name, value in content.items():
        if name in TABLES and isinstance(value, dict):
            values |= {f"{name}.{key}": inner for key, inner in value.items()}
        else:
            values[name] = value
    for name, value in values.items():
        if name not in KEYS:
            raise OpticsError(f"{name} is no key of a camera: use {', '.join(KEYS)}")
        values[name] = _of_kind(name, value)
    for name, key in KEYS.items():
        if name not in values and not key.optional:
            raise invalid(name, "nothing", key.unit, _wanted(key))
    return values


def _of_kind(name: str, value: object) -> object:
    key = KEYS[name]
    if key.kind is float and type(value) is int:
        return float(value)
    if type(value) is not key.kind:
        raise invalid(name, repr(value), key.unit, _wanted(key))
    return _numbers(name, value) if isinstance(value, list) else value


def _numbers(name: str, values: list[Any]) -> tuple[object, ...]:
    """Return a list of numbers, or of lists of numbers, as tuples."""
    rows = values if name == "panel.filter_amplitudes" else [values]
    for row in rows:
        if type(row) is not list or any(type(value) not in {int, float} for value in row):
            raise invalid(name, values, KEYS[name].unit, _wanted(KEYS[name]))
    return tuple(map(tuple, rows)) if rows is values else tuple(values)


def _wanted(key: _Key) -> str:
    kind = {int: "an integer", float: "a number", list: "a list"}[key.kind]
    return f"{kind}{f' [{key.unit}]' if key.unit else ''}: {key.valid}"


def _table(values: Mapping[str, Any], table: str) -> dict[str, Any]:
    start = f"{table}."
    return {name.removeprefix(start): v for name, v in values.items() if name.startswith(start)}
