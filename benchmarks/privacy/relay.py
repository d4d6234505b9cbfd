"""Relay that stands between a client and a daemon behind TLS, and sees what a listener sees."""

from __future__ import annotations

import datetime
import threading
import time
from pathlib import Path
from socket import SHUT_RDWR, create_connection, create_server, socket
from urllib.parse import urlsplit

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import NameOID

HEADER, APPLICATION = 5, 23
"""Length of a TLS record's header [bytes], and the type of records of an application."""


class Relay:
    """Relay to a daemon, and the TLS records that come back through it.

    Args:
        url: URL of the daemon.
    """

    def __init__(self, url: str) -> None:
        self._port, self._server = urlsplit(url).port, create_server(("127.0.0.1", 0))
        self.url = f"https://127.0.0.1:{self._server.getsockname()[1]}"
        self._records: list[tuple[float, int]] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def taken(self) -> list[tuple[float, int]]:
        """Return time and size of the records since the last call."""
        found, self._records = self._records, []
        return found

    def close(self) -> None:
        """Accept no more connections."""
        self._server.close()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._server.accept()
            except OSError:
                return
            far = create_connection(("127.0.0.1", self._port))
            for source, target, noted in ((near, far, False), (far, near, True)):
                given = (source, target, noted)
                threading.Thread(target=self._pump, args=given, daemon=True).start()

    def _pump(self, source: socket, target: socket, noted: bool) -> None:
        held = bytearray()
        try:
            while data := source.recv(1 << 16):
                if noted:
                    held += data
                    self._note(held)
                target.sendall(data)
            target.shutdown(SHUT_RDWR)
        except OSError:
            return

    def _note(self, held: bytearray) -> None:
        """Note the records that are whole, and take them away."""
        while len(held) >= HEADER:
            length = HEADER + int.from_bytes(held[3:HEADER], "big")
            if len(held) < length:
                return
            if held[0] == APPLICATION:
                self._records.append((time.monotonic(), length))
            del held[:length]


def certified(folder: Path) -> tuple[Path, Path]:
    """Write a certificate that vouches for itself, and its key; return their paths."""
    made, serial = ec.generate_private_key(ec.SECP256R1()), x509.random_serial_number()
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "camera")])
    now, day = datetime.datetime.now(datetime.UTC), datetime.timedelta(days=1)
    builder = x509.CertificateBuilder(name, name, made.public_key(), serial, now - day, now + day)
    paths = folder / "certificate.pem", folder / "key.pem"
    paths[0].write_bytes(builder.sign(made, hashes.SHA256()).public_bytes(Encoding.PEM))
    paths[1].write_bytes(made.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    return paths
