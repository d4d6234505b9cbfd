"""Catalogues of bundles: a folder that operators pull from, every bundle signed by its owner.

``catalogue.json`` beside the bundles; 'veilcam bundle pull' reads it and believes the signatures.
"""

from __future__ import annotations

import base64
import hashlib
from pathlib import Path
from typing import Annotated, Literal

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from veilcam_optics.files import write_whole
from veilcam_training.bundle.archive import read_bundle
from veilcam_training.bundle.errors import BundleError, require
from veilcam_training.bundle.signature import OwnerKey

CATALOGUE = "catalogue.json"
SUFFIX = ".veilcam"
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]{0,119}$")]


class Entry(BaseModel):
    """One bundle."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)
    name: Name
    file: str
    size: int
    """[bytes]"""
    sha256: str
    version: int
    signature: str
    """64 bytes as base64."""


class Catalogue(BaseModel):
    """The content of ``catalogue.json``."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)
    format: Literal["veilcam-catalogue"] = "veilcam-catalogue"
    version: Literal[1] = 1
    bundles: tuple[Entry, ...] = ()


def publish_bundle(path: Path, folder: Path, key: Ed25519PrivateKey) -> Entry:
    """Copy a bundle into a catalogue, in the place of an older one of its name.

    Args:
        path: of a bundle that its owner has signed; its name there is that of the file.
        folder: of the catalogue; made if it is not there.
        key: of the owner, who signs name, version and digest too.

    Raises:
        BundleError: the bundle or the catalogue cannot be read, the bundle is not signed with this
            key or not newer than the one in the catalogue, or the folder cannot be written to.
    """
    bundle, owner = read_bundle(path), OwnerKey(key.public_key().public_bytes_raw())
    require(
        bundle.owner == owner,
        f"{path} is not signed with this key: use 'veilcam-train bundle sign' first",
    )
    listed = _read(folder)
    text = f"veilcam bundle, published by its owner, 1\n{path.stem}\n{bundle.version}\n"
    try:
        content = path.read_bytes()
        digest = hashlib.sha256(content).hexdigest()
        signature = base64.b64encode(key.sign(f"{text}{digest}\n".encode())).decode()
        entry = Entry(
            name=path.stem,
            file=f"{path.stem}{SUFFIX}",
            size=len(content),
            sha256=digest,
            version=bundle.version,
            signature=signature,
        )
        for former in listed.bundles:
            require(
                former.name != entry.name or former.version < entry.version,
                f"{folder} has {entry.name} in version {former.version}: sign a higher one",
            )
        others = tuple(each for each in listed.bundles if each.name != entry.name)
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(folder / entry.file, content, private=True)
        renewed = Catalogue(bundles=(*others, entry))
        write_whole(folder / CATALOGUE, f"{renewed.model_dump_json(indent=1)}\n".encode())
    except ValidationError:
        raise BundleError(
            f"{path.stem!r} is no name for a catalogue: use letters, digits, '.', '_' and '-'"
        ) from None
    except OSError as error:
        raise BundleError(f"{folder} cannot be written to ({error.strerror})") from None
    return entry


def _read(folder: Path) -> Catalogue:
    try:
        return Catalogue.model_validate_json((folder / CATALOGUE).read_bytes())
    except FileNotFoundError:
        return Catalogue()
    except (OSError, ValidationError):
        raise BundleError(f"{folder / CATALOGUE} is no catalogue: move it away") from None
