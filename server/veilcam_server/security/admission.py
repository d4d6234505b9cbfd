"""Admission of requests to the service: host, tokens, limits, and the log."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import structlog
from pydantic import JsonValue
from starlette.datastructures import Headers

from veilcam_client.wire.log import Kind
from veilcam_client.wire.tokens import SCOPES
from veilcam_server.errors import StorageError, UnauthorizedError
from veilcam_server.security.idempotency import IdempotencyKeys
from veilcam_server.security.limits import ConcurrencyLimit, Lease, RateLimit
from veilcam_server.security.log import Log
from veilcam_server.security.pairing import PairingOffers
from veilcam_server.security.sessions import HEADER, SessionStore
from veilcam_server.security.site import Site
from veilcam_server.security.tokens import Caller, TokenStore
from veilcam_server.settings import Settings
from veilcam_server.system.state_file import Report, log_fault

STREAMS = "event streams are open: close one that nobody reads"
STREAMS_OF_ONE = "of your event streams are open: close one of them"
UPLOADS = "uploads are under way: wait for one to end"
UPLOADS_OF_ONE = "of your uploads are under way: wait for one to end"

log = structlog.get_logger()


@dataclass(frozen=True, slots=True)
class Admission:
    """The same for all requests to one daemon.

    Attributes:
        tokens: None lets everybody in who reaches the daemon.
        site: site whose ``Host`` is answered, and the pages that may ask.
        log: log of what callers do; None in tests.
        rate: limit of the rate of one caller.
        concurrency: limit of the requests of one caller that are under way.
        streams: greatest number of open event streams, all callers together.
        streams_of_one: greatest number of event streams of one caller.
        uploads: greatest number of uploads under way, all callers together.
        uploads_of_one: greatest number of uploads of one caller under way.
        keys: idempotency keys of this run of the daemon.
        lease: lease of the camera.
        settings: settings of the daemon, for its diagnostics: without paths, addresses and labels.
        sessions: sessions of pages in browsers; None where no tokens are wanted, and in tests.
        full_scores: True where scores are told in full, and not in tenths.
        offers: offers to pair a receiver; None where embeddings never leave, and in tests.
    """

    tokens: TokenStore | None = None
    site: Site = field(default_factory=Site)
    log: Log | None = None
    rate: RateLimit = field(default_factory=lambda: RateLimit(1000.0, 1000))
    concurrency: ConcurrencyLimit = field(default_factory=lambda: ConcurrencyLimit(64))
    streams: ConcurrencyLimit = field(default_factory=lambda: ConcurrencyLimit(64, STREAMS))
    streams_of_one: ConcurrencyLimit = field(
        default_factory=lambda: ConcurrencyLimit(16, STREAMS_OF_ONE)
    )
    uploads: ConcurrencyLimit = field(default_factory=lambda: ConcurrencyLimit(4, UPLOADS))
    uploads_of_one: ConcurrencyLimit = field(
        default_factory=lambda: ConcurrencyLimit(2, UPLOADS_OF_ONE)
    )
    keys: IdempotencyKeys = field(default_factory=IdempotencyKeys)
    lease: Lease = field(default_factory=Lease)
    settings: Mapping[str, JsonValue] = field(default_factory=dict)
    sessions: SessionStore | None = None
    full_scores: bool = False
    offers: PairingOffers | None = None

    def require_log(self) -> None:
        """Raise :class:`StorageError` while what callers do cannot be written down."""
        if self.log is not None:
            self.log.require()

    def note(
        self,
        caller: Caller | None,
        action: str,
        *,
        code: str | None,
        durable: bool = False,
        **details: str | int,
    ) -> None:
        """Write to the log what was done or refused.

        Args:
            caller: None where there was no valid token, or none was wanted.
            action: method and path.
            code: code of the problem in the answer, None where it went well.
            durable: True: the record is on the disk at return, or this raises.
            details: further facts: status, request id, peer.

        Raises:
            StorageError: it must be durable, and is not.
        """
        # Who asks too often must not push out what others did.
        if code == "too_many_requests" or self.log is None:
            return
        who = {} if caller is None else {"caller": caller.id, "label": caller.label}
        outcome = {} if code is None else {"code": code}
        kind: Kind = "refused" if caller is None and code is not None else "request"
        facts: dict[str, str | int] = {"action": action, **outcome, **who, **details}
        self.log.append(kind, facts, durable=durable)

    @contextmanager
    def admitted(self, headers: Headers, peer: str) -> Iterator[Caller]:
        """Find out who asks, and count the request as under way.

        Args:
            headers: headers of the request.
            peer: address that it comes from.

        Raises:
            UnauthorizedError: without a valid token.
            ProblemError: too often, or too many at once.
            StorageError: the tokens cannot be read.
        """
        caller = replace(self._caller(headers, peer), full_scores=self.full_scores)
        self.rate.take(caller.id)
        with self.concurrency.held(caller.id):
            yield caller

    @contextmanager
    def claiming(self, peer: str) -> Iterator[None]:
        """Count a claim of an offer, which has no token, as a failure of its address.

        Before its secret is looked at: what is not looked at is no try, and need not be noted.

        Raises:
            ProblemError: too often, or too many at once.
        """
        self.rate.take(_failures(peer))
        with self.concurrency.held(_failures(peer)):
            yield

    def still_admits(self, headers: Headers) -> bool:
        """Return whether the token of a request that goes on is still valid."""
        if self.tokens is None:
            return True
        try:
            self._known(self.tokens, headers)
        except (UnauthorizedError, StorageError):
            return False
        return True

    def _caller(self, headers: Headers, peer: str) -> Caller:
        if self.tokens is None:
            return Caller(peer, "no token wanted", frozenset(SCOPES))
        try:
            return self._known(self.tokens, headers)
        except UnauthorizedError:
            # Only failures count against an address: who guesses there locks nobody out.
            self.rate.take(_failures(peer))
            raise

    def _known(self, tokens: TokenStore, headers: Headers) -> Caller:
        given = headers.getlist("authorization")
        # A cookie alone comes with what any page makes a browser ask: it counts for nothing.
        if not given and HEADER in headers and self.sessions is not None:
            return self.sessions.caller(headers)
        # Two of them would mean two callers.
        return tokens.caller(given[0] if len(given) == 1 else "")


def _failures(peer: str) -> str:
    return f"failures of {peer}"


@contextmanager
def open_admission(
    settings: Settings,
    camera_log: Log | None = None,
    report: Report = log_fault,
    certificate: bytes | None = None,
) -> Iterator[Admission]:
    """Yield what stands in front of a daemon.

    Args:
        settings: settings of the daemon.
        camera_log: log of what callers do; None in tests.
        report: takes what was damaged of its state.
        certificate: SHA-256 of the certificate that it serves; None: plain HTTP.

    Raises:
        StartError: the state directory cannot be used.
    """
    tokens = TokenStore(settings.state_dir, report=report) if settings.auth == "tokens" else None
    sessions = None if tokens is None else SessionStore(settings.state_dir, tokens, report)
    offers = None
    if settings.release != "none":
        offers = PairingOffers(settings.state_dir, tokens, certificate, report)
    if tokens is not None and not tokens.tokens():
        log.warning("no tokens yet: nobody may ask until 'sudo veilcamd token first' made one")
    yield Admission(
        tokens,
        Site(settings.hosts, settings.serves_others, settings.frame_ancestors, settings.root_path),
        camera_log,
        RateLimit(settings.rate, settings.burst),
        ConcurrencyLimit(settings.concurrency),
        ConcurrencyLimit(settings.streams, STREAMS),
        ConcurrencyLimit(settings.caller_streams, STREAMS_OF_ONE),
        settings=settings.redacted(),
        sessions=sessions,
        full_scores=settings.full_scores,
        offers=offers,
    )
