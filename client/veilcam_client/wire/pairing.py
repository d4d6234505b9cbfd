"""Pairing of a receiver by one line: offer, line, claim and what the camera answers.

The line is ``veilcam://HOST:PORT/#DATA``, or ``veilcam:///PATH#DATA`` for a unix socket. DATA is
base64 of RFC 4648, section 5, without padding: 16 random bytes, and over TLS the SHA-256 of the
camera's certificate (DER) after them.
"""

from __future__ import annotations

import base64
from dataclasses import dataclass, field
from datetime import datetime
from typing import Self
from urllib.parse import quote, unquote, urlsplit

from pydantic import Field

from veilcam_client.arguments import is_this_machine
from veilcam_client.wire.base import EXAMPLE_TIME, Answer, Question
from veilcam_client.wire.sealing import (
    EXAMPLE_DEVICE,
    PairedReceiver,
    ReceiverRequest,
    example_receiver,
)
from veilcam_client.wire.tokens import Role

SECRET_BYTES = 16
"""Size of the secret of a line [bytes]."""
CERTIFICATE_BYTES = 32
"""Size of the SHA-256 of a certificate [bytes]."""
OFFER_SECONDS = 300
"""Time that a line is valid [s]."""
MOST_TRIES = 3
"""Wrong claims that end an offer."""
_SCHEME = "veilcam"


@dataclass(frozen=True, slots=True)
class PairingLine:
    """The line that pairs a receiver; ``str`` gives the line itself.

    Attributes:
        place: HOST:PORT, or the absolute path of a unix socket.
        secret: secret of the offer, 16 bytes.
        certificate: SHA-256 of the camera's certificate, 32 bytes; None: plain HTTP, which is for
            loopback and unix sockets alone.

    Raises:
        ValueError: a line that cannot be used; no message repeats it.
    """

    place: str
    secret: bytes = field(repr=False)
    certificate: bytes | None = None

    def __post_init__(self) -> None:
        if len(self.secret) != SECRET_BYTES:
            raise ValueError(_WRONG)
        if self.certificate is None:
            if not self.place.startswith("/") and not is_loopback(self.place):
                raise ValueError(
                    "this line leads to another machine and names no certificate: take a line of "
                    "a camera that serves TLS"
                )
        elif self.place.startswith("/") or len(self.certificate) != CERTIFICATE_BYTES:
            raise ValueError(_WRONG)

    def __str__(self) -> str:
        data = base64.urlsafe_b64encode(self.secret + (self.certificate or b"")).decode()
        path = quote(self.place) if self.place.startswith("/") else f"{self.place}/"
        return f"{_SCHEME}://{path}#{data.rstrip('=')}"

    @property
    def url(self) -> str:
        """URL of the camera, as ``Camera`` takes it."""
        if self.place.startswith("/"):
            return f"unix://{self.place}"
        return f"{'http' if self.certificate is None else 'https'}://{self.place}"

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read a line; raises ValueError, whose message does not repeat it."""
        try:
            parts = urlsplit(text.strip())
            padding = "=" * (-len(parts.fragment) % 4)
            data = base64.b64decode(parts.fragment + padding, altchars=b"-_", validate=True)
            if parts.scheme != _SCHEME or parts.query or parts.username or parts.password:
                raise ValueError
            if parts.netloc:
                if parts.path not in ("", "/") or not parts.hostname or not parts.port:
                    raise ValueError
                place = parts.netloc
            else:
                place = unquote(parts.path)
                if not place.startswith("/"):
                    raise ValueError
        except ValueError:
            raise ValueError(_WRONG) from None
        return cls(place, data[:SECRET_BYTES], data[SECRET_BYTES:] or None)


_WRONG = (
    "this is no line that pairs: copy the whole of what 'veilcamd pair' or the camera's page "
    "shows, from veilcam:// on, and put it between quotes"
)


def is_loopback(place: str) -> bool:
    """Return whether a line without a certificate may lead to HOST:PORT."""
    return is_this_machine(urlsplit(f"//{place}").hostname or "")


class PairingRequest(Question):
    """Offer to be made: whoever has its line may pair one receiver."""

    role: Role = "operator"
    """Role of the token that the receiver's user gets."""


class PairingOffer(Answer):
    """Offer to pair one receiver. It ends the offer that was open before."""

    line: str = Field(repr=False)
    """``veilcam://HOST:PORT/#...``, for ``veilcam pair``. It holds a secret."""
    code: tuple[str, ...] = Field(repr=False)
    """Line as a QR code: rows of ``0`` (white) and ``1`` (black), without a margin."""
    role: str
    """Role of the token that the receiver's user gets."""
    expires_at: datetime
    """End of the offer."""


class PairingClaim(ReceiverRequest):
    """Claim of an offer: the receiver to be paired, with the secret of the line."""

    secret: str = Field(repr=False, pattern=r"^[0-9a-f]{32}$")
    """Secret of the line, 32 hexadecimal digits."""


class Paired(Answer):
    """Receiver that was just paired, with its token; ``token`` is shown this once."""

    device: str = Field(pattern=r"^[0-9a-f]{64}$")
    """Public Ed25519 key of the camera, 64 hexadecimal digits."""
    receiver: PairedReceiver
    """Receiver."""
    role: str
    """Role of the token."""
    token: str | None = Field(repr=False, pattern=r"^[!-~]+$")
    """Token of the role; None where the camera wants no tokens."""


def examples() -> tuple[Answer | Question, ...]:
    """Return examples for documents."""
    return (
        PairingRequest(role="operator"),
        PairingOffer(
            line=str(PairingLine("camera.example:8787", bytes(16), bytes(32))),
            code=("101", "010", "101"),
            role="operator",
            expires_at=EXAMPLE_TIME,
        ),
        PairingClaim(label="laptop", key="veilcam-receiver:c2VhbGVk", secret="0f" * 16),
        Paired(
            device=EXAMPLE_DEVICE,
            receiver=example_receiver(),
            role="operator",
            token="vc_0123456789ab_" + "0f" * 32,
        ),
    )
