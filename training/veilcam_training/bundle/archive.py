"""Reading and writing ``*.veilcam`` files: zip archives with the parts of a mode, and no code."""

import dataclasses
import hashlib
import io
import json
import struct
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from veilcam_optics.files import write_whole
from veilcam_training.bundle.card import CARD, PrivacyCard, dump_card, load_card, subject_of
from veilcam_training.bundle.errors import BundleError, require
from veilcam_training.bundle.manifest import (
    FreshManifest,
    Manifest,
    PairManifest,
    dump_manifest,
    load_manifest,
)
from veilcam_training.bundle.model import Bundle, check_bundle
from veilcam_training.bundle.parts import (
    MASKS,
    PARTS,
    SCENES,
    WEIGHTS,
    dump_parts,
    load_fresh,
    load_pairs,
)
from veilcam_training.bundle.signature import dump_owner, load_owner

MANIFEST, OWNER = "bundle.json", "owner.json"

MEBIBYTE = 2**20
MAX_FILE = 1024 * MEBIBYTE
MAX_PART = {
    MANIFEST: 8 * MEBIBYTE,
    OWNER: 4096,
    MASKS: 256 * MEBIBYTE,
    WEIGHTS: 1024 * MEBIBYTE,
    SCENES: 256 * MEBIBYTE,
    CARD: MEBIBYTE,
}
"""Largest size of each part after decompression [bytes]."""
FREE, RATIO = 16 * MEBIBYTE, 4
"""All parts together may unpack to so many bytes, and to so many times the size of the file: more
than weights and masks ever do, and a small file cannot fill the memory."""

_END = struct.Struct("<4s4H2LH")
"""End of central directory record of a zip archive (APPNOTE.TXT, 4.3.16)."""
_ENTRY = 46
"""Size of an entry of the central directory, without its name, extra field and comment [bytes]."""
LARGEST_DIRECTORY = 2**16
"""Size of the central directory of a bundle, at most [bytes]."""
LONGEST_REASON = 300
"""Of a refusal [letters]."""


def read_bundle(path: Path) -> Bundle:
    """Read and check a bundle; nothing of a bad one is used.

    Args:
        path: a ``*.veilcam`` file.

    Returns:
        The bundle, its ``digest`` set to the SHA-256 of the file.

    Raises:
        BundleError: the file is missing, truncated, tampered with, too large, of an unknown format,
            or holds parts that do not fit together; one line that says what to do.
    """
    try:
        return _read(path)
    except BundleError as error:
        # It may quote what the file holds, which can be anything.
        reason = " ".join(str(error).split())
        shown = reason if len(reason) <= LONGEST_REASON else f"{reason[:LONGEST_REASON]}..."
        raise BundleError(f"{path}: {shown}") from None


def write_bundle(path: Path, bundle: Bundle) -> None:
    """Write ``bundle`` so that ``path`` holds either what it held before or all of it.

    The same bundle gives the same bytes. The file is readable by its owner alone: it holds the
    masks, which are the camera's secret.

    Raises:
        BundleError: the bundle's parts do not fit together, or it was read with a signature, which
            holds for the file that was signed alone.
    """
    if bundle.owner is not None:
        raise BundleError("a signature cannot be written again: write the bundle with owner=None")
    check_bundle(bundle)
    parts, fresh = dump_parts(bundle), bundle.fresh
    if bundle.card is not None:
        parts[CARD] = dump_card(bundle.card)
    manifest = Manifest(
        task=bundle.task,
        labels=bundle.labels,
        camera=bundle.camera,
        scene=bundle.scene,
        embedding=bundle.embedding,
        channels=bundle.channels,
        mode=bundle.mode,
        pairs=tuple(
            PairManifest(layers=pair.layers, transfer_error=pair.transfer_error)
            for pair in bundle.pairs
        ),
        fresh=None
        if fresh is None
        else FreshManifest(
            noise=fresh.noise,
            reach=fresh.reach,
            layers=fresh.layers,
        ),
        provenance=dict(bundle.provenance),
        accuracy=bundle.accuracy,
        light=bundle.light,
        hiding=bundle.hiding,
        parts={name: _sha256(data) for name, data in parts.items()},
    )
    parts = {MANIFEST: dump_manifest(manifest), **parts}
    if bundle.version:
        parts[OWNER] = dump_owner(bundle.version, parts[MANIFEST], None)
    write_whole(path, _pack(parts), private=True)


def sign_bundle(path: Path, version: int, key: Ed25519PrivateKey | None) -> None:
    """Give a bundle its owner's version and signature, in place of those that it has.

    The same bundle, version and key give the same bytes.

    Args:
        path: path of the file, which is replaced whole.
        version: 1 or more; a daemon takes those that rise.
        key: private; None for a version without a signature.

    Raises:
        BundleError: the file is no whole bundle, the version is out of range, or the disk refuses.
    """
    read_bundle(path)
    parts = _unpack(_content(path))
    parts[OWNER] = dump_owner(version, parts[MANIFEST], key)
    _replace(path, parts)


def add_card(path: Path, card: PrivacyCard) -> None:
    """Lay a card into a bundle, in place of one that it has; all else stays as it was written.

    Args:
        path: path of the file, which is replaced whole. A version without a signature stays.
        card: card of this bundle.

    Raises:
        BundleError: the file is no whole bundle, the card is of another one, the bundle is signed
            (a signature holds for what was signed alone), or the disk refuses.
    """
    bundle = read_bundle(path)
    require(card.subject == bundle.subject, f"{path} is not what this card is of: attack it again")
    require(
        bundle.owner is None,
        f"{path} is signed: give the card to the file before its owner signs it",
    )
    parts = _unpack(_content(path)) | {CARD: dump_card(card)}
    manifest = json.loads(parts[MANIFEST])
    manifest["parts"][CARD] = _sha256(parts[CARD])
    parts[MANIFEST] = json.dumps(manifest, indent=1).encode()
    if bundle.version:
        parts[OWNER] = dump_owner(bundle.version, parts[MANIFEST], None)
    _replace(path, parts)


def _replace(path: Path, parts: Mapping[str, bytes]) -> None:
    try:
        write_whole(path, _pack(parts), private=True)
    except OSError as error:
        raise BundleError(f"{path} cannot be written ({error.strerror}): check it") from None


def _pack(parts: Mapping[str, bytes]) -> bytes:
    """Write an archive that depends on nothing but its parts."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in (each for each in MAX_PART if each in parts):
            require(
                len(parts[name]) <= MAX_PART[name],
                f"{name} has {len(parts[name])} bytes: use at most {MAX_PART[name]}",
            )
            archive.writestr(zipfile.ZipInfo(name), parts[name], zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def _content(path: Path) -> bytes:
    try:
        size = path.stat().st_size
        require(size <= MAX_FILE, f"has {size} bytes: a bundle has at most {MAX_FILE}")
        return path.read_bytes()
    except FileNotFoundError:
        raise BundleError("there is no such file: check the path, or train a bundle") from None
    except OSError as error:
        raise BundleError(f"cannot be read ({error.strerror}): check the file") from None


def _unpack(data: bytes) -> dict[str, bytes]:
    _require_few_entries(data)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return _parts(archive, FREE + RATIO * len(data))
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, ValueError) as error:
        if isinstance(error, BundleError):
            raise
        raise BundleError("is not a whole bundle (truncated or damaged): copy it again") from None


def _require_few_entries(data: bytes) -> None:
    """Refuse an archive of many entries before any of them is read, whatever count it gives."""
    end = len(data) - _END.size
    if end < 0 or data[end : end + 4] != b"PK\x05\x06":
        raise BundleError("is not a whole bundle (truncated or damaged): copy it again")
    *_, count, size, _, comment = _END.unpack(data[end:])
    # A ZIP64 archive has its counts elsewhere; no bundle needs one.
    extended = data[max(0, end - 20) : end].startswith(b"PK\x06\x07")
    directory = data[max(0, end - size) : end]
    found = place = 0
    while size <= LARGEST_DIRECTORY and place + _ENTRY <= len(directory):
        place += _ENTRY + sum(struct.unpack_from("<3H", directory, place + 28))
        found += 1
    require(
        not extended
        and comment == 0
        and size <= LARGEST_DIRECTORY
        and max(count, found) <= len(MAX_PART),
        f"has more entries than the {len(MAX_PART)} that a bundle may have: export it again",
    )


def _read(path: Path) -> Bundle:
    data = _content(path)
    parts = _unpack(data)
    manifest = load_manifest(parts[MANIFEST])
    wanted = set(PARTS[manifest.mode])
    carded = wanted | {CARD} if CARD in parts or CARD in manifest.parts else wanted
    require(
        manifest.parts.keys() == carded,
        "bundle.json lacks the digest of a part: export the bundle again",
    )
    require(
        parts.keys() - {MANIFEST, OWNER} == carded,
        f"mode {manifest.mode!r} has the parts {', '.join(sorted(wanted))} only",
    )
    for name, digest in manifest.parts.items():
        require(
            _sha256(parts[name]) == digest,
            f"{name} is not what bundle.json says (damaged or tampered with)",
        )
    subject = subject_of(parts[MANIFEST])
    version, owner = load_owner(parts[OWNER], parts[MANIFEST]) if OWNER in parts else (0, None)
    bundle = Bundle(
        task=manifest.task,
        labels=manifest.labels,
        camera=manifest.camera,
        scene=manifest.scene,
        embedding=manifest.embedding,
        mode=manifest.mode,
        pairs=() if manifest.mode == "fresh" else load_pairs(manifest.pairs, parts),
        fresh=None if manifest.fresh is None else load_fresh(manifest.fresh, parts),
        provenance=manifest.provenance,
        accuracy=manifest.accuracy,
        light=manifest.light,
        hiding=manifest.hiding,
        channels=manifest.channels,
        version=version,
        owner=owner,
        card=load_card(parts[CARD], subject) if CARD in parts else None,
    )
    check_bundle(bundle)
    return dataclasses.replace(bundle, digest=_sha256(data), subject=subject)


def _parts(archive: zipfile.ZipFile, left: int) -> dict[str, bytes]:
    """All parts, none larger than it may be, whatever the archive says about itself.

    Args:
        archive: open.
        left: greatest number of bytes that all of them together may unpack to.
    """
    names = [entry.filename for entry in archive.infolist()]
    for name in names:
        require(name in MAX_PART, f"holds an unknown part {name!r}: a bundle has none")
    require(
        len(set(names)) == len(names) and {MANIFEST, MASKS, WEIGHTS} <= set(names),
        f"does not hold {MANIFEST}, {MASKS} and {WEIGHTS} once each: export it again",
    )
    parts = {}
    for name in names:
        entry, limit = archive.getinfo(name), min(MAX_PART[name], left)
        require(
            not entry.flag_bits & 1
            and entry.compress_type in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED),
            f"{name} is encrypted or oddly compressed: export the bundle again",
        )
        require(
            entry.file_size <= limit, f"{name} has {entry.file_size} bytes: use at most {limit}"
        )
        with archive.open(entry) as stream:
            # No more is decompressed than it says, whatever it holds.
            parts[name] = stream.read(entry.file_size)
        left -= len(parts[name])
    return parts


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
