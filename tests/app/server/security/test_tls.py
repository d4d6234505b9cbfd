"""TLS: what is refused, and a daemon that other machines could reach."""

from __future__ import annotations

import ssl
from pathlib import Path

import pytest
from cryptography.hazmat.primitives import serialization
from tests.app.server.test_daemon import daemon
from tests.siege.daemon import write_certificate

from veilcam_client import Camera
from veilcam_client.errors import AccessError, ConnectError
from veilcam_server.daemon import server_context
from veilcam_server.errors import StartError
from veilcam_server.security.tokens import TokenStore


def write_pair(directory: Path) -> tuple[Path, Path]:
    """A self-signed certificate for 127.0.0.1, and its key."""
    directory.mkdir(exist_ok=True)
    paths = write_certificate(directory)
    return paths["tls_certificate"], paths["tls_key"]


def lock(key: Path) -> Path:
    """Write a key once more, with a passphrase."""
    private = serialization.load_pem_private_key(key.read_bytes(), None)
    pem, form = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8
    encryption = serialization.BestAvailableEncryption(b"passphrase")
    locked = key.with_name("locked.pem")
    locked.write_bytes(private.private_bytes(pem, form, encryption))
    return locked


def test_certificate_that_cannot_be_used_is_named(tmp_path: Path) -> None:
    certificate, key = write_pair(tmp_path / "a")
    _, other = write_pair(tmp_path / "b")
    text = tmp_path / "text.pem"
    text.write_text("nothing")
    assert server_context(certificate, key).minimum_version == ssl.TLSVersion.TLSv1_2
    for first, second, reason in (
        (tmp_path / "x.pem", key, r"--tls-certificate: .*x\.pem cannot be read"),
        (certificate, tmp_path / "x.pem", r"--tls-key: .*x\.pem cannot be read"),
        (certificate, other, "the key it was made for"),
        (text, key, "both as PEM"),
        (certificate, lock(key), "the key has a passphrase"),
    ):
        with pytest.raises(StartError, match=reason) as caught:
            server_context(first, second)
        assert "\n" not in str(caught.value)


@pytest.mark.thorough
def test_daemon_with_tls_and_tokens(bundle_file: Path, scene_file: Path, tmp_path: Path) -> None:
    certificate, key = write_pair(tmp_path / "tls")
    store = TokenStore(tmp_path / "state")
    token = store.create("reader", ("read:status",), None)
    options = [
        *("--bundle", str(bundle_file), "--scenes", str(scene_file)),
        *("--state-dir", str(tmp_path / "state"), "--settle", "0.01"),
        *("--host", "0.0.0.0", "--port", "0", "--auth", "tokens"),
        *("--tls-certificate", str(certificate), "--tls-key", str(key)),
    ]
    with daemon(tmp_path / "log", *options) as (_, shown):
        assert shown.startswith("https://0.0.0.0:")
        url = shown.replace("0.0.0.0", "127.0.0.1")
        with Camera(url, token=token.secret, ca_file=certificate) as camera:
            assert camera.status().state == "ready"
            with pytest.raises(AccessError, match="the scope classify"):
                camera.classify()
            store.revoke(token.id)
            with pytest.raises(AccessError):
                camera.status()
        with pytest.raises(ConnectError), Camera(url, max_retries=0) as stranger:
            stranger.status()
    assert token.secret.rpartition("_")[2] not in (tmp_path / "log").read_text()
