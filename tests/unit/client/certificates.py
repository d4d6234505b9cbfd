"""Certificates and TLS servers of tests."""

from __future__ import annotations

import datetime
import hashlib
import socket
import ssl
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import NameOID

BEGIN = datetime.datetime(2020, 1, 1, tzinfo=datetime.UTC)
DAY = datetime.timedelta(days=1)


@dataclass(frozen=True)
class Certificate:
    """A certificate that any name, and no present time, is valid for; it may sign others."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey

    @classmethod
    def made(cls, signer: Certificate | None = None, days: int = 1) -> Certificate:
        """Return a new one, signed by itself or by another."""
        key = ec.generate_private_key(ec.SECP256R1())
        number = x509.random_serial_number()
        name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"camera {number}")])
        issuer = name if signer is None else signer.certificate.subject
        signing = key if signer is None else signer.key
        # Python 3.13 wants the last three of whatever an authority signs.
        usage = x509.KeyUsage(True, False, False, False, False, True, False, False, False)
        identifier = x509.AuthorityKeyIdentifier.from_issuer_public_key(signing.public_key())
        certificate = (
            x509.CertificateBuilder(issuer, name, key.public_key(), number)
            .not_valid_before(BEGIN)
            .not_valid_after(BEGIN + days * DAY)
            .add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
            .add_extension(x509.SubjectAlternativeName([x509.DNSName("localhost")]), critical=False)
            .add_extension(usage, critical=True)
            .add_extension(identifier, critical=False)
            .add_extension(
                x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False
            )
            .sign(signing, hashes.SHA256())
        )
        return cls(certificate, key)

    @property
    def pem(self) -> bytes:
        return self.certificate.public_bytes(serialization.Encoding.PEM)

    @property
    def digest(self) -> str:
        der = self.certificate.public_bytes(serialization.Encoding.DER)
        return hashlib.sha256(der).hexdigest()

    def context(self, folder: Path) -> ssl.SSLContext:
        """Return what serves it."""
        file = folder / f"{self.digest[:8]}.pem"
        file.write_bytes(
            self.pem
            + self.key.private_bytes(
                serialization.Encoding.PEM,
                serialization.PrivateFormat.PKCS8,
                serialization.NoEncryption(),
            )
        )
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(file)
        return context


@contextmanager
def listening(tls: ssl.SSLContext) -> Iterator[tuple[str, list[bytes]]]:
    """Yield HOST:PORT of a server, and the first bytes that come through TLS, for each client."""
    told: list[bytes] = []
    with socket.create_server(("127.0.0.1", 0)) as server:

        def accept() -> None:
            with suppress(OSError):
                while True:
                    plain, _ = server.accept()
                    plain.settimeout(10)
                    heard = b""
                    with suppress(OSError), tls.wrap_socket(plain, server_side=True) as client:
                        heard = client.recv(4096)
                    told.append(heard)

        thread = threading.Thread(target=accept, daemon=True)
        thread.start()
        yield f"127.0.0.1:{server.getsockname()[1]}", told
        server.shutdown(socket.SHUT_RDWR)
    thread.join()
