"""Deadlines: who dribbles is ended, who moves on is not, however long it takes."""

from __future__ import annotations

import asyncio
import socket

import pytest
from tests.app.server.gate.conftest import POST, REQUEST, SLOW, Behind, Serving, heard, is_served

from veilcam_server.gate import protocol
from veilcam_server.gate.protocol import PORTION
from veilcam_server.security.site import security_headers

pytestmark = pytest.mark.anyio

ENDING = 60.0
"""Of each deadline: more than a test takes on any machine, so that the clock is put on [s]."""


@pytest.mark.parametrize("said", [b"", b"GET / HT", REQUEST[:-2]])
async def test_headers_that_do_not_come_in_time(serving: Serving, said: bytes) -> None:
    async with serving(headers=ENDING) as behind:
        one = behind.knock(said)
        await behind.until(lambda: len(behind.connections))
        assert await _dribbles_in_vain(behind, one) == "headers"
        assert not behind.asked


async def test_headers_of_a_second_request_have_their_own_time(
    serving: Serving, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(protocol, "READING_TIME", 100 * ENDING)
    async with serving(headers=ENDING) as behind:
        one = behind.knock(REQUEST)
        assert await is_served(one)
        # Idle for longer than headers may take.
        await behind.let_pass(2 * ENDING)
        one.sendall(REQUEST + REQUEST[:5])
        assert await is_served(one)
        assert await _dribbles_in_vain(behind, one) == "headers"
        assert len(behind.asked) == 2


async def test_dribbled_body_reaches_nobody(serving: Serving) -> None:
    async with serving(body=ENDING) as behind:
        one = behind.knock(POST % 1000)
        await behind.until(lambda: len(behind.connections))
        assert await _dribbles_in_vain(behind, one) == "body"
        assert not behind.asked


async def test_long_body_that_moves_on_may_take_long(serving: Serving) -> None:
    async with serving(body=ENDING) as behind:
        loop, size = asyncio.get_running_loop(), 20 * PORTION
        one = behind.knock(POST % size)
        for _ in range(19):
            await loop.sock_sendall(one, b"a" * PORTION)
            await behind.let_pass(0.5 * ENDING)
        await loop.sock_sendall(one, b"a" * PORTION)
        assert await is_served(one)
        assert behind.bodies == [size]
        assert not behind.connections.dropped


async def test_long_body_that_stops_is_ended(serving: Serving) -> None:
    async with serving(body=ENDING) as behind:
        one = behind.knock(POST % (20 * PORTION) + b"a" * 2 * PORTION)
        await behind.until(lambda: behind.asked)
        assert await _dribbles_in_vain(behind, one) == "body"
        assert 2 * PORTION <= behind.bodies[0] < 3 * PORTION


async def test_body_that_the_application_does_not_read_ends_nobody(serving: Serving) -> None:
    async with serving(body=ENDING) as behind:
        loop, size = asyncio.get_running_loop(), 40 * PORTION
        one = behind.knock((POST % size).replace(b"/", b"/late", 1))
        sending = asyncio.create_task(loop.sock_sendall(one, b"a" * size))
        await behind.until(lambda: behind.asked)
        for _ in range(4):
            await behind.let_pass(ENDING)
        assert not behind.connections.dropped
        behind.go.set()
        await sending
        assert await is_served(one)


async def test_rest_of_a_body_that_is_answered_already(serving: Serving) -> None:
    async with serving(body=ENDING) as behind:
        size = 20 * PORTION
        one = behind.knock((POST % size).replace(b"/", b"/deaf", 1) + b"a" * PORTION)
        assert await is_served(one)
        assert await _dribbles_in_vain(behind, one) == "body"


async def test_connection_goes_on_after_the_rest_of_a_body(serving: Serving) -> None:
    async with serving(body=ENDING) as behind:
        size = 2 * PORTION
        one = behind.knock((POST % size).replace(b"/", b"/deaf", 1) + b"a" * PORTION)
        assert await is_served(one)
        one.sendall(b"a" * PORTION + REQUEST)
        assert await is_served(one)
        assert behind.asked == ["/deaf", "/"]


async def test_work_may_take_longer_than_all_deadlines(serving: Serving) -> None:
    async with serving(limit=2, headers=ENDING, body=ENDING) as behind:
        one = behind.knock(SLOW)
        await behind.until(lambda: behind.asked)
        await behind.let_pass(10 * ENDING)
        # Nor is it ended for others.
        others = [behind.knock() for _ in range(5)]
        assert await heard(others[0]) == b""
        behind.go.set()
        assert await is_served(one)


async def test_answer_that_nobody_reads(serving: Serving, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(protocol, "READING_TIME", 0.2)
    async with serving() as behind:
        behind.knock(REQUEST.replace(b"/", b"/big", 1))
        await behind.until(lambda: behind.connections.dropped["answer"])
        assert not len(behind.connections)


async def test_bytes_that_are_no_http_are_answered_and_not_logged(
    serving: Serving, caplog: pytest.LogCaptureFixture
) -> None:
    async with serving() as behind:
        one = behind.knock(b"\0\r\n\r\n")
        answer = await heard(one)
        assert answer.startswith(b"HTTP/1.1 400 Bad Request\r\n")
        for name, value in security_headers(()).items():
            assert f"\r\n{name}: {value}\r\n".encode() in answer
        assert answer.endswith(b"\r\n\r\nInvalid HTTP request received.")
        upgrade = b"Host: a\r\nConnection: upgrade\r\nUpgrade: websocket"
        assert await is_served(behind.knock(REQUEST.replace(b"Host: a", upgrade)))
    assert not [each for each in caplog.records if "uvicorn" in each.name]


FRAMED_TWICE = (
    b"POST / HTTP/1.1\r\nHost: a\r\nContent-Length: 5\r\nTransfer-Encoding: chunked\r\n\r\n",
    b"POST / HTTP/1.1\r\nHost: a\r\ntransfer-encoding: Chunked\r\ncontent-length: 0\r\n\r\n",
    b"GET / HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: chunked\r\nContent-Length: 5\r\n"
    b"Expect: 100-continue\r\n\r\n",
)


@pytest.mark.parametrize("body", [b"", b"0\r\n\r\n", b"0\r\n\r\n" + REQUEST])
@pytest.mark.parametrize("head", FRAMED_TWICE)
async def test_body_with_two_lengths_is_refused_and_its_connection_closed(
    serving: Serving, head: bytes, body: bytes
) -> None:
    async with serving() as behind:
        answer = await heard(behind.knock(head + body))
        assert answer.startswith(b"HTTP/1.1 400 Bad Request\r\n")
        assert answer.count(b"HTTP/1.1") == 1
        for name, value in security_headers(()).items():
            assert f"\r\n{name}: {value}\r\n".lower().encode() in answer.lower()
        assert not behind.asked
        await behind.until(lambda: not len(behind.connections))


UPLOADS = (
    b"Content-Length: %d" % (PORTION + 1),
    b"Content-Length: 9\r\nExpect: 100-continue",
    b"Transfer-Encoding: chunked",
)


@pytest.mark.parametrize("header", UPLOADS)
async def test_upload_can_be_refused_after_its_headers(serving: Serving, header: bytes) -> None:
    async with serving() as behind:
        one = behind.knock(b"POST /deaf HTTP/1.1\r\nHost: a\r\n" + header + b"\r\n\r\n")
        answer = await asyncio.get_running_loop().sock_recv(one, 2**16)
        assert answer.startswith(b"HTTP/1.1 200 OK\r\n")
        assert not behind.bodies
        # What was announced may come or not: nobody can tell it from a request.
        assert (b"connection: close" in answer.lower()) is (b"Expect" in header)


async def test_body_that_is_waited_for_is_asked_for(serving: Serving) -> None:
    async with serving() as behind:
        loop = asyncio.get_running_loop()
        one = behind.knock((POST % 5).replace(b"Host: a", b"Host: a\r\nExpect: 100-continue"))
        assert (await loop.sock_recv(one, 2**16)).startswith(b"HTTP/1.1 100 ")
        await loop.sock_sendall(one, b"hello")
        answer = await loop.sock_recv(one, 2**16)
        assert answer.startswith(b"HTTP/1.1 200 OK\r\n")
        assert b"connection: close" not in answer.lower()
        assert behind.bodies == [5]


async def test_body_that_breaks_off_leaves_no_trace(
    serving: Serving, caplog: pytest.LogCaptureFixture
) -> None:
    async with serving() as behind:
        one = behind.knock(POST % 1000 + b"a")
        await behind.until(lambda: len(behind.connections))
        one.close()
        await behind.until(lambda: not len(behind.connections))
        assert not behind.asked
    assert not caplog.records


async def _dribbles_in_vain(behind: Behind, one: socket.socket) -> str:
    """Send byte after byte until the connection ends, and return what it was ended for."""
    for due in (False, True, True):
        one.send(b"a")
        await behind.let_pass(0.6 * ENDING)
        if not due:
            assert not behind.connections.dropped
        elif behind.connections.dropped:
            break
    assert await heard(one) == b""
    [(reason, count)] = behind.connections.dropped.items()
    assert count == 1
    return reason


async def test_call_with_a_broken_body_is_named_in_the_answer(serving: Serving) -> None:
    named = b"Veilcam-Call: " + b"0f" * 16 + b"\r\n"
    head = b"POST / HTTP/1.1\r\nHost: a\r\n" + named
    async with serving() as behind:
        broken = behind.knock(head + b"Transfer-Encoding: chunked\r\n\r\nno number\r\n")
        answer = await heard(broken)
        assert answer.startswith(b"HTTP/1.1 400")
        assert named in answer
        # One that was answered names no other request.
        second = behind.knock(head + b"Content-Length: 0\r\n\r\n")
        assert await is_served(second)
        second.sendall(b"no HTTP\r\n\r\n")
        answer = await heard(second)
        assert answer.startswith(b"HTTP/1.1 400")
        assert b"veilcam-call" not in answer.lower()
        assert b"Veilcam-Run: the-run\r\n" in answer


async def test_body_that_breaks_after_its_answer_ends_the_connection_without_a_line(
    serving: Serving, caplog: pytest.LogCaptureFixture
) -> None:
    head = b"POST /deaf HTTP/1.1\r\nHost: a\r\nTransfer-Encoding: chunked\r\n\r\n"
    async with serving() as behind:
        one = behind.knock(head + b"%x\r\n" % PORTION + b"a" * PORTION + b"\r\n")
        assert await is_served(one)
        one.sendall(b"no number\r\n")
        assert await heard(one) == b""
        await behind.until(lambda: not len(behind.connections))
    assert not caplog.records
