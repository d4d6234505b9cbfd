"""Turns of peers, eviction, and TLS of connections that begin."""

from __future__ import annotations

import asyncio
import errno
import gc
import socket
import ssl
from asyncio.sslproto import SSLProtocol
from pathlib import Path

import pytest
from tests.app.server.gate.conftest import REQUEST, SLOW, Behind, Serving, heard, is_served
from tests.app.server.security.test_tls import write_pair

from veilcam_server.daemon import server_context
from veilcam_server.gate import server

pytestmark = pytest.mark.anyio


def knock(behind: Behind, *names: str) -> dict[str, socket.socket]:
    """Ask for a path of each name, from the peer that its first letter names."""
    return {
        name: behind.knock(
            REQUEST.replace(b"/", f"/{name}".encode(), 1), f"127.0.0.{ord(name[0]) - 90}"
        )
        for name in names
    }


async def test_peers_take_turns(serving: Serving) -> None:
    async with serving(limit=64) as behind:
        knock(behind, "a1", "a2", "a3", "a4", "b1", "c1", "c2")
        await behind.until(lambda: len(behind.asked) == 7)
        assert "".join(behind.asked) == "/a1/b1/c1/a2/c2/a3/a4"


async def test_peer_with_fewest_connections_comes_first(serving: Serving) -> None:
    async with serving(limit=64) as behind:
        knock(behind, "a", "a", "a", "b", "c", "c", "c")
        await behind.until(lambda: len(behind.asked) == 7)
        knock(behind, "a1", "a2", "b1", "b2", "c1", "d1")
        await behind.until(lambda: len(behind.asked) == 13)
        assert "".join(behind.asked[7:]) == "/d1/b1/b2/a1/c1/a2"


async def test_peer_with_most_loses_its_oldest_where_too_many_wait(serving: Serving) -> None:
    async with serving(limit=64, waiting=3) as behind:
        clients = knock(behind, "b1", "a1", "a2", "a3", "a4")
        await behind.until(lambda: len(behind.asked) == 3)
        assert "".join(behind.asked) == "/b1/a3/a4"
        assert [await heard(clients[name]) for name in ("a1", "a2")] == [b"", b""]
        assert behind.connections.dropped == {"evicted": 2}


async def test_new_connection_is_refused_where_all_is_work(serving: Serving) -> None:
    async with serving(limit=2) as behind:
        working = [behind.knock(SLOW) for _ in range(2)]
        await behind.until(lambda: len(behind.asked) == 2)
        assert await heard(behind.knock(REQUEST)) == b""
        assert behind.connections.dropped["refused"] == 1
        behind.go.set()
        for one in working:
            assert await is_served(one)
        assert await is_served(behind.knock(REQUEST))


async def test_more_may_wait_than_come_in_at_once(
    serving: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(server, "BATCH", 3)
    async with serving(limit=64, waiting=1) as behind:
        # All in the queue of the kernel before the first is accepted.
        crowd = [behind.knock(REQUEST) for _ in range(7)]
        answers = [await heard(one) for one in crowd]
        served = sum(answer.startswith(b"HTTP/1.1 200") for answer in answers)
        assert served + behind.connections.dropped["evicted"] == 7
        assert behind.connections.dropped["evicted"] >= 3


@pytest.fixture(scope="module")
def tls(tmp_path_factory: pytest.TempPathFactory) -> ssl.SSLContext:
    return server_context(*write_pair(Path(tmp_path_factory.mktemp("tls"))))


def all_are_in(behind: Behind, crowd: int) -> bool:
    return len(behind.connections) + behind.connections.dropped.total() == crowd


async def asks_over_tls(address: tuple[str, int]) -> bool:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    reader, writer = await asyncio.open_connection(*address, ssl=context)
    writer.write(REQUEST)
    line = await reader.readline()
    writer.transport.abort()
    return line.startswith(b"HTTP/1.1 200")


@pytest.mark.slow
async def test_peers_sent_away_take_no_memory(serving: Serving, tls: ssl.SSLContext) -> None:
    """Not even until the garbage collector comes: it does not know how much 300 kB are."""
    async with serving(limit=4, tls=tls) as behind:
        gc.collect()
        gc.disable()
        try:
            for _ in range(30):
                behind.knock()
            await behind.until(lambda: all_are_in(behind, 30))
            assert await asks_over_tls(behind.address)
            # Those of the limit, and the client's own; some may be about to go.
            assert sum(type(each) is SSLProtocol for each in gc.get_objects()) <= 4 + 3
        finally:
            gc.enable()


async def test_handshake_that_takes_too_long(
    serving: Serving, tls: ssl.SSLContext, caplog: pytest.LogCaptureFixture
) -> None:
    async with serving(tls=tls, headers=0.2) as behind:
        assert await heard(behind.knock()) == b""
        assert behind.connections.dropped["handshake"] == 1
        assert not len(behind.connections)
    assert not caplog.records


class Broken(socket.socket):
    """Listener that fails three times."""

    def __init__(self) -> None:
        super().__init__()
        self.errors = [errno.EMFILE, errno.ENOMEM, errno.EMFILE]

    def accept(self) -> tuple[socket.socket, object]:
        if self.errors:
            raise OSError(self.errors.pop(0), "broken")
        return super().accept()


async def test_accept_that_fails_is_tried_again_after_a_pause(
    serving: Serving, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pauses: list[float] = []
    async with serving(listening=Broken) as behind:
        loop = asyncio.get_running_loop()
        before = loop.call_later
        monkeypatch.setattr(server, "PAUSE", 0.01)

        def later(delay: float, *rest: object) -> asyncio.TimerHandle:
            pauses.append(delay)
            return before(delay, *rest)  # type: ignore[arg-type]

        monkeypatch.setattr(loop, "call_later", later)
        assert await is_served(behind.knock(REQUEST))
        assert behind.connections.failures == 3
        assert pauses.count(0.01) == 3
    assert capsys.readouterr().out.count("connection not accepted") == 1


async def test_connection_is_evicted_where_no_file_is_left(serving: Serving) -> None:
    async with serving(limit=64, listening=Broken) as behind:
        behind.server._listeners[0].errors.clear()  # type: ignore[attr-defined]
        clients = [behind.knock(REQUEST[:-2]) for _ in range(3)]
        await behind.until(lambda: len(behind.connections) == 3)
        behind.server._listeners[0].errors.append(errno.EMFILE)  # type: ignore[attr-defined]
        assert await is_served(behind.knock(REQUEST))
        assert await heard(clients[0]) == b""
        assert behind.connections.dropped == {"evicted": 1}


async def test_waiting_connection_is_sent_away_when_the_gate_closes(serving: Serving) -> None:
    async with serving() as behind:
        idle = behind.knock(REQUEST)
        assert await is_served(idle)
        working = behind.knock(SLOW)
        await behind.until(lambda: len(behind.asked) == 2)
        unfinished = behind.knock(b"GET")
        await behind.until(lambda: len(behind.connections) == 3)
        behind.server.should_exit = True
        for one in (idle, unfinished):
            assert await heard(one) == b""
        behind.go.set()
        assert await is_served(working)
