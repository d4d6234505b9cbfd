"""Profiles: cameras by name, in a file of the user, without their secrets."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import ClassVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from veilcam_client.http.credentials import read_secret

URL, TOKEN, CA_FILE = "VEILCAM_URL", "VEILCAM_TOKEN", "VEILCAM_CA_FILE"
"""What a profile stands for in the environment."""


class Profile(BaseModel):
    """One camera; paths are relative to the folder of the file."""

    model_config: ClassVar[ConfigDict] = ConfigDict(extra="forbid")

    url: str = Field(repr=False)
    token_file: Path | None = None
    """File that holds the token: the token itself does not stand in a profile."""
    ca_file: Path | None = None

    def environment(self, folder: Path) -> dict[str, str | None]:
        """Return the variables that it stands for, None for one that must not be set."""
        token = None if self.token_file is None else read_secret(folder / self.token_file)
        authority = None if self.ca_file is None else str(folder / self.ca_file)
        return {URL: self.url, TOKEN: token, CA_FILE: authority}


class _File(BaseModel):
    """Contents of the file of profiles."""

    model_config: ClassVar[ConfigDict] = ConfigDict(extra="forbid")

    profiles: dict[str, Profile] = {}


def profiles_path() -> Path:
    """``veilcam/config.toml`` in the user's folder for settings (XDG)."""
    base = os.environ.get("XDG_CONFIG_HOME") or Path.home() / ".config"
    return Path(base) / "veilcam" / "config.toml"


def variables_of(name: str) -> dict[str, str | None]:
    """Return the variables of a profile; raises ValueError for one that cannot be used.

    A profile counts as a whole: no token reaches another camera than that which it is for.
    """
    path = profiles_path()
    try:
        profiles = _File.model_validate(tomllib.loads(path.read_text("utf-8"))).profiles
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise ValueError(f"{path} cannot be read: {reason}") from None
    except ValidationError as error:
        item = error.errors(include_input=False, include_url=False)[0]
        where = ".".join(map(str, item["loc"]))
        hint = ": put it into a file, and name that as token_file" if where[-6:] == ".token" else ""
        raise ValueError(f"{path}: {where}: {item['msg']}{hint}") from None
    if name not in profiles:
        known = ", ".join(profiles) or "none"
        raise ValueError(f"{path} has no profile {name!r}: it has {known}")
    return profiles[name].environment(path.parent)


@contextmanager
def environment(variables: Mapping[str, str | None]) -> Iterator[None]:
    """Set variables of the environment, and put back in the end what was there before."""
    before = {name: os.environ.get(name) for name in variables}
    try:
        _set(variables)
        yield
    finally:
        _set(before)


def _set(variables: Mapping[str, str | None]) -> None:
    for name, value in variables.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value
