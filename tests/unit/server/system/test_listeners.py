"""Where the daemon listens, and what it leaves alone."""

from __future__ import annotations

import os
import resource
import socket
from pathlib import Path

import pytest

from veilcam_server.errors import StartError
from veilcam_server.settings import Settings
from veilcam_server.system import listeners
from veilcam_server.system.listeners import (
    BACKLOG,
    RESERVE,
    Listening,
    open_listeners,
    peer_of,
    require_free,
    room_for,
)


def test_listener_elsewhere_is_left_alone(tmp_path: Path, bundle_file: Path) -> None:
    def refused(reason: str, **more: object) -> None:
        settings = Settings(bundle=bundle_file, **more)  # type: ignore[arg-type]
        with pytest.raises(StartError, match=reason), open_listeners(settings):
            pass

    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        refused(f"port {port} is occupied: .* --port", port=port)
    path = tmp_path / "v.sock"
    with socket.socket(socket.AF_UNIX) as unix:
        unix.bind(str(path))
        unix.listen()
        refused(r"is occupied: .* --socket", socket=path)
        assert path.exists()
    path.unlink()
    path.write_text("a file")
    refused("there is a file of that name", socket=path)
    assert path.read_text() == "a file"
    refused("cannot listen", socket=tmp_path / "no" / "folder")


def test_answers_do_not_wait_for_acknowledgements(bundle_file: Path) -> None:
    with open_listeners(Settings(bundle=bundle_file, port=0)) as [listener]:
        # asyncio sets TCP_NODELAY on accepted sockets of exactly this protocol.
        assert listener.socket.proto == socket.IPPROTO_TCP
        assert listener.url == f"http://127.0.0.1:{listener.socket.getsockname()[1]}"


@pytest.mark.parametrize(
    ("urls", "hosts", "place"),
    [
        (("unix:///run/api.sock", "http://127.0.0.1:8787"), (), "127.0.0.1:8787"),
        (("unix:///run/api.sock",), (), "/run/api.sock"),
        (("https://192.0.2.7:8787",), ("camera.example",), "192.0.2.7:8787"),
        (("https://[::1]:8787",), (), "[::1]:8787"),
        (("https://0.0.0.0:8787",), ("camera.example:443", "b.example"), "camera.example:8787"),
        (("https://[::]:8787",), (), "198.51.100.4:8787"),
    ],
)
def test_line_leads_to_a_place_that_other_machines_reach(
    urls: tuple[str, ...], hosts: tuple[str, ...], place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(listeners, "_own_address", lambda: "198.51.100.4")
    assert Listening(urls=urls, hosts=hosts, certificate=None, pairs=True).place == place


def test_socket_of_its_own_is_removed(bundle_file: Path, tmp_path: Path) -> None:
    path = tmp_path / "v.sock"
    with open_listeners(Settings(bundle=bundle_file, socket=path)) as [listener]:
        assert listener.url == f"unix://{path}"
        assert path.exists()
    assert not path.exists()


@pytest.mark.parametrize(
    ("family", "address", "reason"),
    [
        (socket.AF_INET, ("0.0.0.0", 0), r"a socket on 0\.0\.0\.0, and other machines"),
        (socket.AF_UNIX, f"\0veilcam-test-{os.getpid()}", "which any user may open"),
    ],
    ids=["network", "abstract"],
)
def test_systemd_may_not_open_the_camera_to_others(
    family: int,
    address: str | tuple[str, int],
    reason: str,
    bundle_file: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    passed = socket.socket(family)
    passed.bind(address)
    passed.listen()
    monkeypatch.setattr(listeners, "take_sockets", lambda: [passed])
    with pytest.raises(StartError, match=reason), open_listeners(Settings(bundle=bundle_file)):
        pass
    assert passed.fileno() == -1  # closed


def test_no_tls_on_a_unix_socket(
    bundle_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with socket.socket(socket.AF_UNIX) as passed:
        passed.bind(str(tmp_path / "api.sock"))
        passed.listen()
        monkeypatch.setattr(listeners, "take_sockets", lambda: [passed])
        settings = Settings(bundle=bundle_file, tls_certificate=Path("c"), tls_key=Path("k"))
        with pytest.raises(StartError, match="needs no TLS"), open_listeners(settings):
            pass


def test_place_that_is_free_is_left_free(
    bundle_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "api.sock"
    settings = Settings(device="simulated", bundle=bundle_file, socket=place)
    require_free(settings)
    assert not place.exists()
    with open_listeners(settings), pytest.raises(StartError, match="is occupied"):
        require_free(settings)
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        occupied = Settings(device="simulated", bundle=bundle_file, port=port)
        with pytest.raises(StartError, match=f"port {port} is occupied"):
            require_free(occupied)
        # What systemd passes comes first, so the settings' own place is nobody's concern.
        monkeypatch.setenv("LISTEN_FDS", "1")
        require_free(occupied)


@pytest.mark.parametrize(
    ("address", "peer"),
    [
        (("192.0.2.1", 1), "192.0.2.1"),
        (("2001:db8:1:2:3::4", 1, 0, 0), "2001:db8:1:2::/64"),
        (("2001:db8:1:2:ffff::", 1, 0, 0), "2001:db8:1:2::/64"),
        (("fe80::1%eth0", 1, 0, 2), "fe80::/64"),
        (("::ffff:192.0.2.1", 1, 0, 0), "192.0.2.1"),
        ("", "local socket"),
        (b"\0abstract", "local socket"),
    ],
)
def test_peer_is_named_by_its_address(address: object, peer: str) -> None:
    assert peer_of(address) == peer


class Limits:
    def __init__(self, soft: int, hard: int) -> None:
        self.soft, self.hard = soft, hard

    def get(self, _: int) -> tuple[int, int]:
        return self.soft, self.hard

    def set(self, _: int, limits: tuple[int, int]) -> None:
        self.soft, self.hard = limits


@pytest.mark.parametrize(
    ("soft", "hard", "room", "raised"),
    [
        (8192, 8192, (256, BACKLOG), 8192),
        (1024, 524288, (256, BACKLOG), 256 + BACKLOG + RESERVE),
        (1024, resource.RLIM_INFINITY, (256, BACKLOG), 256 + BACKLOG + RESERVE),
        (resource.RLIM_INFINITY, resource.RLIM_INFINITY, (256, BACKLOG), -1),
        (1024, 1024, (256, 1024 - RESERVE - 256), 1024),
        (256, 256, (96, 32), 256),
        (100, 100, (37, 13), 100),
    ],
)
def test_room_follows_the_limits_of_open_files(
    monkeypatch: pytest.MonkeyPatch, soft: int, hard: int, room: tuple[int, int], raised: int
) -> None:
    limits = Limits(soft, hard)
    monkeypatch.setattr(resource, "getrlimit", limits.get)
    monkeypatch.setattr(resource, "setrlimit", limits.set)
    assert room_for(256) == room
    assert (limits.soft, limits.hard) == (raised, hard)


def test_room_that_is_less_than_asked_for_is_logged(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(resource, "getrlimit", Limits(256, 256).get)
    monkeypatch.setattr(resource, "setrlimit", Limits(256, 256).set)
    room_for(96)
    assert "few files" not in capsys.readouterr().out
    room_for(97)
    assert "few files may be open" in capsys.readouterr().out
