"""The reference: pages of commands, settings, errors and the bundle's format, made from the code.

``python docs/generate.py`` writes them again; a test compares them with the code.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import typer

from veilcam_server.environment import PREFIX
from veilcam_server.errors import PROBLEMS
from veilcam_server.settings import Settings
from veilcam_training.bundle.manifest import Manifest

FOLDER = Path(__file__).resolve().parent / "reference"
COMMANDS: Mapping[str, tuple[str, str]] = {
    "veilcam": ("veilcam_client.cli.main", "asks a camera, from any machine"),
    "veilcamd": ("veilcam_server.cli.main", "is the daemon on the Raspberry Pi"),
    "veilcam-optics": ("veilcam_optics.cli.main", "computes what the camera does to light"),
    "veilcam-train": ("veilcam_training.cli.main", "makes masks and classifiers, and attacks them"),
    "veilcam-mqtt": ("veilcam_mqtt.cli", "tells a house what a camera sees"),
}
"""Each command: the module with its app, and what it is for."""
GENERATED = "<!-- Made by docs/generate.py from the code: change it there. -->\n"


def commands_page() -> str:
    """Every command with its arguments and options."""
    parts = [GENERATED, "# Commands\n"]
    for name, (_, purpose) in COMMANDS.items():
        parts.append(f"## {name}\n\n`{name}` {purpose}.\n")
        commands = list(_commands(_app(name), name))
        counts = Counter(row for _, command in commands for row in _rows(command))
        # Of options of one name with two meanings, the more common one is shared.
        common = {_name(row): row for row, count in reversed(counts.most_common()) if count > 1}
        shared = [row for row in counts if row.startswith("| `-") and row in common.values()]
        if shared:
            parts.append(f"Options that several commands have:\n\n{_table(shared)}")
        for path, command in commands:
            parts += _command(command, path, shared)
    return "\n".join(parts)


def _app(name: str) -> Any:
    """A command as Typer makes it: it has click's classes under names of its own."""
    return typer.main.get_command(import_module(COMMANDS[name][0]).app)


def _commands(command: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Yield the commands below this one, or itself, each with its words."""
    below: Mapping[str, Any] = getattr(command, "commands", {})
    for name, inner in below.items():
        yield from _commands(inner, f"{path} {name}")
    if not below:
        yield path, command


def _rows(command: Any) -> list[str]:
    return [row for each in command.params if (row := _parameter(each)) is not None]


def _name(row: str) -> str:
    return row.split("|")[1].strip()


def _table(rows: Iterable[str]) -> str:
    return "| | default | what |\n|---|---|---|\n" + "\n".join(rows) + "\n"


def _command(command: Any, path: str, shared: Sequence[str]) -> Iterator[str]:
    """A command with its own options, and the names of those that it shares."""
    yield f"### {path}\n\n{_prose(command.help or '')}\n"
    rows = _rows(command)
    if own := [row for row in rows if row not in shared]:
        yield _table(own)
    if others := [_name(row) for row in rows if row in shared]:
        yield f"{'Also' if own else 'Options'}: {', '.join(others)}.\n"


def _parameter(parameter: Any) -> str | None:
    """A row for an option or an argument; None for one that is hidden."""
    if getattr(parameter, "hidden", False) or "--help" in parameter.opts:
        return None
    if parameter.param_type_name == "argument":
        shown = f"`{parameter.name.upper()}`"
    else:
        names = [*parameter.opts, *parameter.secondary_opts]
        shown = ", ".join(f"`{name}`" for name in names)
    default = "required" if parameter.required else _value(parameter.default)
    return f"| {shown} | {default} | {_cell(parameter.help or '')} |"


def settings_page() -> str:
    """Every setting of the daemon: its option, its name in the environment, its default."""
    lines = [
        GENERATED,
        "# Settings of the daemon\n",
        "Each stands on the command line of `veilcamd serve`, or in the environment, as in "
        "`/etc/veilcam/veilcam.env`. The command line goes first.\n",
        "| option | in the environment | default | what |\n|---|---|---|---|",
    ]
    serve = _app("veilcamd").commands["serve"]
    options = {parameter.name: parameter.opts[0] for parameter in serve.params}
    for name, field in Settings.model_fields.items():
        # The device and the rotation have options of other names, see there.
        option = f"`{options[name]}`" if name in options else "[others](commands.md#veilcamd-serve)"
        if field.default_factory is not None:
            default = "of systemd or of the user"  # another on each machine
        else:
            default = "required" if field.is_required() else _value(field.default)
        said = _cell(field.description or "")
        lines.append(f"| {option} | `{PREFIX}{name.upper()}` | {default} | {said} |")
    return "\n".join(lines) + "\n"


def errors_page() -> str:
    """Every problem code of the daemon."""
    lines = [
        GENERATED,
        "# Errors by code\n",
        "Problems are `application/problem+json` (RFC 9457). `code` is stable; where `retryable` "
        "is true the same request may succeed later. [What an answer says](../api.md) of a problem "
        "beside it.\n",
        "| code | status | what it means | what helps | again |\n|---|---|---|---|---|",
    ]
    for code, kind in sorted(PROBLEMS.items()):
        remedy, again = kind.remedy.replace("_", " "), "yes" if kind.retryable else "no"
        lines.append(f"| `{code}` | {kind.status} | {_cell(kind.title)} | {remedy} | {again} |")
    return "\n".join(lines) + "\n"


def bundle_page() -> str:
    """Every field of ``bundle.json``."""
    schema = Manifest.model_json_schema()
    lines = [
        GENERATED,
        "# Fields of a bundle\n",
        "A bundle is a ZIP file; what its parts are, and in which order they are checked, is on "
        "[its page](../bundle.md). These are the fields of its `bundle.json`. An unknown field is "
        "refused.\n",
        *_model("bundle.json", schema),
    ]
    for name, model in sorted(schema["$defs"].items()):
        if name != "JsonValue":
            lines += _model(name, model)
    return "\n".join(lines)


def _model(name: str, model: Mapping[str, Any]) -> Iterator[str]:
    yield f"## {name}\n"
    if said := _prose(model.get("description", "")):
        yield said + "\n"
    if "properties" not in model:
        yield f"{_type(model)}\n".capitalize()
        return
    yield "| field | type | default | what |\n|---|---|---|---|"
    required = model.get("required", ())
    for field, schema in model.get("properties", {}).items():
        default = "required" if field in required else _value(schema.get("default"))
        said = _cell(schema.get("description", ""))
        yield f"| `{field}` | {_type(schema)} | {default} | {said} |"
    yield ""


def _type(schema: Mapping[str, Any]) -> str:  # noqa: PLR0911 - a case each
    """A JSON schema in a word or two; models link to their table."""
    if "$ref" in schema:
        name = schema["$ref"].rpartition("/")[2]
        return "any JSON" if name == "JsonValue" else f"[{name}](#{name.lower()})"
    for key in ("anyOf", "oneOf"):
        if key in schema:
            return " or ".join(dict.fromkeys(_type(one) for one in schema[key]))
    if "const" in schema:
        return f"`{json.dumps(schema['const'])}`"
    if "enum" in schema:
        return " or ".join(f"`{json.dumps(value)}`" for value in schema["enum"])
    kind = str(schema.get("type", "any"))
    if kind == "array":
        inside = schema.get("prefixItems") or [schema.get("items", {})]
        return "list of " + " or ".join(dict.fromkeys(_type(one) for one in inside))
    if kind == "object" and isinstance(schema.get("additionalProperties"), dict):
        return f"object of {_type(schema['additionalProperties'])}"
    return {"null": "nothing"}.get(kind, kind)


def _value(value: Any) -> str:
    if value is None or value in ((), [], ""):
        return ""
    if isinstance(value, Path):
        return f"`{value.name if value.is_absolute() and 'demo_data' in value.parts else value}`"
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"`{value}`"


def _prose(text: str) -> str:
    """A docstring as Markdown: its paragraphs."""
    paragraphs = text.replace("``", "`").strip().split("\n\n")
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)


def _cell(text: str) -> str:
    return " ".join(_prose(text).split()).replace("|", "\\|")


PAGES: Mapping[str, Callable[[], str]] = {
    "commands.md": commands_page,
    "settings.md": settings_page,
    "errors.md": errors_page,
    "bundle.md": bundle_page,
}


def main() -> None:
    """Write every page."""
    FOLDER.mkdir(exist_ok=True)
    for name, write in PAGES.items():
        (FOLDER / name).write_text(write())


if __name__ == "__main__":
    main()
