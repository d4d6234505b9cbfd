"""TLS: what is refused, and a daemon that other machines could reach."""

from __future__ import annotations

import datetime
import ipaddress
import ssl
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID
from tests.app.server.test_daemon import daemon

from veilcam_client import Camera
from veilcam_client.errors import AccessError, ConnectError
from veilcam_server.daemon import server_context
from veilcam_server.errors import StartError
from veilcam_server.security.tokens import TokenStore


def write_pair(directory: Path, passphrase: bytes | None = None) -> tuple[Path, Path]:
    """A self-signed certificate for 127.0.0.1, and its key."""
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "camera")])
    now = datetime.datetime.now(datetime.UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(1)
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + datetime.timedelta(days=1))
        .add_extension(
            x509.SubjectAlternativeName([x509.IPAddress(ipaddress.ip_address("127.0.0.1"))]),
            critical=False,
        )
        .sign(key, hashes.SHA256())
    )
    directory.mkdir(exist_ok=True)
    paths = directory / "certificate.pem", directory / "key.pem"
    paths[0].write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
    paths[1].write_bytes(
        key.private_bytes(
            serialization.Encoding.PEM,
            serialization.PrivateFormat.PKCS8,
            serialization.BestAvailableEncryption(passphrase)
            if passphrase
            else serialization.NoEncryption(),
        )
    )
    return paths


def test_certificate_that_cannot_be_used_is_named(tmp_path: Path) -> None:
    certificate, key = write_pair(tmp_path / "a")
    _, other = write_pair(tmp_path / "b")
    _, locked = write_pair(tmp_path / "c", b"passphrase")
    text = tmp_path / "text.pem"
    text.write_text("nothing")
    assert server_context(certificate, key).minimum_version == ssl.TLSVersion.TLSv1_2
    for first, second, reason in (
        (tmp_path / "x.pem", key, r"--tls-certificate: .*x\.pem cannot be read"),
        (certificate, tmp_path / "x.pem", r"--tls-key: .*x\.pem cannot be read"),
        (certificate, other, "the key it was made for"),
        (text, key, "both as PEM"),
        (certificate, locked, "the key has a passphrase"),
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
