"""Names of the environment, and the state directory that it names."""

from __future__ import annotations

import difflib
import os
from collections.abc import Iterable, Set
from pathlib import Path

PREFIX = "VEILCAM_"
"""Of every setting in the environment."""
STATE_DIRECTORY = f"{PREFIX}STATE_DIRECTORY"
"""Says what systemd's ``STATE_DIRECTORY`` says, where systemd does not."""
_OTHERS = frozenset(
    (
        # Of the client.
        *(f"{PREFIX}URL", f"{PREFIX}TOKEN", f"{PREFIX}CA_FILE", f"{PREFIX}LOG"),
        *(f"{PREFIX}TOKEN_FILE", f"{PREFIX}PROFILE"),
        f"{PREFIX}TEST_THREADS",  # of the tests
        STATE_DIRECTORY,
    )
)
"""Names in the environment that are no settings of a daemon, and may stand beside them."""
_OF_THE_HOUSE = f"{PREFIX}MQTT_"
"""Begins the names of ``veilcam-mqtt``, which may too."""


def default_state_dir() -> Path:
    """Return the directory of the environment, systemd (``StateDirectory=``) or the user (XDG)."""
    given = os.environ.get(STATE_DIRECTORY) or os.environ.get("STATE_DIRECTORY")
    if given:
        return Path(given)
    base = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(base) / "veilcam"


def unknown_names(settings: Iterable[str]) -> dict[str, str]:
    """Return every unknown ``VEILCAM_...`` in the environment, with a remedy.

    Values are left out: they may be secret.

    Args:
        settings: names of the settings of a daemon.
    """
    known = _OTHERS | {f"{PREFIX}{name.upper()}" for name in settings}
    # As pydantic-settings reads them, in capitals or not.
    given = {name: name.upper() for name in sorted(os.environ)}
    return {
        name: _remedy(upper, known)
        for name, upper in given.items()
        if upper.startswith(PREFIX) and not upper.startswith(_OF_THE_HOUSE) and upper not in known
    }


def _remedy(name: str, known: Set[str]) -> str:
    """Return the nearest known name: one that goes on where this one ends, or looks like it."""
    rests = sorted(each.removeprefix(PREFIX) for each in known)
    rest = name.removeprefix(PREFIX)
    near = [each for each in rests if rest and each.startswith(rest)]
    near = near or difflib.get_close_matches(rest, rests, n=1)
    return f"did you mean {PREFIX}{near[0]}?" if near else "leave it out"


def option_of(name: str) -> str:
    """Return the option of a setting on the command line."""
    return f"--{name.replace('_', '-')}"
