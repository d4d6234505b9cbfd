"""Profiles: cameras by name, each with all that belongs to it, in a file of the user."""

from __future__ import annotations

import fcntl
import json
import os
import re
import tempfile
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from veilcam_client.arguments import of_type
from veilcam_client.errors import ArgumentError, FileError
from veilcam_client.http.credentials import read_secret
from veilcam_client.http.options import DEFAULT_URL
from veilcam_client.keys.opening import KeySource

if TYPE_CHECKING:
    from veilcam_client.keys.receivers import ReceiverKey

_NAME = r"[A-Za-z0-9_-]{1,64}"
_DIGEST = r"^[0-9a-f]{64}$"


@dataclass(frozen=True, slots=True)
class Profile:
    """One camera with all that belongs to it, which reaches no other camera.

    Attributes:
        url: URL of the camera, as ``Camera`` takes it.
        token: token for it.
        ca_file: PEM file of the authority that vouches for it.
        certificate: SHA-256 of the one certificate that it must show, 64 hexadecimal digits.
        key: private key of a receiver, or its file.
        device: public key of the camera, 64 hexadecimal digits.
    """

    url: str = field(repr=False)
    token: str | None = field(default=None, repr=False)
    ca_file: str | os.PathLike[str] | None = None
    certificate: str | None = None
    key: KeySource | None = None
    device: str | None = None


class _Entry(BaseModel):
    """A profile in the file; paths are relative to the folder of the file."""

    model_config: ClassVar[ConfigDict] = ConfigDict(extra="forbid")

    url: str = Field(repr=False)
    token_file: Path | None = None
    """File that holds the token: the token itself does not stand in a profile."""
    ca_file: Path | None = None
    certificate: str | None = Field(default=None, pattern=_DIGEST)
    key: Path | None = None
    device: str | None = Field(default=None, pattern=_DIGEST)


class _File(BaseModel):
    """Contents of the file of profiles."""

    model_config: ClassVar[ConfigDict] = ConfigDict(extra="forbid")

    default: str | None = None
    """Name of the profile that counts where nothing else names a camera."""
    profiles: dict[str, _Entry] = {}


def profiles_path() -> Path:
    """``veilcam/config.toml`` in the user's folder for settings (XDG)."""
    base = os.environ.get("XDG_CONFIG_HOME") or os.path.expanduser("~/.config")
    return Path(base) / "veilcam" / "config.toml"


def profile_of(
    url: str | None = None,
    profile: str | Profile | None = None,
    *,
    local: str = DEFAULT_URL,
    **explicit: Any,
) -> Profile:
    """Return the camera that these arguments mean.

    It is that of ``url``; else of ``profile`` or ``VEILCAM_PROFILE``; else of ``VEILCAM_URL``; else
    of the default profile; else that at ``local``. ``VEILCAM_TOKEN``, ``VEILCAM_TOKEN_FILE`` and
    ``VEILCAM_CA_FILE`` are mixed into no profile, but the token into a default one at ``local``:
    there it would go without a profile, too.

    Args:
        url: URL of the camera.
        profile: name of a profile, or the profile itself.
        local: URL where nothing names a camera.
        explicit: attributes of :class:`Profile` that go before those found; None: as found.

    Raises:
        ArgumentError: arguments that do not fit, or a file that cannot be used.
    """
    found = _found(url, profile, local)
    return replace(found, **{name: given for name, given in explicit.items() if given is not None})


def _found(url: str | None, profile: str | Profile | None, local: str) -> Profile:
    if profile is not None:
        of_type("profile", profile, (str, Profile), "the name of a profile")
        if url is not None:
            raise ArgumentError("a url and a profile name two cameras: give one of them")
    if isinstance(profile, Profile):
        return profile
    variables = os.environ.get
    name = profile or (None if url is not None else variables("VEILCAM_PROFILE"))
    if name:
        return _named(name, profiles_path())
    file = variables("VEILCAM_TOKEN_FILE")
    token = read_secret(Path(file)) if file else variables("VEILCAM_TOKEN") or None
    if url is None:
        url = variables("VEILCAM_URL") or None
    if url is None and (default := _default()) is not None:
        return replace(default, token=token) if token and default.url == local else default
    return Profile(local if url is None else url, token, variables("VEILCAM_CA_FILE") or None)


def _named(name: str, path: Path) -> Profile:
    profiles = _read(path)[1].profiles
    if name not in profiles:
        known = ", ".join(profiles) or "none"
        raise ArgumentError(f"{path} has no profile {name!r}: it has {known}")
    one = profiles[name]
    token, authority, key = (
        each and path.parent / each for each in (one.token_file, one.ca_file, one.key)
    )
    secret = None if token is None else read_secret(token, private=True)
    return Profile(one.url, secret, authority, one.certificate, key, one.device)


def _default() -> Profile | None:
    """Return the default profile; None where there is none, or no file that this user may read."""
    path = profiles_path()
    if not path.is_absolute() or not os.access(path, os.R_OK):
        return None
    name = _read(path)[1].default
    return None if name is None else _named(name, path)


def _read(path: Path) -> tuple[str, _File]:
    """Return the text of the file, and the profiles in it."""
    try:
        with path.open(encoding="utf-8-sig") as stream:  # some editors put a mark in front
            if os.fstat(stream.fileno()).st_mode & 0o022:
                raise ArgumentError(f"{path} can be changed by others: run chmod 600 {path}")
            text = stream.read()
        return text, _File.model_validate(tomllib.loads(text))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise ArgumentError(f"{path} cannot be read: {reason}") from None
    except ValidationError as error:
        item = error.errors(include_input=False, include_url=False)[0]
        where = ".".join(map(str, item["loc"]))
        hint = ": put it into a file, and name that as token_file" if where[-6:] == ".token" else ""
        raise ArgumentError(f"{path}: {where}: {item['msg']}{hint}") from None


@contextmanager
def new_profile(
    wanted: str, key: ReceiverKey, *, exact: bool
) -> Iterator[tuple[str, Callable[[Profile], bool]]]:
    """Make a profile beside those that are there; where the body fails, nothing is left of it.

    All files are the user's alone. The key's is on the disk before the body begins.

    Args:
        wanted: name of the profile.
        key: private key of the receiver.
        exact: False: a name that is taken gets ``-2``, ``-3``, ... behind it.

    Yields:
        Name of the profile, and what saves it. That returns whether it is the default, which it
        becomes where there is none, or where that is of the same camera.

    Raises:
        ArgumentError: a name that cannot be, or is taken; or the file cannot be used.
        FileError: a file cannot be written.
    """
    path = profiles_path()
    folder = path.parent
    if re.fullmatch(_NAME, wanted) is None:
        raise ArgumentError(f"{wanted!r} is no name of a profile: use letters, digits, _ and -")
    try:
        with _alone(folder), ExitStack() as undo:
            known = _read(path)[1].profiles if path.exists() else {}
            if exact and wanted in known:
                raise ArgumentError(f"{path} has a profile {wanted!r} already: give another name")
            name, number = wanted, 1
            while not exact and (name in known or (folder / f"{name}.key").exists()):
                name = f"{wanted}-{(number := number + 1)}"
            key_file, token_file = folder / f"{name}.key", folder / f"{name}.token"

            def save(made: Profile) -> bool:
                rows = {"url": made.url, "certificate": made.certificate, "device": made.device}
                rows |= {"key": key_file.name, "token_file": made.token and token_file.name}
                if made.token:
                    undo.callback(token_file.unlink, missing_ok=True)
                    _write(token_file, f"{made.token}\n")
                text, first = _added(path, name, {of: value for of, value in rows.items() if value})
                _write(path.resolve(), text)  # a link stays one
                return first

            _added(path, name, None)  # a line is used once: what cannot be saved is not claimed
            key.write(key_file)
            undo.callback(key_file.unlink)
            yield name, save
            undo.pop_all()
    except OSError as error:
        raise FileError(f"{folder} cannot be written ({error.strerror}): check it") from None


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Make a folder of this user alone, and keep other pairings out of it meanwhile."""
    folder.parent.mkdir(0o700, parents=True, exist_ok=True)
    folder.mkdir(exist_ok=True)
    folder.chmod(0o700)
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # not every file system has locks
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    except BaseException:
        with suppress(OSError):  # others' files are in it
            folder.rmdir()
        raise
    finally:
        os.close(descriptor)


def _added(path: Path, name: str, rows: Mapping[str, str] | None) -> tuple[str, bool]:
    """Return the file's text with one profile more, and whether that is the default.

    Args:
        path: path of the file.
        name: name of the profile.
        rows: rows of the profile; None: a trial, as the default.
    """
    text, kept = _read(path) if path.exists() else ("", _File())
    before = kept.profiles.get(kept.default or "")
    rows, first = rows or {}, rows is None or kept.default is None
    first = first or (before is not None and before.device == rows.get("device"))
    if first:
        rest = re.sub(r"(?m)^default\b.*\n?", "", text, count=1) if kept.default else text
        text = f'default = "{name}"\n{rest}'
    made = [f"{of} = {json.dumps(value, ensure_ascii=False)}" for of, value in rows.items()]
    text = "\n".join([text.rstrip("\n"), "", f"[profiles.{name}]", *made, ""]).lstrip("\n")
    try:
        tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise FileError(f"{path} is written in a way that no profile can be added to") from None
    return text, first


def _write(path: Path, text: str) -> None:
    """Write a file of the user alone, which holds all of the text or what it held before."""
    descriptor, name = tempfile.mkstemp(dir=path.parent)
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        Path(name).replace(path)
    except OSError:
        Path(name).unlink()
        raise
