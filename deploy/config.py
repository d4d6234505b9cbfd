"""The settings of a daemon as a file to fill in: every key, what it says, and its default.

``python -m deploy.config`` writes it again from the code; a test compares them.
"""

from __future__ import annotations

import json
import textwrap
from pathlib import Path

from pydantic.fields import FieldInfo

from veilcam_server.environment import PREFIX
from veilcam_server.settings import Settings

FILE = Path(__file__).with_name("veilcam.env")
BUNDLE = "/etc/veilcam/bundle.veilcam"
"""Where a device has its masks and classifiers."""
WIDTH = 100
"""Of a line [characters]."""
_HEAD = f"""\
# Settings of veilcamd. After a change: systemctl restart veilcamd
# A line with # in front is not in force, and says the default; where none stands there, the text
# above says what holds. Made by 'python -m deploy.config' from the code.

# Masks and classifiers: made by 'veilcam-train'. The user veilcam must be able to read the file.
{PREFIX}BUNDLE={BUNDLE}
"""
_EXAMPLES = {
    "panel_tab": "green",
    "owner_keys": "/etc/veilcam/owners",
    "rotation": '{"mode": "seconds", "seconds": 30, "jitter": 10}',
    "hosts": "camera.local",
}
"""Where there is no default that could be shown, and a value says more."""


def template() -> str:
    """Return the file."""
    fields = Settings.model_fields.items()
    return "\n".join([_HEAD, *(_entry(*each) for each in fields if each[0] != "bundle")])


def _entry(name: str, field: FieldInfo) -> str:
    said = " ".join((field.description or "").split())
    lines = textwrap.wrap(said, WIDTH, initial_indent="# ", subsequent_indent="# ")
    return "\n".join([*lines, f"#{PREFIX}{name.upper()}={_value(name, field)}", ""])


def _value(name: str, field: FieldInfo) -> str:
    if name in _EXAMPLES:
        return _EXAMPLES[name]
    # The state directory is systemd's to say.
    value = None if field.default_factory is not None else field.default
    if value is None or value == ():
        return ""
    return value if isinstance(value, str) else json.dumps(value, default=str).strip('"')


if __name__ == "__main__":
    FILE.write_text(template())
