"""Options of requests: address, time-outs, credentials and repetitions."""

from __future__ import annotations

import base64
import logging
import math
import os
import random
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from urllib.parse import unquote, urlsplit

import httpx

from veilcam_client.arguments import masked, seconds, whole
from veilcam_client.errors import (
    ArgumentError,
    ConnectError,
    LeasedError,
    RequestTimeoutError,
    VeilcamError,
)
from veilcam_client.http.credentials import Credentials
from veilcam_client.http.deadline import CAMERA_TIMEOUT, CallTimeout, Limit, until
from veilcam_client.wire.base import RUN_HEADER, UNKNOWN_RUN

DEFAULT_URL = "http://127.0.0.1:8787"
STREAM_SILENCE = 45.0
"""An event stream without even a heartbeat for this long is dead [s]."""
LEASE_POLL = 1.0
"""Between two looks whether another's lease has ended, at most [s]: it may end before its time."""

_UNSENT = (httpx.ConnectError, httpx.ConnectTimeout, httpx.PoolTimeout)
"""Errors of a request that never left."""

log: logging.Logger = logging.getLogger("veilcam")


@dataclass(frozen=True, slots=True)
class RetryPolicy:
    """Wait ``uniform(0, min(cap, base 2^attempt))`` [s], plus the server's Retry-After.

    Full jitter spreads clients that failed together (Brooker, "Exponential backoff and jitter",
    2015). A Retry-After longer than ``patience`` [s] is not waited for: the error is raised.
    """

    retries: int = 2
    base: float = 0.25
    cap: float = 4.0
    patience: float = 30.0
    uniform: Callable[[float, float], float] = field(
        default=random.SystemRandom().uniform, repr=False
    )

    def delay(self, attempt: int, error: VeilcamError) -> float:
        """Seconds to wait after failure number ``attempt`` (from 0), or raise it to give up."""
        asked = error.retry_after or 0.0
        if not error.retryable or attempt >= self.retries or asked > self.patience:
            raise error
        return asked + self.jitter(attempt, self.cap)

    def jitter(self, attempt: int, cap: float) -> float:
        """Seconds by chance, the more the more attempts have failed."""
        return self.uniform(0.0, min(cap, math.ldexp(self.base, min(attempt, 30))))


@dataclass(frozen=True, slots=True)
class Options:
    """Options of all requests of one camera; ``url`` is kept without its password."""

    url: str
    call_timeout: float | None
    connect_timeout: float
    read_timeout: float
    retry: RetryPolicy
    credentials: Credentials
    base: str = field(init=False)
    socket: str | None = field(init=False)
    _basic: Mapping[str, str] = field(init=False, repr=False)
    """Header of the user and the password of the address, for a proxy that wants them."""

    def __post_init__(self) -> None:
        base, socket, user = _place(self.url)
        for name in ("connect_timeout", "read_timeout"):
            seconds(name, getattr(self, name))
        if self.call_timeout is not None:
            seconds("timeout", self.call_timeout, "> 0, or None")
        whole("max_retries", self.retry.retries, 0)
        self.credentials.require_safe(self.url)
        basic = {} if user is None else {"Authorization": f"Basic {user}"}
        # httpx would write the password of an address to its log.
        for name, value in (("url", masked(self.url)), ("base", base), ("socket", socket)):
            object.__setattr__(self, name, value)
        object.__setattr__(self, "_basic", basic)

    def headers(self, headers: Mapping[str, str]) -> dict[str, str]:
        """Return ``headers`` with what says who asks."""
        return {**self.credentials.headers(headers), **self._basic}

    def until(self, timeout: CallTimeout) -> float:
        """Return the end of a call that begins now, on the monotonic clock [s]."""
        if timeout is CAMERA_TIMEOUT:
            return until(self.call_timeout)
        return until(None if timeout is None else seconds("timeout", timeout, "> 0, or None"))

    def limits(self, deadline: float = math.inf, *, stream: bool = False) -> httpx.Timeout:
        """Limits of one request."""
        longest = Limit.of(STREAM_SILENCE if stream else self.read_timeout, deadline)
        return httpx.Timeout(longest, connect=Limit.of(self.connect_timeout, deadline))

    @contextmanager
    def translate(self) -> Iterator[None]:
        """Turn what httpx raises into this SDK's errors."""
        try:
            yield
        except (httpx.TimeoutException, TimeoutError) as error:
            kind = "connection" if isinstance(error, httpx.ConnectTimeout) else "answer"
            raise RequestTimeoutError(f"no {kind} from {self.url} in time") from error
        except httpx.RequestError as error:
            reason = str(error) or type(error).__name__
            raise ConnectError(
                f"cannot reach {self.url}: {reason} (is veilcamd running there?)"
            ) from error


class Attempts:
    """One call, from its first request to its answer or the error that ends it.

    Attributes:
        deadline: deadline of the call, on the monotonic clock [s].

    Args:
        options: options of the camera.
        timeout: time-out of the call, without the wait for another's lease [s].
        wait: wait for another's lease to end [s]; None: none.
    """

    def __init__(self, options: Options, timeout: CallTimeout, wait: float | None) -> None:
        if wait is not None:
            wait = seconds("wait", wait, "0 or more, or None", zero=True)
        self._options, self._timeout, self._failed = options, timeout, 0
        self._patient_until = -math.inf if wait is None else until(wait)
        self.deadline: float = options.until(timeout)
        self._run: str | None = None
        self._renewed = self._maybe_done = False

    def run_header(self, seen: str | None) -> dict[str, str]:
        """Return the header of the run that the idempotency key of the call belongs to.

        A repetition of what may have been done belongs to the run that may have done it.

        Args:
            seen: run of the daemon that answered last; None: none did.
        """
        if not self._maybe_done:
            self._run = seen
        run = self._run or (UNKNOWN_RUN if self._maybe_done else None)
        return {} if run is None else {RUN_HEADER: run}

    def pause(self, error: VeilcamError) -> float:
        """Seconds to wait before it is asked again, or raise the error that it ends with."""
        if isinstance(error, LeasedError):
            return self._lease(error)
        if error.code == "answer_lost" and self._run and not (self._maybe_done or self._renewed):
            # The daemon was restarted before this call, which it did not do.
            self._renewed = True
            return 0.0
        self._maybe_done |= error.status is None and not isinstance(error.__cause__, _UNSENT)
        delay = self._options.retry.delay(self._failed, error)
        if time.monotonic() + delay >= self.deadline:
            raise error
        self._failed += 1
        log.info("failed with %r, once more in %.2f s", error.code, delay)
        return delay

    def _lease(self, error: LeasedError) -> float:
        left = self._patient_until - time.monotonic()
        if left <= 0:
            raise error
        # As soon as it may end, and at the latest when patience does.
        pause = min(left, error.retry_after or math.inf, LEASE_POLL)
        pause = self._options.retry.uniform(pause / 2, pause) if pause == LEASE_POLL else pause
        self.deadline = self._options.until(self._timeout) + pause
        log.debug("another holds the camera, once more in %.2f s", pause)
        return pause


def follow_environment() -> None:
    """Write the log of the SDK to the terminal, if ``VEILCAM_LOG`` is ``debug`` or ``info``.

    Raises:
        ValueError: it is something else.
    """
    asked = os.environ.get("VEILCAM_LOG")
    if not asked:
        return
    if asked not in ("debug", "info"):
        raise ValueError(f"VEILCAM_LOG = {asked!r} is not valid: use debug or info")
    log.setLevel(asked.upper())
    if not log.hasHandlers():
        handler = logging.StreamHandler()
        handler.setFormatter(logging.Formatter("%(asctime)s %(name)s %(levelname)s %(message)s"))
        log.addHandler(handler)


def _place(url: str) -> tuple[str, str | None, str | None]:
    """Return the base of all paths, the unix socket if it is one, and the password as base64."""
    wrong = ArgumentError(
        f"url = {masked(str(url))!r} is not valid: use http://HOST:PORT or unix:///PATH/TO/SOCKET"
    )
    if not isinstance(url, str) or not url.isprintable():
        raise wrong
    try:
        parts = urlsplit(url)
        place = parts.netloc.rpartition("@")[2]
        base = parts._replace(netloc=place).geturl().rstrip("/").removesuffix("/v1").rstrip("/")
        if parts.scheme == "unix" and parts.path and not parts.netloc:
            return "http://localhost", parts.path, None
        plain = parts.scheme in ("http", "https") and not parts.query and not parts.fragment
        # httpx knows more of hosts, and would say so at the first request.
        if not plain or not parts.hostname or parts.port == 0 or not httpx.URL(base).host:
            raise wrong
    except (ValueError, httpx.InvalidURL):
        raise wrong from None
    if parts.username is None:
        return base, None, None
    user = f"{unquote(parts.username)}:{unquote(parts.password or '')}"
    return base, None, base64.b64encode(user.encode()).decode()
