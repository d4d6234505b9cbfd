"""``veilcam log`` and ``veilcam verify``."""

from __future__ import annotations

from pathlib import Path

import httpx
import pytest
from tests.unit.client.conftest import Daemon
from tests.unit.client.logs import Log, answer
from tests.unit.client.sealing import Device
from typer.testing import CliRunner

from veilcam_client.cli.main import app
from veilcam_client.wire.log import LogHead, LogRecords

runner = CliRunner()
DEVICE = Device()


def answers(log: Log) -> list[httpx.Response | Exception]:
    said = LogRecords(records=tuple(log.records)), log.head()
    return [httpx.Response(200, content=each.model_dump_json()) for each in said]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "captures.jsonl"


@pytest.mark.usefixtures("url")
def test_log_is_fetched_and_holds(daemon: Daemon, path: Path, tmp_path: Path) -> None:
    daemon.first, head = answers(Log(DEVICE)), tmp_path / "head.json"
    fetched = runner.invoke(app, ["log", str(path), "--head", str(head)])
    assert fetched.exit_code == 0
    assert fetched.stdout == f"10 records more in {path}, up to record 9\n"
    assert [request.url.path for request in daemon.requests] == ["/v1/log", "/v1/log/head"]
    assert LogHead.model_validate_json(head.read_text()).position == 9
    kept = tmp_path / "answer.json"
    kept.write_text(answer(3).model_dump_json())
    given = ["--device", DEVICE.public, "--head", str(head), "--answer", str(kept)]
    verified = runner.invoke(app, ["verify", str(path), *given])
    assert verified.exit_code == 0
    assert verified.stdout.splitlines() == [
        "the camera says: record 4: 2 answers have no record",
        "the camera says: record 8: the camera dropped all before record 2",
        "the answer is that of record 5",
        f"device {DEVICE.public}",
        "10 records, 5 captures: all of it holds",
    ]
    unnamed = runner.invoke(app, ["verify", str(path)])
    assert unnamed.exit_code == 0
    assert unnamed.stdout.splitlines()[-1].endswith("give --device to know that it is yours")


def test_log_that_does_not_hold_has_its_exit_code(path: Path) -> None:
    assert runner.invoke(app, ["verify", str(path)]).exit_code == 13
    lines = Log(DEVICE).lines
    path.write_bytes(b"".join(line + b"\n" for line in [*lines[:3], *lines[4:]]))
    verified = runner.invoke(app, ["verify", str(path)])
    assert verified.exit_code == 17
    assert "wrong: record 4, line 4: record 3 is missing before it" in verified.stdout
    assert verified.stdout.splitlines()[-1] == "9 records, 4 captures: 1 findings"
    path.write_bytes(b"")
    empty = runner.invoke(app, ["verify", str(path)])
    assert (empty.exit_code, "there is no record" in empty.stdout) == (17, True)
    assert "device" not in empty.stdout


@pytest.mark.usefixtures("url")
def test_head_that_cannot_be_written_is_told(daemon: Daemon, path: Path, tmp_path: Path) -> None:
    daemon.first = answers(Log(DEVICE))
    asked = runner.invoke(app, ["log", str(path), "--head", str(tmp_path / "no" / "head")])
    assert asked.exit_code == 2
    assert "cannot write" in asked.stderr
