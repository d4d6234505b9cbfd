"""Servers that no client should wait for: silent, slow, lying, endless, or of another kind."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

import numpy as np

_OK = b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\n"
_HUGE = 100 * 10**6
_BUSY = (
    b"HTTP/1.1 503 Service Unavailable\r\nContent-Type: application/problem+json\r\n"
    b"Retry-After: 0\r\nContent-Length: %d\r\n\r\n%s"
)
_PROBLEM = (
    b'{"type":"t","title":"t","status":503,"detail":"d","instance":"i","code":"not_ready",'
    b'"request_id":"r","retryable":true}'
)


@dataclass(frozen=True)
class Hostile:
    """One server, drawn by chance.

    Attributes:
        kind: what it does.
        deadline: that a client gives it [s].
        pause: between two pieces of what it dribbles [s].
        secure: whether the client expects TLS, which this server does not speak.
    """

    kind: str
    deadline: float
    pause: float
    secure: bool

    @contextmanager
    def serving(self) -> Iterator[str]:
        """Yield its URL; it ends afterwards."""
        stop = threading.Event()
        with socket.create_server(("127.0.0.1", 0)) as listener:
            threads = [threading.Thread(target=self._accept, args=(listener, stop))]
            threads[0].start()
            try:
                port = listener.getsockname()[1]
                yield f"{'https' if self.secure else 'http'}://127.0.0.1:{port}"
            finally:
                stop.set()
                with suppress(OSError):
                    listener.shutdown(socket.SHUT_RDWR)
                threads[0].join()

    def _accept(self, listener: socket.socket, stop: threading.Event) -> None:
        handlers = []
        while not stop.is_set():
            try:
                peer, _ = listener.accept()
            except OSError:
                break
            handlers.append(threading.Thread(target=self._handle, args=(peer, stop)))
            handlers[-1].start()
        for handler in handlers:
            handler.join()

    def _handle(self, peer: socket.socket, stop: threading.Event) -> None:
        peer.settimeout(0.05)
        with peer, suppress(OSError):
            KINDS[self.kind](_Peer(peer, self.pause, stop))


class _Peer:
    """A client, as its server sees it."""

    def __init__(self, connection: socket.socket, pause: float, stop: threading.Event) -> None:
        self._connection, self._pause, self._stop = connection, pause, stop

    def send(self, content: bytes) -> None:
        """Send all, whether or not it is read."""
        rest = memoryview(content)
        while rest and not self._stop.is_set():
            with suppress(TimeoutError):
                rest = rest[self._connection.send(rest[: 1 << 16]) :]

    def dribble(self, content: bytes) -> None:
        """Send one byte after the other, and the last ones for ever."""
        for byte in content:
            if self._stop.wait(self._pause):
                return
            self.send(bytes((byte,)))
        while not self._stop.wait(self._pause):
            self.send(b" ")

    def keep(self) -> None:
        """Hold the line and say nothing."""
        self._stop.wait()

    def repeat(self, content: bytes) -> None:
        """Send it for ever, as fast as it is read."""
        while not self._stop.is_set():
            self.send(content)


def _answers(content: bytes) -> Callable[[_Peer], None]:
    def answer(peer: _Peer) -> None:
        peer.send(content)

    return answer


def _then_silent(content: bytes) -> Callable[[_Peer], None]:
    def answer(peer: _Peer) -> None:
        peer.send(content)
        peer.keep()

    return answer


def _dribbled(at_once: bytes, rest: bytes) -> Callable[[_Peer], None]:
    def answer(peer: _Peer) -> None:
        peer.send(at_once)
        peer.dribble(rest)

    return answer


def _endless(at_once: bytes, piece: bytes) -> Callable[[_Peer], None]:
    def answer(peer: _Peer) -> None:
        peer.send(at_once)
        peer.repeat(piece)

    return answer


def _sized(body: bytes, length: int | None = None, more: bytes = b"") -> bytes:
    size = len(body) if length is None else length
    return b"%s%sContent-Length: %d\r\n\r\n%s" % (_OK, more, size, body)


_CHUNKED = _OK + b"Transfer-Encoding: chunked\r\n\r\n"
KINDS: dict[str, Callable[[_Peer], None]] = {
    "silent": _Peer.keep,
    "hangs up": _answers(b""),
    "hangs up in the headers": _answers(_OK),
    "dribbles headers": _dribbled(b"HTTP/1.1 200 OK\r\nX-Slow: ", b"." * 10_000),
    "dribbles a status line": _dribbled(b"", b"HTTP/1.1 200 OK" + b" " * 10_000),
    "dribbles a body": _dribbled(_sized(b"{", length=10_000), b" " * 10_000),
    "dribbles chunks": _dribbled(_CHUNKED, b"1\r\n \r\n" * 2_000),
    "dribbles a chunk's size": _dribbled(_CHUNKED, b"0" * 10_000),
    "dribbles without a length": _dribbled(_OK + b"\r\n", b"{" + b" " * 10_000),
    "falls silent in the headers": _then_silent(_OK),
    "falls silent in the body": _then_silent(_sized(b'{"version":', length=500)),
    "promises more than it sends": _answers(_sized(b"{}", length=500)),
    "sends more than it promises": _then_silent(_sized(b"{}", length=1) + b" " * 500),
    "promises nothing and sends": _then_silent(_sized(b"", length=0) + b"{}" * 500),
    "promises two lengths": _then_silent(_sized(b"{}", more=b"Content-Length: 9\r\n")),
    "promises a negative length": _then_silent(_sized(b"{}", length=-2)),
    "100 MB": _endless(_sized(b"", length=_HUGE), b"[" * 65_536),
    "100 MB in chunks": _endless(_CHUNKED, b"10000\r\n" + b"[" * 65_536 + b"\r\n"),
    "100 MB without a length": _endless(_OK + b"\r\n", b"[" * 65_536),
    "endless headers": _endless(b"HTTP/1.1 200 OK\r\n", b"X-More: and more\r\n" * 100),
    "endless header": _endless(b"HTTP/1.1 200 OK\r\nX-More: ", b"." * 4096),
    "endless first answers": _endless(b"", b"HTTP/1.1 102 Processing\r\n\r\n" * 10),
    "dribbles first answers": _dribbled(b"", b"HTTP/1.1 102 Processing\r\n\r\n" * 1_000),
    "says it is compressed": _then_silent(_sized(b"{}", more=b"Content-Encoding: gzip\r\n")),
    "is busy for ever": _answers(_BUSY % (len(_PROBLEM), _PROBLEM)),
    "is of another version": _answers(_sized(b'{"version": 2, "api_version": "2"}')),
    "is a web page": _answers(_sized(b"<!doctype html><title>Router</title>")),
    "is no HTTP": _then_silent(b"SSH-2.0-OpenSSH_9.2p1\r\n"),
    "is HTTP/2": _then_silent(b"\x00\x00\x00\x04\x00\x00\x00\x00\x00"),
    "leads elsewhere": _answers(
        b"HTTP/1.1 302 Found\r\nLocation: http://127.0.0.1:1/\r\nContent-Length: 0\r\n\r\n"
    ),
}
_PLAIN_ALONE = frozenset(("is of another version", "is a web page", "leads elsewhere"))


def draw(count: int, seed: int) -> list[Hostile]:
    """Draw servers, every kind among the first ones."""
    chance = np.random.default_rng(seed)
    names = list(KINDS)
    drawn = []
    for number in range(count):
        kind = names[number] if number < len(names) else str(chance.choice(names))
        deadline, pause = chance.uniform(0.1, 0.4), chance.uniform(0.001, 0.03)
        secure = number >= len(names) and kind not in _PLAIN_ALONE and chance.random() < 0.15
        drawn.append(Hostile(kind, float(deadline), float(pause), bool(secure)))
    return drawn
