"""Credentials: a token, and the authority or the certificate that vouches for the daemon."""

import hashlib
import os
import ssl
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self
from urllib.parse import urlsplit

from veilcam_client.arguments import is_this_machine, masked, of_type
from veilcam_client.errors import ArgumentError

MOST_SECRET = 4096
"""Size of a file that holds a secret [bytes]."""


def read_secret(path: Path, *, private: bool = False) -> str:
    """Return the one line of a file that holds a token or a password.

    Args:
        path: path of the file.
        private: True: others may not read the file.

    Raises:
        ArgumentError: a file that cannot be used; the message does not repeat the line.
    """
    try:
        with path.open("rb") as stream:
            if private and os.fstat(stream.fileno()).st_mode & 0o077:
                raise ArgumentError(f"{path} is open to others: run chmod 600 {path}")
            content = stream.read(MOST_SECRET + 1)
        lines = content.decode("utf-8").strip().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is no text"
        raise ArgumentError(f"{path} cannot be read: {reason}") from None
    if len(lines) != 1 or len(content) > MOST_SECRET:
        raise ArgumentError(f"{path} must hold one line")
    return lines[0]


@dataclass(slots=True)
class Credentials:
    """Credentials that a client has beside an address.

    Attributes:
        token: token; None: none.
        ca_file: PEM file; what the system trusts if None.
        certificate: SHA-256 of the one certificate to trust, 64 hexadecimal digits, whoever signed
            it; None: the authority says which.
        lease: secret of the lease that this client holds, where it was told one.

    Raises:
        ValueError: a token that is none; the message does not repeat it.
    """

    token: str | None = field(default=None, repr=False)
    ca_file: str | os.PathLike[str] | None = None
    certificate: str | None = None
    lease: str | None = field(default=None, repr=False, init=False)

    def __post_init__(self) -> None:
        if self.ca_file is not None:
            of_type("ca_file", self.ca_file, (str, os.PathLike), "the path of a PEM file")
        given = "-" if self.token is None else self.token
        of_type("token", given, str, "what 'veilcamd token create' printed")
        if not (given and given.isascii() and given.isprintable() and " " not in given):
            raise ArgumentError("the token is not valid: it starts with vc_ and has no spaces")

    def require_safe(self, url: str) -> None:
        """Raise ArgumentError if what is secret would go to another machine, or in the clear."""
        parts = urlsplit(url)
        if self.certificate is not None and parts.scheme != "https":
            raise ArgumentError(f"url = {masked(url)!r} shows no certificate: use https://")
        if self.token and parts.scheme == "http" and not is_this_machine(parts.hostname or ""):
            raise ArgumentError(
                f"url = {masked(url)!r} would send the token in the clear: use https://"
            )

    def headers(self, headers: Mapping[str, str]) -> dict[str, str]:
        """``headers`` with token and lease."""
        more = {}
        if self.token is not None:
            more["Authorization"] = f"Bearer {self.token}"
        if self.lease is not None:
            more["Veilcam-Lease"] = self.lease
        return {**headers, **more}

    def trusted(self) -> ssl.SSLContext | bool:
        """Return the trust of TLS; raises ValueError for a ``ca_file`` that cannot be used."""
        if self.certificate is not None:
            return _Pinned(self.certificate)
        if self.ca_file is None:
            return True
        try:
            return ssl.create_default_context(cafile=self.ca_file)
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or "no certificate in it"
            raise ArgumentError(
                f"ca_file = {os.fspath(self.ca_file)!r} cannot be used ({reason}): give a PEM file"
            ) from None


class _PinnedSocket(ssl.SSLSocket):
    def do_handshake(self, block: bool = False) -> None:
        super().do_handshake(block)
        _check(self)


class _PinnedObject(ssl.SSLObject):
    def do_handshake(self) -> None:
        super().do_handshake()
        _check(self)


class _Pinned(ssl.SSLContext):
    """TLS with the one machine that has the key of a certificate.

    The handshake fails before a byte is sent through it. Neither the signer of the certificate
    counts nor its names or dates: a camera may have no clock.
    """

    sslsocket_class = _PinnedSocket
    sslobject_class = _PinnedObject
    certificate: str

    def __new__(cls, certificate: str) -> Self:
        self = super().__new__(cls, ssl.PROTOCOL_TLS_CLIENT)
        self.check_hostname, self.verify_mode = False, ssl.CERT_NONE
        self.certificate = certificate
        return self


def _check(tls: ssl.SSLSocket | ssl.SSLObject) -> None:
    shown = hashlib.sha256(tls.getpeercert(binary_form=True) or b"").hexdigest()
    if shown != getattr(tls.context, "certificate", None):
        raise ssl.SSLCertVerificationError(
            1, "its certificate is not the one that it was paired with"
        )
