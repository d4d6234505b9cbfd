"""What an owner signs, and that nothing else passes for it."""

from __future__ import annotations

import base64
import hashlib
import json
from pathlib import Path

import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from tests.unit.training.bundle.conftest import pack, unpack

from veilcam_server.demo_data import BUNDLE, FRESH
from veilcam_training.bundle import (
    BundleError,
    OwnerKey,
    read_bundle,
    read_key,
    sign_bundle,
    write_bundle,
    write_key,
)
from veilcam_training.bundle.signature import MAX_VERSION

KEY = Ed25519PrivateKey.from_private_bytes(bytes(range(32)))
OWNER = OwnerKey(KEY.public_key().public_bytes_raw())


@pytest.fixture(scope="module", params=[BUNDLE, FRESH], ids=["pairs", "fresh"])
def written(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A bundle as it is written today; those that are shipped may hold what is ignored by now."""
    path = tmp_path_factory.mktemp("written") / "a.veilcam"
    write_bundle(path, read_bundle(request.param))
    return path.read_bytes()


@pytest.fixture
def path(written: bytes, tmp_path: Path) -> Path:
    result = tmp_path / "a.veilcam"
    result.write_bytes(written)
    return result


def test_signed_bundle_says_who_and_which_version_and_is_the_same_otherwise(path: Path) -> None:
    before = read_bundle(path)
    assert (before.version, before.owner) == (0, None)
    unsigned = unpack(path)
    sign_bundle(path, 7, KEY)
    after = read_bundle(path)
    assert (after.version, after.owner) == (7, OWNER)
    assert after.digest != before.digest
    signed = unpack(path)
    assert signed.pop("owner.json") != b""
    assert signed == unsigned
    assert path.stat().st_mode & 0o077 == 0


@pytest.mark.slow
def test_signing_gives_the_same_bytes_again_and_replaces_what_was_there(path: Path) -> None:
    sign_bundle(path, 1, Ed25519PrivateKey.generate())
    sign_bundle(path, 2, KEY)
    first = path.read_bytes()
    sign_bundle(path, 2, KEY)
    assert path.read_bytes() == first
    sign_bundle(path, 3, None)
    bundle = read_bundle(path)
    assert (bundle.version, bundle.owner) == (3, None)


@pytest.mark.slow
def test_version_is_written_and_a_signature_is_not_written_again(path: Path) -> None:
    sign_bundle(path, 3, None)
    first = path.read_bytes()
    write_bundle(path, read_bundle(path))
    assert read_bundle(path).version == 3
    assert unpack(path)["owner.json"] == b'{"version":3,"owner":null,"signature":null}'
    assert path.read_bytes() == first
    sign_bundle(path, 3, KEY)
    with pytest.raises(BundleError, match="owner=None"):
        write_bundle(path, read_bundle(path))


@pytest.mark.slow
def test_signature_is_of_one_content_and_one_version(path: Path, tmp_path: Path) -> None:
    sign_bundle(path, 7, KEY)
    parts = unpack(path)
    changed = json.loads(parts["bundle.json"])
    changed["task"] = "another"
    record = json.loads(parts["owner.json"])
    other = OwnerKey(Ed25519PrivateKey.generate().public_key().public_bytes_raw())
    flipped = bytearray(base64.b64decode(record["signature"]))
    flipped[5] ^= 1
    signatures = ("", "%%", base64.b64encode(flipped).decode())
    changes: list[dict[str, object]] = [{"version": 8}, {"owner": str(other)}]
    changes += [{"signature": text} for text in signatures]
    for edit in (
        {"bundle.json": json.dumps(changed).encode()},
        *({"owner.json": json.dumps({**record, **change}).encode()} for change in changes),
    ):
        pack(path, {**parts, **edit})
        with pytest.raises(BundleError, match="was changed after its owner signed it"):
            read_bundle(path)
    # Packed in another way, it is another file of the same content.
    pack(path, dict(reversed(parts.items())))
    assert read_bundle(path).owner == OWNER


@pytest.mark.thorough
@pytest.mark.parametrize(
    "part",
    [
        *(b"", b"{}"),
        *(b'{"version": %s}' % each for each in (b"0", b"true", b'"1"', b"%d" % (MAX_VERSION + 1))),
        b'{"version": 1, "more": 1}',
        b'{"version": 1, "owner": "veilcam-owner:AA=="}',
        b'{"version": 1, "signature": "AA=="}',
    ],
)
def test_version_that_is_none_is_refused(path: Path, part: bytes) -> None:
    pack(path, {**unpack(path), "owner.json": part})
    with pytest.raises(BundleError, match=r"owner.json is not valid"):
        read_bundle(path)


@pytest.mark.parametrize("text", ["", "AA==", "veilcam-owner:", "veilcam-owner:AA==", "ssh-rsa %%"])
def test_owner_key_that_is_none_is_refused(path: Path, text: str) -> None:
    with pytest.raises(BundleError, match="no owner's key"):
        OwnerKey.parse(text)
    part = {"version": 1, "owner": text, "signature": "AA=="}
    pack(path, {**unpack(path), "owner.json": json.dumps(part).encode()})
    with pytest.raises(BundleError, match="no owner's key"):
        read_bundle(path)


@pytest.mark.parametrize("version", [0, -1, MAX_VERSION + 1])
def test_version_out_of_range_is_refused_and_the_file_left_alone(path: Path, version: int) -> None:
    before = path.read_bytes()
    with pytest.raises(BundleError, match=f"version = {version} is not valid"):
        sign_bundle(path, version, KEY)
    assert path.read_bytes() == before


def test_key_of_an_owner_is_a_line() -> None:
    assert OwnerKey.parse(str(OWNER)) == OWNER
    assert OWNER.short == hashlib.sha256(OWNER.raw).hexdigest()[:12]
    with pytest.raises(BundleError, match="31 bytes"):
        OwnerKey(bytes(31))


def test_private_key_is_its_owner_s_alone_and_never_replaced(tmp_path: Path) -> None:
    path = tmp_path / "owner.pem"
    owner = write_key(path)
    assert path.stat().st_mode & 0o777 == 0o600
    before = path.read_bytes()
    assert read_key(path).public_key().public_bytes_raw() == owner.raw
    with pytest.raises(BundleError, match="was left alone"):
        write_key(path)
    assert path.read_bytes() == before
    path.chmod(0o640)
    with pytest.raises(BundleError, match=r"run chmod 600") as caught:
        read_key(path)
    assert "PRIVATE" not in str(caught.value)
    with pytest.raises(BundleError, match="cannot be written"):
        write_key(tmp_path / "none" / "owner.pem")


def test_private_key_that_is_none_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "owner.pem"
    with pytest.raises(BundleError, match="cannot be read"):
        read_key(path)
    other = X25519PrivateKey.generate().private_bytes(
        Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()
    )
    for content in (b"", b"no key", other):
        path.write_bytes(content)
        path.chmod(0o600)
        with pytest.raises(BundleError, match="is no Ed25519 key") as caught:
            read_key(path)
        assert "\n" not in str(caught.value)
