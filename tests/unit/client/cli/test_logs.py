"""``veilcam log`` and ``veilcam verify``."""

from __future__ import annotations

from pathlib import Path

import httpx
import pytest
from tests.unit.client.conftest import Daemon
from tests.unit.client.logs import LIFE, Log, answer, event
from tests.unit.client.sealing import NOTES, Device
from typer.testing import CliRunner

from veilcam_client.cli.main import app
from veilcam_client.wire.log import LogRecords

runner = CliRunner()
DEVICE = Device()


def answers(log: Log) -> list[httpx.Response | Exception]:
    said = LogRecords(records=tuple(log.records))
    return [httpx.Response(200, content=said.model_dump_json())]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "captures.jsonl"


@pytest.mark.usefixtures("url")
def test_log_is_fetched_and_holds(daemon: Daemon, path: Path, tmp_path: Path) -> None:
    daemon.first, head = answers(Log(DEVICE)), tmp_path / "head.json"
    fetched = runner.invoke(app, ["log", str(path)])
    assert fetched.exit_code == 0
    assert fetched.stdout == f"10 records more in {path}\n"
    assert [request.url.path for request in daemon.requests] == ["/v1/log"]
    head.write_bytes(path.read_bytes().splitlines()[-1])
    kept = tmp_path / "answer.json"
    kept.write_text(answer(3).model_dump_json())
    given = ["--device", DEVICE.public, "--head", str(head), "--answer", str(kept)]
    verified = runner.invoke(app, ["verify", str(path), *given])
    assert verified.exit_code == 0
    assert verified.stdout.splitlines() == [
        "the camera says: record 4: gap, entries 2",
        "the camera says: record 8: dropped, before 2",
        "the answer is that of record 5",
        f"device {DEVICE.public}",
        "10 records, 5 captures: all of it holds",
    ]
    unnamed = runner.invoke(app, ["verify", str(path)])
    assert unnamed.exit_code == 0
    assert unnamed.stdout.splitlines()[-1].endswith("give --device to know that it is yours")


def test_log_that_does_not_hold_has_its_exit_code(path: Path) -> None:
    assert runner.invoke(app, ["verify", str(path)]).exit_code == 2
    lines = Log(DEVICE).lines
    path.write_bytes(b"".join(line + b"\n" for line in [*lines[:3], *lines[4:]]))
    verified = runner.invoke(app, ["verify", str(path)])
    assert verified.exit_code == 7
    assert "wrong: record 4, line 4: record 3 is missing before it" in verified.stdout
    assert verified.stdout.splitlines()[-1] == "9 records, 4 captures: 1 findings"
    path.write_bytes(b"")
    empty = runner.invoke(app, ["verify", str(path)])
    assert (empty.exit_code, "there is no record" in empty.stdout) == (7, True)
    assert "device" not in empty.stdout


@pytest.mark.usefixtures("url")
def test_log_is_printed_the_newest_last_and_controls_no_terminal(daemon: Daemon) -> None:
    path = "GET /\x1b[2J\u202e\u00e9"
    daemon.first = answers(Log(DEVICE, (LIFE[1], event("refused", action=path, status=401))))
    printed = runner.invoke(app, ["log", "--last", "2"])
    assert printed.exit_code == 0
    assert dict(daemon.requests[0].url.params) == {"limit": "2", "newest": "true"}
    capture, refused = printed.stdout.splitlines()
    assert capture.startswith("     0  2026-01-02 03:04:05  capture   epoch 9f9f")
    assert "\x1b" not in refused
    assert refused.endswith(
        r"refused   action GET /\x1b[2J\u202e\u00e9  status 401".replace(r"\u00e9", "\u00e9")
    )


def test_files_that_cannot_be_used_are_named(path: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.json"

    def said(*options: str) -> str:
        refused = runner.invoke(app, ["verify", str(path), *options])
        assert refused.exit_code == 2
        return refused.stderr

    assert "captures.jsonl cannot be read" in said()
    path.write_bytes(b"".join(line + b"\n" for line in Log(DEVICE).lines))
    for option in ("--head", "--answer"):
        assert "other.json cannot be read" in said(option, str(other))
    other.write_text("{}")
    assert "other.json holds something else" in said("--answer", str(other))
    for kept, why in (
        (answer(1).model_copy(update={"notes": NOTES}), "was opened"),
        (answer(1).model_copy(update={"id": "c0ffee"}), "hides nothing"),
    ):
        other.write_text(kept.model_dump_json())
        assert why in said("--answer", str(other))
