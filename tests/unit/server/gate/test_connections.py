"""Who has to go for whom."""

from __future__ import annotations

import pytest

from veilcam_server.gate.connections import LOCAL, Connection, Connections, Place, peer_of


class Room:
    """Connections by name, and who was sent away."""

    def __init__(self, limit: int) -> None:
        self.connections = Connections(limit)
        self.gone: list[str] = []

    def fill(self, *names: str) -> None:
        for name in names:
            self.enter(name)

    def enter(self, name: str, place: Place = Place.UNFINISHED) -> Connection:
        """Enter as the peer that the first letter names."""
        connection = self.connections.enter(name[0])
        assert connection is not None
        connection.abort = lambda: self.gone.append(name)
        connection.move(place)
        return connection


def test_oldest_unfinished_has_to_go() -> None:
    room = Room(3)
    room.fill("a1", "a2", "a3", "a4", "a5")
    assert room.gone == ["a1", "a2"]
    assert len(room.connections) == 3
    assert room.connections.dropped["evicted"] == 2


def test_connections_worked_on_stay_and_then_nobody_comes_in() -> None:
    room = Room(2)
    room.enter("a1", Place.WORKING)
    unfinished = room.enter("a2")
    room.enter("a3", Place.WORKING)
    assert room.gone == ["a2"]
    assert room.connections.enter("a") is None
    assert room.connections.dropped["refused"] == 1
    unfinished.move(Place.WORKING)  # it is out, and stays out
    unfinished.leave()
    assert len(room.connections) == 2


def test_unfinished_connection_goes_before_an_idle_one() -> None:
    room = Room(3)
    room.enter("a1", Place.IDLE)
    room.enter("a2")
    room.enter("a3", Place.IDLE)
    for name in ("a4", "a5"):
        room.enter(name, Place.WORKING)
    assert room.gone == ["a2", "a1"]


def test_peer_pushes_out_itself() -> None:
    room = Room(4)
    room.fill("b1", "a1", "a2", "a3", "a4", "a5", "a6")
    assert room.gone == ["a1", "a2", "a3"]
    assert (room.connections.of("a"), room.connections.of("b")) == (3, 1)
    room.enter("b2")
    assert room.gone[-1] == "a4"
    # As many of each: now the oldest of all.
    room.enter("c1")
    assert room.gone[-1] == "b1"


def test_work_makes_no_peer_the_largest() -> None:
    room = Room(4)
    room.enter("a1")
    room.enter("b1", Place.WORKING)
    room.enter("b2", Place.WORKING)
    room.fill("a2", "b3")
    assert room.gone == ["a1"]


@pytest.mark.parametrize(
    ("places", "gone"),
    [
        ((), "a1"),  # still the same request
        ((Place.WORKING, Place.IDLE), "a2"),
    ],
)
def test_place_is_taken_up_anew_with_a_new_request(places: tuple[Place, ...], gone: str) -> None:
    room = Room(3)
    first = room.enter("a1")
    room.enter("a2")
    for place in (*places, Place.UNFINISHED):
        first.move(place)
    room.fill("a3", "a4")
    assert room.gone == [gone]


def test_connection_that_ends_makes_room() -> None:
    room = Room(1)
    for _ in range(3):
        connection = room.enter("a1")
        connection.leave()
        connection.leave()
        assert len(room.connections) == room.connections.of("a") == 0
    room.enter("a2")
    assert room.gone == []


def test_at_the_end_all_go_but_what_is_worked_on() -> None:
    room = Room(3)
    room.enter("a1")
    room.enter("b1", Place.IDLE)
    room.enter("a2", Place.WORKING)
    room.connections.end_all_but_working()
    assert sorted(room.gone) == ["a1", "b1"]
    assert not room.connections.dropped
    assert not room.connections.make_room()


def test_ended_connection_is_not_referred_to_any_more() -> None:
    # It refers to its connection in turn: a circle of 300 kB where there is TLS.
    room = Room(1)
    connection = room.enter("a1")
    connection.drop("headers")
    assert room.gone == ["a1"]
    connection.drop("headers")
    connection.end()
    assert room.gone == ["a1"]


def test_one_line_a_minute_tells_of_evictions(capsys: pytest.CaptureFixture[str]) -> None:
    room = Room(1)
    room.fill(*(f"a{number}" for number in range(100)))
    text = capsys.readouterr().out
    assert text.count("connections full") == 1
    assert "peer=a" in text


@pytest.mark.parametrize(
    ("address", "peer"),
    [
        (("192.0.2.1", 1), "192.0.2.1"),
        (("2001:db8:1:2:3::4", 1, 0, 0), "2001:db8:1:2::/64"),
        (("2001:db8:1:2:ffff::", 1, 0, 0), "2001:db8:1:2::/64"),
        (("fe80::1%eth0", 1, 0, 2), "fe80::/64"),
        (("::ffff:192.0.2.1", 1, 0, 0), "192.0.2.1"),
        ("", LOCAL),
        (b"\0abstract", LOCAL),
    ],
)
def test_names_of_peers(address: object, peer: str) -> None:
    assert peer_of(address) == peer
