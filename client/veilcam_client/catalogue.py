"""Catalogues of bundles: a folder, or one on the web, from which an operator pulls them by name.

``catalogue.json`` lists bundles with their SHA-256, each signed with its owner's key over name,
version and digest (Ed25519, RFC 8032). Nothing is believed of a catalogue but what its owner
signed. A camera pulls nothing: an operator does, and installs what was checked.
"""

from __future__ import annotations

import base64
import hashlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from veilcam_client.arguments import of_type
from veilcam_client.errors import CatalogueError
from veilcam_client.http.places import open_place

CATALOGUE = "catalogue.json"
MOST_LISTED = 2**20
"""Of a catalogue [bytes]."""
MOST_BYTES = 2**30
"""Of a bundle [bytes]."""
OWNER_PREFIX = "veilcam-owner:"

PlainName = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,127}$")]
"""Of a file in the folder itself, and nowhere else."""


class CatalogueEntry(BaseModel):
    """One bundle of a catalogue."""

    model_config: ClassVar[ConfigDict] = ConfigDict(frozen=True, strict=True, extra="ignore")
    name: PlainName
    file: PlainName
    size: int = Field(ge=1, le=MOST_BYTES)
    """[bytes]"""
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    version: int = Field(ge=1)
    signature: str
    """64 bytes as base64, over :func:`signed_text`."""


class Catalogue(BaseModel):
    """The content of ``catalogue.json``."""

    model_config: ClassVar[ConfigDict] = ConfigDict(frozen=True, strict=True, extra="ignore")
    format: Literal["veilcam-catalogue"] = "veilcam-catalogue"
    version: Literal[1] = 1
    bundles: tuple[CatalogueEntry, ...] = Field(strict=False)


def signed_text(name: str, version: int, sha256: str) -> bytes:
    """What an owner signs of a bundle in a catalogue."""
    return f"veilcam bundle, published by its owner, 1\n{name}\n{version}\n{sha256}\n".encode()


def pull_bundle(place: str, name: str, owner: str, out: Path) -> CatalogueEntry:
    """Copy a bundle out of a catalogue, if it is what its owner signed.

    Args:
        place: a folder, or the http or https address of one.
        name: of the bundle in the catalogue.
        owner: the line ``veilcam-owner:...`` of who has to have signed it.
        out: file to write, readable by its owner alone; it is new, or whole as it was before.

    Returns:
        What the catalogue says of it.

    Raises:
        CatalogueError: there is no such catalogue or bundle, it is not what the owner signed, or a
            file cannot be read or written.
    """
    for argument, value in (("place", place), ("name", name), ("owner", owner)):
        of_type(argument, value, str, "text")
    of_type("out", out, Path, "a pathlib.Path")
    with open_place(place) as read:
        try:
            found = Catalogue.model_validate_json(b"".join(read(CATALOGUE, MOST_LISTED)))
        except ValidationError:
            raise CatalogueError(
                f"{read.name} holds no catalogue of bundles: check --from"
            ) from None
        entries = [entry for entry in found.bundles if entry.name == name]
        if len(entries) != 1:
            named = ", ".join(sorted(entry.name for entry in found.bundles)) or "none"
            raise CatalogueError(f"{read.name} lists {name!r} {len(entries)} times: it has {named}")
        entry = entries[0]
        _check_signature(entry, owner)
        _write_checked(out, entry, read(entry.file, entry.size))
    return entry


def _check_signature(entry: CatalogueEntry, owner: str) -> None:
    from cryptography.exceptions import InvalidSignature  # noqa: PLC0415 - late: it loads long
    from cryptography.hazmat.primitives.asymmetric.ed25519 import (  # noqa: PLC0415
        Ed25519PublicKey,
    )

    try:
        if not owner.startswith(OWNER_PREFIX):
            raise ValueError("another line")
        raw = base64.b64decode(owner.removeprefix(OWNER_PREFIX), validate=True)
        key = Ed25519PublicKey.from_public_bytes(raw)
    except ValueError:
        raise CatalogueError(
            f"--owner is no owner's key: give the line {OWNER_PREFIX}... that 'veilcam-train "
            "bundle keygen' printed"
        ) from None
    try:
        signature = base64.b64decode(entry.signature, validate=True)
        key.verify(signature, signed_text(entry.name, entry.version, entry.sha256))
    except (ValueError, InvalidSignature):
        raise CatalogueError(
            f"{entry.name} is not signed by this owner, or was changed after that: do not use it"
        ) from None


def _write_checked(out: Path, entry: CatalogueEntry, pieces: Iterator[bytes]) -> None:
    """Write a file under its name once its digest is known to be right."""
    digest = hashlib.sha256()
    beside: Path | None = None
    try:
        # Made for its owner's eyes alone.
        descriptor, name = tempfile.mkstemp(dir=out.parent, prefix=f".{out.name}-")
        beside = Path(name)
        with os.fdopen(descriptor, "wb") as stream:
            for piece in pieces:
                digest.update(piece)
                stream.write(piece)
            stream.flush()
            os.fsync(stream.fileno())
        if digest.hexdigest() != entry.sha256:
            raise CatalogueError(f"{entry.file} is not what was signed: pull it again")
        beside.replace(out)
    except OSError as error:
        raise CatalogueError(f"{out} cannot be written ({error.strerror})") from None
    finally:
        if beside is not None:
            beside.unlink(missing_ok=True)
