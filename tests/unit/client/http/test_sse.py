"""Server-sent events, from bytes to messages."""

from __future__ import annotations

import pytest

from veilcam_client import ProtocolError
from veilcam_client.http.sse import MAX_EVENT, Decoder, Message


@pytest.mark.parametrize("size", [1, 2, 7, 1000])
def test_events_are_read_whatever_the_pieces(size: int) -> None:
    text = (
        b": comment\r\n\r\nretry: 5\nevent: a\nid: 1\ndata: x\ndata:  y\n\n"
        b"data: \xc3\xa9\xe2\x80\xa8z\r\n\r\nid: 2\n\nevent: b\n\ndata\n\n"
        b"id: 3\x00\ndata: w\n\ndata: \xff\n\nda"
    )
    decoder = Decoder()
    pieces = [text[start : start + size] for start in range(0, len(text), size)]
    found = [message for piece in pieces for message in decoder.feed(piece)]
    assert found == [
        Message("a", "x\n y", "1"),
        Message("message", "\u00e9\u2028z", "1"),
        Message("message", "", "2"),
        Message("message", "w", "2"),
        Message("message", "\ufffd", "2"),
    ]


@pytest.mark.parametrize("piece", [b"x" * 4096, b": comment\n" * 400, b"data: 1\n" * 400])
def test_event_without_an_end_is_refused(piece: bytes) -> None:
    pieces = [piece] * (2 * MAX_EVENT // len(piece))
    decoder = Decoder()
    with pytest.raises(ProtocolError, match="an event of more than 1 MiB"):
        [list(decoder.feed(piece)) for piece in pieces]


def test_many_short_events_are_not_one_long_one() -> None:
    decoder = Decoder()
    for end in (b"\n\n", b"\r\n\r\n"):
        for _ in range(2 * MAX_EVENT // 4096):
            assert len(list(decoder.feed(b"data: " + b"x" * 4096 + end))) == 1
