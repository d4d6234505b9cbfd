"""The command ``veilcam receiver``, and what ``--key`` opens."""

from __future__ import annotations

import json
from pathlib import Path

import httpx
import numpy as np
import pytest
from tests.unit.client.conftest import Daemon
from tests.unit.client.sealing import VALUES, Device, Epoch
from typer.testing import CliRunner

from veilcam_client.cli.main import app
from veilcam_client.keys.receivers import Receiver, ReceiverKey

pytestmark = pytest.mark.usefixtures("url")
runner = CliRunner()


def test_keygen_writes_one_half_and_prints_the_other(tmp_path: Path) -> None:
    path = tmp_path / "key"
    made = runner.invoke(app, ["receiver", "keygen", str(path)])
    assert made.exit_code == 0
    assert Receiver.parse(made.stdout.strip()) == ReceiverKey.read(path).public
    again = runner.invoke(app, ["receiver", "keygen", str(path)])
    assert again.exit_code == 2
    assert "exists and was left alone" in again.stderr


@pytest.mark.parametrize("given", ["line", "file"])
def test_add_sends_the_public_half_and_prints_what_to_pin(
    daemon: Daemon, receiver: ReceiverKey, tmp_path: Path, given: str
) -> None:
    line, file = str(receiver.public), tmp_path / "key.pub"
    file.write_text(f"{line}\n")
    key = line if given == "line" else str(file)
    added = runner.invoke(app, ["receiver", "add", key, "--label", "archive"])
    assert added.exit_code == 0
    assert added.stdout == f"{'d7' * 32}\n"
    assert json.loads(daemon.requests[0].content) == {"label": "archive", "key": line}


def test_list_and_remove(daemon: Daemon) -> None:
    listed = runner.invoke(app, ["receiver", "list"]).stdout.splitlines()
    assert listed[0] == "abababababababab  since 2026-01-02  archive"
    assert listed[1].endswith("a tablet")
    removed = runner.invoke(app, ["receiver", "remove", "ab" * 8])
    assert removed.stdout == f"removed {'ab' * 32}\n"
    assert daemon.requests[-1].url.path == f"/v1/receivers/{'ab' * 32}"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["remove", "abababab"], "2 receivers begin with 'abababab'"),
        (["remove", "00000000"], "0 receivers begin with"),
        (["remove", "abababa"], "is too short: give 8 digits"),
        (["add", "veilcam-receiver:c2VhbGVk", "--label", "a"], "this is no receiver's key"),
        (["add", "no such file", "--label", "a"], "cannot be read: No such file"),
    ],
)
def test_receiver_that_is_meant_must_be_clear(
    daemon: Daemon, arguments: list[str], message: str
) -> None:
    result = runner.invoke(app, ["receiver", *arguments])
    assert result.exit_code == 2
    assert message in result.stderr
    assert result.stderr.count("\n") == 1
    assert all(request.method == "GET" for request in daemon.requests)


def test_private_key_is_never_sent_or_repeated(
    daemon: Daemon, receiver: ReceiverKey, tmp_path: Path
) -> None:
    path = tmp_path / "key"
    receiver.write(path)
    private = path.read_text().strip()
    for key in (private, str(path)):
        result = runner.invoke(app, ["receiver", "add", key, "--label", "archive"])
        assert result.exit_code == 2
        assert private not in result.output
    assert daemon.requests == []


def test_key_opens_what_is_captured(daemon: Daemon, receiver: ReceiverKey, tmp_path: Path) -> None:
    device, out, key = Device(), tmp_path / "e.npy", tmp_path / "key"
    receiver.write(key)
    epoch = Epoch(device, receiver)

    def capture(*options: str, number: int) -> tuple[int, str]:
        told = epoch.capture(number).model_dump_json()
        daemon.first = [httpx.Response(200, text=told)]
        result = runner.invoke(app, ["capture", *options])
        return result.exit_code, result.output

    assert capture(number=0) == (0, f"1  epoch {epoch.name}  2 x 3 sealed\n")
    code, said = capture("--out", str(out), number=1)
    assert (code, out.exists()) == (7, False)
    assert "Camera(key=...)" in said
    opened = capture("--key", str(key), "--out", str(out), number=2)
    assert opened == (0, f"1  epoch {epoch.name}  2 x 3 raw  mean 2.5\n")
    assert np.array_equal(np.load(out), VALUES)
    assert capture("--key", str(key), "--device", device.public, number=3)[0] == 0
    assert capture("--key", str(key), "--device", "ab" * 32, number=4)[0] == 7
    assert capture("--key", str(tmp_path / "missing"), number=5)[0] == 2
    assert capture("--device", device.public, number=6)[0] == 2
