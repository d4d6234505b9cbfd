"""The command ``veilcam`` against a canned daemon on a real socket."""

from __future__ import annotations

import json
import socket
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
from tests.unit.client.conftest import CLASSIFICATION, STATUS, TOKEN, Daemon, events
from typer.testing import CliRunner

from veilcam_client.cli.format import status_in_words
from veilcam_client.cli.main import app
from veilcam_client.wire.status import example_status

pytestmark = pytest.mark.usefixtures("url")
runner = CliRunner()


@pytest.mark.parametrize(
    ("arguments", "shown"),
    [
        (["status"], ["ready", "ST7735R", "2 x 3", "5 masks", "every 3 captures", "e1"]),
        (["status"], ["raw, 100 a mask at most", f"key       {'d7' * 32}"]),
        (["status"], ["abababababababab  since 2026-01-02  archive"]),
        (["capture"], ["c1", "epoch e1", "2 x 3 raw  mean 2.583"]),
        (["classify"], ["7", "90.0 %", "epoch e1"]),
        (["rotate"], ["every 3 captures", "e1"]),
        (["rotate", "--off"], ["every 3 captures"]),
        (["watch"], ["looks 2/s, not between 22:00 and 07:00", ": looking"]),
        (["watch"], ["now  3  99.8 %  for 12.5 s", "03:04:05  3  99.8 %  12.5 s, and still there"]),
        (["token", "list"], ["0123456789ab", "until it is revoked", "2026-01-03", "a lamp"]),
        (["token", "create", "--label", "a lamp", "--scope", "classify"], ["vc_0123456789ab_5"]),
        (["token", "create", "--label", "me", "--role", "owner"], ["vc_0123456789ab_5"]),
        (["token", "list"], ["viewer"]),
        (["token", "revoke", "0123456789ab"], ["revoked 0123456789ab"]),
        (["bundle", "list"], ["* cdcdcdcdcdcd", "damaged  configured", "fashion, 5 masks"]),
        (["bundle", "activate", "ab"], ["* abababababab      2.3 MB"]),
        (["bundle", "remove", "ab"], ["* cdcdcdcdcdcd"]),
        (["diagnostics"], ["veilcam 0.1.0", "callers 16"]),
        (["diagnostics"], ["1200 capture", "sensor_failed: no frame"]),
    ],
)
def test_answers_are_shown(arguments: list[str], shown: list[str]) -> None:
    result = runner.invoke(app, arguments)
    assert result.exit_code == 0
    for text in shown:
        assert text in result.stdout


@pytest.mark.parametrize(
    ("options", "pages", "asked"),
    [
        # All of them, however many answers that takes.
        ([], "ab cd e", ["limit=100", "limit=100&after=b", "limit=100&after=d"]),
        (["--limit", "1"], "a", ["limit=1"]),
        (["--limit", "150"], "ab cd", ["limit=100", "limit=50&after=b"]),
        (["--after", "b"], "cd e", ["limit=100&after=b", "limit=100&after=d"]),
    ],
)
def test_tokens_are_listed_over_several_answers(
    daemon: Daemon, options: list[str], pages: str, asked: list[str]
) -> None:
    for ids in pages.split():
        told = [{**TOKEN, "id": name} for name in ids]
        follows = None if ids == "e" else ids[-1]
        daemon.first.append(httpx.Response(200, json={"tokens": told, "next": follows}))
    listed = runner.invoke(app, ["token", "list", *options]).stdout.splitlines()
    assert [line[0] for line in listed[::2]] == list(pages.replace(" ", ""))
    assert [request.url.query.decode() for request in daemon.requests] == asked


def test_status_tells_of_fresh_masks_that_come_late(daemon: Daemon) -> None:
    status = json.loads(json.dumps(STATUS))
    status["bundle"].update(mode="fresh", pairs=0)
    status["rotation"]["policy"] = {"mode": "seconds", "seconds": 9.0, "jitter": 2.0, "reuse": 5}
    status["rotation"]["preparation"].update(ready=False, late=2, reused=7)
    daemon.first = [httpx.Response(200, json=status)]
    shown = runner.invoke(app, ["status"]).stdout
    assert "fresh masks" in shown
    assert "every 9 s, up to 2 s less, or 5 more when late" in shown
    assert "not ready; late 2 times, 7 captures reused a mask" in shown


@pytest.mark.parametrize("command", ["status", "capture", "classify", "rotate"])
def test_answers_are_json_when_asked_for(command: str) -> None:
    result = runner.invoke(app, [command, "--json"])
    assert result.exit_code == 0
    assert json.loads(result.stdout)


@pytest.mark.parametrize(
    ("command", "route", "body"),
    [
        ("rotate", "POST rotation/advance", None),
        ("rotate --off", "PUT rotation", {"mode": "off"}),
        (
            "rotate --every-seconds 2 --jitter 0.5",
            *("PUT rotation", {"mode": "seconds", "seconds": 2.0, "jitter": 0.5, "reuse": 0}),
        ),
        (
            "rotate --every-captures 9 --reuse 4",
            *("PUT rotation", {"mode": "captures", "captures": 9, "reuse": 4}),
        ),
        ("watch", "GET watch", None),
        ("watch --off", "PUT watch", {"mode": "off"}),
        ("watch --on-request", "PUT watch", {"mode": "on_request", "quiet": None}),
        (
            "watch --rate 30/min --quiet-hours 22-7",
            "PUT watch",
            {"mode": "watching", "rate_hz": 0.5, "quiet": {"begin": "22:00", "end": "07:00"}},
        ),
    ],
)
def test_rotate_and_watch_ask_for_what_they_were_told(
    daemon: Daemon, command: str, route: str, body: Any
) -> None:
    assert runner.invoke(app, command.split()).exit_code == 0
    request = daemon.requests[-1]
    assert f"{request.method} {request.url.path[4:]}" == route
    assert (json.loads(request.content) if request.content else None) == body


def test_capture_writes_an_array(tmp_path: Path) -> None:
    out = tmp_path / "e.npy"
    assert runner.invoke(app, ["capture", "--out", str(out)]).exit_code == 0
    assert np.load(out).tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.5]]
    result = runner.invoke(app, ["capture", "--out", str(tmp_path / "no" / "e.npy")])
    assert result.exit_code == 2
    assert "cannot write" in result.stderr


def test_label_without_scores_is_shown_alone(daemon: Daemon) -> None:
    alone = {**CLASSIFICATION, "confidence": None, "scores": None}
    daemon.first = [httpx.Response(200, json=alone)]
    assert runner.invoke(app, ["classify"]).stdout == "7  epoch e1\n"


def test_remedy_is_said_where_it_is_known() -> None:
    example = example_status()
    assert "remedy" not in status_in_words(example)
    safe = example.model_copy(update={"state": "safe", "remedy": "check_panel_wiring"})
    assert "\nremedy    check_panel_wiring\n" in status_in_words(safe)


@pytest.mark.parametrize("as_json", [True, False])
def test_event_is_printed_on_one_line(daemon: Daemon, *, as_json: bool) -> None:
    told: list[tuple[str, dict[str, Any], str]] = [
        ("state", {"state": "safe", "detail": "dead", "remedy": "restart"}, "remedy: restart"),
        ("mask", {"epoch": "e1"}, "e1"),
        ("capture", {"capture": "c1", "epoch": "e1"}, "e1"),
        ("classification", {"capture": "c", "epoch": "e", "label": "7"}, "7  epoch e"),
        ("rotation", {"policy": {"mode": "off"}}, "off"),
        ("fault", {"code": "x", "detail": "no", "remedy": "restart"}, "no  remedy: restart"),
        ("gap", {"missed": 4}, "4 events"),
        ("gap", {"missed": None}, "restarted"),
    ]
    daemon.first = [events(*({"kind": kind, **fields} for kind, fields, _ in told))]
    done = runner.invoke(app, ["events", "--count", "8", *(["--json"] if as_json else [])])
    assert done.exit_code == 0
    for line, (kind, _, word) in zip(done.stdout.splitlines(), told, strict=True):
        assert json.loads(line)["kind"] == kind if as_json else word in line


def test_daemon_that_gives_no_answer_has_its_exit_code(url: str, daemon: Daemon) -> None:
    daemon.first = [httpx.Response(200, text="hello")]
    with socket.create_server(("127.0.0.1", 0)) as silent:
        listening = f"http://127.0.0.1:{silent.getsockname()[1]}"
        for address, code in ((url, 6), (listening, 3), ("http://127.0.0.1:1", 3)):
            result = runner.invoke(app, ["status", "--url", address, "--timeout", "0.2"])
            assert result.exit_code == code
    assert "is veilcamd running there?" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["status", "--url", "nonsense"], "use http://HOST:PORT"),
        (["status", "--timeout", "0"], "read_timeout"),
        (["rotate", "--every-seconds", "0"], "--every-seconds 0.0: should be greater"),
        (["rotate", "--every-captures", "0"], "--every-captures 0: should be greater"),
        (["rotate", "--off", "--every-captures", "2"], "give one of"),
        (["rotate", "--jitter", "1"], "--jitter goes with --every-seconds"),
        (["rotate", "--reuse", "1"], "--reuse goes with"),
        (["watch", "--off", "--rate", "2/s"], "give one of"),
        (["watch", "--off", "--quiet-hours", "22-7"], "--quiet-hours goes with"),
        (["watch", "--rate", "often"], "'often' is no rate: use 2/s"),
        (["watch", "--on-request", "--quiet-hours", "late"], "'late' are no hours: use 22-7"),
        (["rotate", "--every-captures", "1", "--reuse", "-1"], "--reuse -1: should be greater"),
        (["rotate", "--every-seconds", "1", "--jitter", "1"], "jitter 1 s leaves a mask less"),
    ],
)
def test_bad_usage_is_one_line_and_exit_code_2(arguments: list[str], message: str) -> None:
    result = runner.invoke(app, arguments)
    assert result.exit_code == 2
    assert message in result.stderr
    assert result.stderr.count("\n") == 1
