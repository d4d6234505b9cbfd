"""Offers to pair a receiver by one line: one at a time, for five minutes, used once."""

from __future__ import annotations

import hmac
import secrets
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from veilcam_client.wire.pairing import (
    MOST_TRIES,
    OFFER_SECONDS,
    SECRET_BYTES,
    PairingLine,
    PairingOffer,
)
from veilcam_client.wire.tokens import ROLES, NewToken, Role
from veilcam_server.errors import NamedError, UnauthorizedError
from veilcam_server.security.tokens import NO_DIGEST, TokenStore, secret_digest
from veilcam_server.system.state_file import Report, StateStore, log_fault


class WrongClaimError(NamedError, code="unauthorized"):
    """Claim of no open offer; whether one is open, the message does not tell.

    Args:
        ended: True where this claim ended an offer.
    """

    def __init__(self, *, ended: bool) -> None:
        super().__init__(
            "this line pairs nothing: it was used, it is too old, or it was never valid. Ask the "
            "camera's owner for a new one"
        )
        self.ended = ended


class _Offer(BaseModel):
    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)
    digest: str
    """SHA-256 of the secret."""
    role: Role
    maker: str | None
    """Id of the caller who made it; None: 'veilcamd pair'."""
    expires: float
    """On the machine's monotonic clock [s]."""


@dataclass(frozen=True, slots=True)
class ClaimedOffer:
    """Offer whose secret a claim has.

    Attributes:
        role: role of the token that it gives.
        until: end of that token, seconds since 1970; None: never.
        tokens: store of the tokens; None: the daemon wants none.
    """

    role: Role
    until: float | None
    tokens: TokenStore | None

    def token(self, label: str) -> AbstractContextManager[NewToken | None]:
        """Return the context of :meth:`TokenStore.creating`; None where no tokens are wanted."""
        if self.tokens is None:
            return nullcontext()
        return self.tokens.creating(label, ROLES[self.role], until=self.until)


class PairingOffers:
    """``DIRECTORY/pairing.json``: the last offer that this process or another one made.

    The file has the SHA-256 of the offer's secret. An offer ends when another one is made, when it
    is used, after ``MOST_TRIES`` wrong claims, with the token that made it, and with the daemon:
    one that was made before this object has ended. So a wrong claim changes no file: the time that
    this takes would tell that an offer is open.

    Args:
        directory: state directory of the daemon, which exists.
        tokens: tokens of the daemon; None: it wants none.
        certificate: SHA-256 of the certificate that the daemon serves; None: plain HTTP.
        report: takes what was damaged.
        now: monotonic clock that all processes of the machine share [s].

    Raises:
        StartError: the record cannot be read.
    """

    def __init__(
        self,
        directory: Path,
        tokens: TokenStore | None = None,
        certificate: bytes | None = None,
        report: Report = log_fault,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.certificate = certificate
        self._tokens, self._now = tokens, now
        self._file = StateStore(
            directory / "pairing.json",
            _Offer,
            lost="no offer is open: make a new one with 'veilcamd pair'",
            report=report,
        )
        self._lock = threading.Lock()
        before = self._file.read()
        self._ended = "" if before is None else before.digest
        self._tried, self._wrong = "", 0

    def make(self, place: str, role: Role, maker: str | None = None) -> PairingOffer:
        """Make an offer, which ends the one before.

        Args:
            place: HOST:PORT, or the absolute path of a unix socket.
            role: role of the token that it gives.
            maker: id of the caller who makes it; None: there is none.

        Raises:
            ValueError: plain HTTP leads to this place, which is of another machine.
            StorageError: it cannot be written.
        """
        certificate = None if place.startswith("/") else self.certificate
        line = PairingLine(place, secrets.token_bytes(SECRET_BYTES), certificate)
        offer = _Offer(
            digest=secret_digest(line.secret.hex()),
            role=role,
            maker=maker,
            expires=self._now() + OFFER_SECONDS,
        )
        self._file.change(lambda _: offer)
        return PairingOffer(
            line=str(line),
            code=qr_code(str(line)),
            role=role,
            expires_at=datetime.now(UTC) + timedelta(seconds=OFFER_SECONDS),
        )

    @contextmanager
    def claimed(self, secret: str) -> Iterator[ClaimedOffer]:
        """Yield the offer with this secret; it ends with the context, unless that raises.

        Claims wait for each other: of two with the right secret, one finds the offer ended.

        Args:
            secret: secret of the line, in hexadecimal digits.

        Raises:
            WrongClaimError: no open offer has this secret.
            StorageError: the record cannot be read.
        """
        with self._lock:
            offer = self._file.read()
            right = hmac.compare_digest(
                secret_digest(secret), NO_DIGEST if offer is None else offer.digest
            )
            found = self._opened(offer)
            if found is None or offer is None:
                raise WrongClaimError(ended=False)
            if not right:
                raise WrongClaimError(ended=self._count(offer))
            yield found
            self._ended = offer.digest

    def _opened(self, offer: _Offer | None) -> ClaimedOffer | None:
        """Return an offer that may be claimed; None for one that has ended."""
        if offer is None:
            return None
        until = None
        if offer.maker is not None and self._tokens is not None:
            try:
                until = self._tokens.caller_of(offer.maker).expires
            except UnauthorizedError:
                return None
        if offer.digest == self._ended or self._now() >= offer.expires:
            return None
        return ClaimedOffer(offer.role, until, self._tokens)

    def _count(self, offer: _Offer) -> bool:
        """Count a wrong claim; return whether it ended the offer."""
        self._tried, before = offer.digest, self._wrong if self._tried == offer.digest else 0
        self._wrong = before + 1
        if self._wrong == MOST_TRIES:
            self._ended = offer.digest
        return self._ended == offer.digest


def qr_code(line: str) -> tuple[str, ...]:
    """Return the QR code of a line: rows of ``0`` (white) and ``1`` (black), without a margin."""
    import segno  # noqa: PLC0415 - most daemons draw none

    return tuple("".join(map(str, row)) for row in segno.make_qr(line).matrix)
