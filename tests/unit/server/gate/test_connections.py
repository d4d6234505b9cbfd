"""Connections of peers, and their eviction."""

from __future__ import annotations

from typing import cast

import pytest

from veilcam_server.gate.protocol import Connections, GateProtocol, Place


class Stub:
    def __init__(self, name: str, gone: list[str]) -> None:
        self.peer, self._name, self._gone = name[0], name, gone

    def abort(self) -> None:
        self._gone.append(self._name)


class Room:
    """Connections by name, and the names of those that were ended."""

    def __init__(self, limit: int) -> None:
        self.connections = Connections(limit, 0, 600.0, 600.0)
        self.gone: list[str] = []

    def fill(self, *names: str) -> None:
        for name in names:
            self.enter(name)

    def enter(self, name: str, place: Place = "unfinished") -> GateProtocol:
        """Enter as the peer that the first letter names."""
        connection = cast(GateProtocol, Stub(name, self.gone))
        assert self.connections.enter(connection)
        self.connections.move(connection, place)
        return connection


def test_oldest_unfinished_has_to_go() -> None:
    room = Room(3)
    room.fill("a1", "a2", "a3", "a4", "a5")
    assert room.gone == ["a1", "a2"]
    assert len(room.connections) == 3
    assert room.connections.dropped["evicted"] == 2


def test_connections_worked_on_stay_and_then_nobody_comes_in() -> None:
    room = Room(2)
    room.enter("a1", "working")
    unfinished = room.enter("a2")
    room.enter("a3", "working")
    assert room.gone == ["a2"]
    refused = cast(GateProtocol, Stub("a4", room.gone))
    assert not room.connections.enter(refused)
    assert room.connections.dropped["refused"] == 1
    room.connections.move(unfinished, "working")  # it left, and stays out
    room.connections.leave(unfinished)
    assert len(room.connections) == 2


def test_unfinished_connection_goes_before_an_idle_one() -> None:
    room = Room(3)
    room.enter("a1", "idle")
    room.enter("a2")
    room.enter("a3", "idle")
    for name in ("a4", "a5"):
        room.enter(name, "working")
    assert room.gone == ["a2", "a1"]


def test_peer_pushes_out_itself() -> None:
    room = Room(4)
    room.fill("b1", "a1", "a2", "a3", "a4", "a5", "a6")
    assert room.gone == ["a1", "a2", "a3"]
    assert room.connections.of == {"a": 3, "b": 1}
    room.enter("b2")
    assert room.gone[-1] == "a4"
    # As many of each: now the oldest of all.
    room.enter("c1")
    assert room.gone[-1] == "b1"


def test_work_makes_no_peer_the_largest() -> None:
    room = Room(4)
    room.enter("a1")
    room.enter("b1", "working")
    room.enter("b2", "working")
    room.fill("a2", "b3")
    assert room.gone == ["a1"]


@pytest.mark.parametrize(
    ("places", "gone"),
    [
        ((), "a1"),  # still the same request
        (("working", "idle"), "a2"),
    ],
)
def test_place_is_taken_up_anew_with_a_new_request(places: tuple[Place, ...], gone: str) -> None:
    room = Room(3)
    first = room.enter("a1")
    room.enter("a2")
    for place in (*places, "unfinished"):
        room.connections.move(first, place)
    room.fill("a3", "a4")
    assert room.gone == [gone]


def test_connection_that_ends_makes_room() -> None:
    room = Room(1)
    for _ in range(3):
        connection = room.enter("a1")
        room.connections.leave(connection)
        room.connections.leave(connection)
        assert len(room.connections) == len(room.connections.of) == 0
    room.enter("a2")
    assert room.gone == []


def test_at_the_end_all_go_but_what_is_worked_on() -> None:
    room = Room(3)
    room.enter("a1")
    room.enter("b1", "idle")
    room.enter("a2", "working")
    room.connections.end_all_but_working()
    assert sorted(room.gone) == ["a1", "b1"]
    assert not room.connections.dropped
    assert not room.connections.make_room()


def test_ended_connection_is_ended_once() -> None:
    room = Room(1)
    connection = room.enter("a1")
    room.connections.drop(connection, "headers")
    room.connections.drop(connection, "body")
    assert room.gone == ["a1"]
    assert room.connections.dropped == {"headers": 1}


def test_one_line_a_minute_tells_of_evictions(capsys: pytest.CaptureFixture[str]) -> None:
    room = Room(1)
    room.fill(*(f"a{number}" for number in range(100)))
    text = capsys.readouterr().out
    assert text.count("connections full") == 1
    assert "peer=a" in text
