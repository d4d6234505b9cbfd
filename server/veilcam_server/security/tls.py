"""TLS of the listeners, checked before anything starts."""

from __future__ import annotations

import ssl
from asyncio.sslproto import SSLProtocol
from pathlib import Path

from veilcam_server.errors import StartError

_READ_AT_ONCE = 32 * 1024
"""From a connection, all connections of this process [bytes]."""


def server_context(certificate: Path, key: Path) -> ssl.SSLContext:
    """Return a context of TLS 1.2 or later with this certificate.

    Args:
        certificate: PEM file, with the certificates between it and the authority.
        key: PEM file of its private key, without a passphrase.

    Raises:
        StartError: one of them cannot be used; no message repeats what is in it.
    """
    # asyncio fills 256 KiB of memory for whatever a connection may send at once, so that 200 that
    # never speak would take 50 MB. A record of TLS has 16 KiB (RFC 8446, 5.1).
    SSLProtocol.max_size = _READ_AT_ONCE
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    for option, path in (("--tls-certificate", certificate), ("--tls-key", key)):
        try:
            path.open("rb").close()
        except OSError as error:
            raise StartError(
                f"{option}: {path} cannot be read ({error.strerror}): check it"
            ) from None
    try:
        # A passphrase would be asked for on the terminal, where nobody sits.
        context.load_cert_chain(certificate, key, password=_no_passphrase)
    except (ssl.SSLError, StartError) as error:
        reason = getattr(error, "reason", None) or str(error)
        raise StartError(
            f"--tls-certificate and --tls-key cannot be used ({reason}): give a certificate and "
            "the key it was made for, both as PEM"
        ) from None
    return context


def _no_passphrase() -> str:
    raise StartError("the key has a passphrase")
