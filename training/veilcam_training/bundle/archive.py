"""Reading and writing ``*.veilcam`` files: zip archives with the parts of a mode, and no code."""

import dataclasses
import hashlib
import io
import zipfile
import zlib
from pathlib import Path

from veilcam_optics.files import write_whole
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

MANIFEST = "bundle.json"

MEBIBYTE = 2**20
MAX_FILE = 1024 * MEBIBYTE
MAX_PART = {
    MANIFEST: 8 * MEBIBYTE,
    MASKS: 256 * MEBIBYTE,
    WEIGHTS: 1024 * MEBIBYTE,
    SCENES: 256 * MEBIBYTE,
}
"""Largest size of each part after decompression [bytes]."""
FREE, RATIO = 16 * MEBIBYTE, 4
"""All parts together may unpack to so many bytes, and to so many times the size of the file: more
than weights and masks ever do, and a small file cannot fill the memory."""

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
        BundleError: the bundle's parts do not fit together.
    """
    check_bundle(bundle)
    parts, fresh = dump_parts(bundle), bundle.fresh
    manifest = Manifest(
        task=bundle.task,
        labels=bundle.labels,
        camera=bundle.camera,
        scene=bundle.scene,
        embedding=bundle.embedding,
        channels=bundle.channels,
        mode=bundle.mode,
        pairs=tuple(PairManifest(layers=pair.layers) for pair in bundle.pairs),
        fresh=None
        if fresh is None
        else FreshManifest(
            device=fresh.device,
            noise=fresh.noise,
            reach=fresh.reach,
            features=fresh.features,
            layers=fresh.layers,
        ),
        provenance=dict(bundle.provenance),
        accuracy=bundle.accuracy,
        parts={name: _sha256(data) for name, data in parts.items()},
    )
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in {MANIFEST: dump_manifest(manifest), **parts}.items():
            require(
                len(data) <= MAX_PART[name],
                f"{name} has {len(data)} bytes: use at most {MAX_PART[name]}",
            )
            archive.writestr(zipfile.ZipInfo(name), data, zipfile.ZIP_DEFLATED)
    write_whole(path, buffer.getvalue(), private=True)


def _read(path: Path) -> Bundle:
    try:
        size = path.stat().st_size
        require(size <= MAX_FILE, f"has {size} bytes: a bundle has at most {MAX_FILE}")
        data = path.read_bytes()
    except FileNotFoundError:
        raise BundleError("there is no such file: check the path, or train a bundle") from None
    except OSError as error:
        raise BundleError(f"cannot be read ({error.strerror}): check the file") from None
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            parts = _parts(archive, FREE + RATIO * size)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, ValueError) as error:
        if isinstance(error, BundleError):
            raise
        raise BundleError("is not a whole bundle (truncated or damaged): copy it again") from None
    manifest = load_manifest(parts[MANIFEST])
    wanted = set(PARTS[manifest.mode])
    require(
        manifest.parts.keys() == wanted,
        "bundle.json lacks the digest of a part: export the bundle again",
    )
    require(
        parts.keys() - {MANIFEST} == wanted,
        f"mode {manifest.mode!r} has the parts {', '.join(sorted(wanted))} only",
    )
    for name, digest in manifest.parts.items():
        require(
            _sha256(parts[name]) == digest,
            f"{name} is not what bundle.json says (damaged or tampered with)",
        )
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
        channels=manifest.channels,
    )
    check_bundle(bundle)
    return dataclasses.replace(bundle, digest=_sha256(data))


def _parts(archive: zipfile.ZipFile, left: int) -> dict[str, bytes]:
    """All parts, none larger than it may be, whatever the archive says about itself.

    Args:
        archive: open.
        left: what all of them together may unpack to [bytes].
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
            parts[name] = stream.read(limit + 1)
        require(len(parts[name]) <= limit, f"{name} has more than {limit} bytes")
        left -= len(parts[name])
    return parts


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
