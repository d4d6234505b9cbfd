"""Version and signature that a bundle's owner gives it: ``owner.json``, beside what training wrote.

``bundle.json`` holds the digests of all other parts, so an Ed25519 signature over its own digest
and the version holds for everything that is read.
"""

from __future__ import annotations

import base64
import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from veilcam_optics.files import create_private
from veilcam_training.bundle.errors import BundleError

MAX_VERSION = 2**31 - 1
_CONTEXT = "veilcam bundle, signed by its owner, 1"
_PREFIX = "veilcam-owner:"
_SHORT = 12


@dataclass(frozen=True, slots=True)
class OwnerKey:
    """Public key of an owner; ``str`` gives the line that names it in a file of such keys."""

    raw: bytes
    """32 bytes, as in RFC 8032."""

    def __post_init__(self) -> None:
        try:
            Ed25519PublicKey.from_public_bytes(self.raw)
        except ValueError:
            raise BundleError(f"an owner's key has {len(self.raw)} bytes: use 32") from None

    @classmethod
    def parse(cls, text: str) -> OwnerKey:
        """Read ``veilcam-owner:BASE64``; raises :class:`BundleError`."""
        try:
            if text.startswith(_PREFIX):
                return cls(base64.b64decode(text.removeprefix(_PREFIX), validate=True))
        except ValueError:
            pass
        raise BundleError(f"this is no owner's key: use {_PREFIX} and 32 bytes as base64")

    @property
    def short(self) -> str:
        """First digits of the key's SHA-256: enough for a person to tell keys apart."""
        return hashlib.sha256(self.raw).hexdigest()[:_SHORT]

    def __str__(self) -> str:
        return f"{_PREFIX}{base64.b64encode(self.raw).decode()}"


class OwnerPart(BaseModel):
    """The content of ``owner.json``."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)
    version: Annotated[int, Field(ge=1, le=MAX_VERSION)]
    owner: str | None = None
    """Public key of who signed, as :class:`OwnerKey` writes it; None: nobody did."""
    signature: str | None = None
    """64 bytes as base64."""

    @model_validator(mode="after")
    def _both_or_none(self) -> OwnerPart:
        if (self.owner is None) != (self.signature is None):
            raise ValueError("a signature and who signed go together")
        return self


def dump_owner(version: int, manifest: bytes, key: Ed25519PrivateKey | None) -> bytes:
    """``owner.json`` of a bundle with this ``bundle.json``; unsigned without a key.

    Raises:
        BundleError: a version out of range.
    """
    if not 1 <= version <= MAX_VERSION:
        raise BundleError(f"version = {version} is not valid: use 1 to {MAX_VERSION}")
    if key is None:
        return OwnerPart(version=version).model_dump_json().encode()
    signature = key.sign(_message(version, manifest))
    signed = OwnerPart(
        version=version,
        owner=str(_public(key)),
        signature=base64.b64encode(signature).decode(),
    )
    return signed.model_dump_json().encode()


def load_owner(data: bytes, manifest: bytes) -> tuple[int, OwnerKey | None]:
    """Version of a bundle, and who signed it.

    Raises:
        BundleError: ``owner.json`` is not valid, or the signature is of another bundle or version.
    """
    try:
        part = OwnerPart.model_validate_json(data)
    except ValidationError:
        raise BundleError("owner.json is not valid: sign the bundle again") from None
    if part.owner is None or part.signature is None:
        return part.version, None
    owner = OwnerKey.parse(part.owner)
    try:
        signature = base64.b64decode(part.signature, validate=True)
        Ed25519PublicKey.from_public_bytes(owner.raw).verify(
            signature, _message(part.version, manifest)
        )
    except (ValueError, InvalidSignature):
        raise BundleError("was changed after its owner signed it: sign it again") from None
    return part.version, owner


def write_key(path: Path) -> OwnerKey:
    """Make a key pair; the private half goes to a new PEM file that its owner alone may read.

    Raises:
        BundleError: there is such a file already, or it cannot be written.
    """
    key = Ed25519PrivateKey.generate()
    pem = key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    try:
        create_private(path, pem)
    except FileExistsError:
        raise BundleError(f"{path} exists and was left alone: use another name") from None
    except OSError as error:
        raise BundleError(f"{path} cannot be written ({error.strerror}): check it") from None
    return _public(key)


def read_key(path: Path) -> Ed25519PrivateKey:
    """Read the private half that :func:`write_key` wrote.

    Raises:
        BundleError: it cannot be read, others may read it, or it is no such key. No message
            repeats it.
    """
    try:
        mode, pem = path.stat().st_mode, path.read_bytes()
    except OSError as error:
        raise BundleError(f"{path} cannot be read ({error.strerror}): check the path") from None
    if mode & 0o077:
        raise BundleError(f"{path} is open to others: run chmod 600 {path}")
    try:
        key = load_pem_private_key(pem, password=None)
    except (ValueError, TypeError, UnsupportedAlgorithm):
        key = None
    if not isinstance(key, Ed25519PrivateKey):
        raise BundleError(f"{path} is no Ed25519 key: make one with 'veilcam-train bundle keygen'")
    return key


def _public(key: Ed25519PrivateKey) -> OwnerKey:
    return OwnerKey(key.public_key().public_bytes_raw())


def _message(version: int, manifest: bytes) -> bytes:
    return f"{_CONTEXT}\n{version}\n{hashlib.sha256(manifest).hexdigest()}\n".encode()
