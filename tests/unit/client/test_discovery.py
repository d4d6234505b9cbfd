"""Cameras that announce themselves; on this machine alone."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

import pytest
import zeroconf
from typer.testing import CliRunner

from veilcam_client import Camera, FoundCamera, VeilcamError
from veilcam_client.cli.main import app
from veilcam_client.discovery import TYPE, _camera, discover

HERE = ["127.0.0.1"]
runner = CliRunner()


def info(
    name: str = "Hall",
    server: str = "hall.local.",
    port: int = 8787,
    told: Mapping[str, str] | None = None,
) -> zeroconf.ServiceInfo:
    told = {"api": "v1", "scheme": "https"} if told is None else told
    here: dict[str, Any] = {"addresses": [b"\x7f\0\0\1"], "properties": dict(told)}
    return zeroconf.ServiceInfo(TYPE, f"{name}.{TYPE}", port, server=server, **here)


@pytest.mark.slow
def test_camera_that_announces_itself_is_found() -> None:
    with zeroconf.Zeroconf(HERE, ip_version=zeroconf.IPVersion.V4Only) as network:
        for each in (info("Hall"), info("Door", "door.local.", 9000)):
            network.register_service(each)
        found = discover(1.5, HERE)
    assert found == (
        FoundCamera("Door", "https://door.local:9000"),
        FoundCamera("Hall", "https://hall.local:8787"),
    )


@pytest.mark.parametrize(
    "announcement",
    [
        info(told={}),
        info(told={"api": "v2", "scheme": "https"}),
        info(told={"api": "v1", "scheme": "file"}),
        info(port=0),
        info(server="hall.local@elsewhere.example."),
        info(server="-."),
    ],
)
def test_announcement_of_no_camera_is_left_out(announcement: zeroconf.ServiceInfo) -> None:
    assert _camera(announcement) is None
    # A name says nothing to a terminal.
    found = _camera(info("Hall\x9b2J"))
    assert found == FoundCamera("Hall2J", "https://hall.local:8787")


def test_extra_is_named_where_it_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "zeroconf", None)
    with pytest.raises(VeilcamError, match="discover"):
        Camera.discover()
    result = runner.invoke(app, ["discover"])
    assert result.exit_code == 1
    assert "pip install -e '.[discover]'" in result.stderr


def test_discover_command_prints_a_line_for_each(monkeypatch: pytest.MonkeyPatch) -> None:
    hall = FoundCamera("Hall", "https://hall.local:8787")
    as_json = '{"name": "Hall", "url": "https://hall.local:8787"}\n'
    for found, words, lines in (
        ((), "no camera announces itself here\n", ""),
        ((hall,), "https://hall.local:8787  Hall\n", as_json),
    ):
        monkeypatch.setattr("veilcam_client.camera.discover", lambda _, found=found: found)
        assert runner.invoke(app, ["discover"]).stdout == words
        assert runner.invoke(app, ["discover", "--json"]).stdout == lines
