"""The command ``veilcam`` against a canned daemon on a real socket."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import numpy as np
import pytest
from typer.testing import CliRunner

from veilcam_client.cli.format import status_in_words
from veilcam_client.cli.main import app
from veilcam_client.wire.status import example_status

if TYPE_CHECKING:
    from tests.unit.client.conftest import Daemon, Problem

runner = CliRunner()


@pytest.mark.usefixtures("url")
@pytest.mark.parametrize(
    ("arguments", "shown"),
    [
        (["status"], ["ready", "ST7735R", "2 x 3", "5 masks", "every 3 captures", "e1"]),
        (
            ["status"],
            [
                "raw, 100 a mask at most",
                f"key       {'d7' * 32}",
                "abababababababab  since 2026-01-02  archive",
            ],
        ),
        (["capture"], ["c1", "epoch e1", "2 x 3 raw  mean 2.583"]),
        (["classify"], ["7", "90.0 %", "epoch e1"]),
        (["rotate"], ["every 3 captures", "e1"]),
        (["rotate", "--off"], ["every 3 captures"]),
        (
            ["look"],
            [
                "looks 2/s, not between 22:00 and 07:00: looking",
                "now  3  99.8 %  for 12.5 s",
                "2026-01-02 03:04:05  3  99.8 %  12.5 s, and still there",
            ],
        ),
        (["token", "list"], ["0123456789ab", "until it is revoked", "2026-01-03", "a lamp"]),
        (["token", "create", "--label", "a lamp", "--scope", "classify"], ["vc_0123456789ab_5"]),
        (["token", "revoke", "0123456789ab"], ["revoked 0123456789ab"]),
        (
            ["bundle", "list"],
            ["* cdcdcdcdcdcd", "damaged  configured", "  abab", "fashion, 5 masks"],
        ),
        (["bundle", "activate", "ab"], ["* abababababab      2.3 MB"]),
        (["bundle", "remove", "ab"], ["* cdcdcdcdcdcd"]),
        (["diagnostics"], ["veilcam 9.9", "queue_limit 8", "5 capture", "sensor_failed: no frame"]),
    ],
)
def test_answers_are_shown(arguments: list[str], shown: list[str]) -> None:
    result = runner.invoke(app, arguments)
    assert result.exit_code == 0
    for text in shown:
        assert text in result.stdout


@pytest.mark.usefixtures("url")
@pytest.mark.parametrize(
    ("options", "asked", "shown"),
    [
        # All of them, however many answers that takes.
        ([], ["limit=100", "limit=100&after=b", "limit=100&after=d"], "abcde"),
        (["--limit", "1"], ["limit=1"], "a"),
        (["--limit", "150"], ["limit=100", "limit=50&after=b"], "abcd"),
        (["--after", "b"], ["limit=100&after=b", "limit=100&after=d"], "cde"),
    ],
)
def test_tokens_are_listed_over_several_answers(
    daemon: Daemon, answers: dict[str, Any], *, options: list[str], asked: list[str], shown: str
) -> None:
    token = answers["token"]
    pages = [("ab", "b"), ("cd", "d"), ("e", None)]
    if "--after" in options:
        pages = pages[1:]
    if options == ["--limit", "1"]:
        pages = [("a", "a")]
    daemon.first = [
        httpx.Response(
            200, json={"tokens": [{**token, "id": name} for name in ids], "next": follows}
        )
        for ids, follows in pages
    ]
    result = runner.invoke(app, ["token", "list", *options])
    assert [line[0] for line in result.stdout.splitlines()[::2]] == list(shown)
    assert [request.url.query.decode() for request in daemon.requests] == asked


@pytest.mark.usefixtures("url")
def test_status_tells_of_fresh_masks_that_come_late(
    daemon: Daemon, answers: dict[str, Any]
) -> None:
    status = json.loads(json.dumps(answers["status"]))
    status["bundle"].update(mode="fresh", pairs=0)
    status["rotation"]["policy"] = {"mode": "seconds", "seconds": 9.0, "jitter": 2.0, "reuse": 5}
    status["rotation"]["preparation"].update(ready=False, late=2, reused=7)
    daemon.first = [httpx.Response(200, json=status)]
    shown = runner.invoke(app, ["status"]).stdout
    assert "fresh masks" in shown
    assert "every 9 s, up to 2 s less, or 5 more when late" in shown
    assert "not ready; late 2 times, 7 captures reused a mask" in shown


@pytest.mark.usefixtures("url")
@pytest.mark.parametrize("command", ["status", "capture", "classify", "rotate"])
def test_answers_are_json_when_asked_for(command: str) -> None:
    result = runner.invoke(app, [command, "--json"])
    assert result.exit_code == 0
    assert json.loads(result.stdout)


@pytest.mark.usefixtures("url")
@pytest.mark.parametrize(
    ("options", "path", "body"),
    [
        ([], "/v1/rotation/advance", None),
        (["--off"], "/v1/rotation", {"mode": "off"}),
        (
            ["--every-seconds", "2", "--jitter", "0.5"],
            "/v1/rotation",
            {"mode": "seconds", "seconds": 2.0, "jitter": 0.5, "reuse": 0},
        ),
        (
            ["--every-captures", "9", "--reuse", "4"],
            "/v1/rotation",
            {"mode": "captures", "captures": 9, "reuse": 4},
        ),
    ],
)
def test_rotate_asks_for_what_it_was_told(
    daemon: Daemon, options: list[str], path: str, body: Any
) -> None:
    assert runner.invoke(app, ["rotate", *options]).exit_code == 0
    request = daemon.requests[-1]
    assert request.url.path == path
    assert (json.loads(request.content) if request.content else None) == body


@pytest.mark.usefixtures("url")
@pytest.mark.parametrize(
    ("options", "method", "body"),
    [
        ([], "GET", None),
        (["--off"], "PUT", {"mode": "off"}),
        (["--on-request"], "PUT", {"mode": "on_request", "quiet": None}),
        (
            ["--rate", "30/min", "--quiet-hours", "22-7"],
            "PUT",
            {
                "mode": "watching",
                "rate_hz": 0.5,
                "quiet": {"begin": "22:00", "end": "07:00"},
            },
        ),
    ],
)
def test_look_asks_for_what_it_was_told(
    daemon: Daemon, options: list[str], method: str, body: Any
) -> None:
    assert runner.invoke(app, ["look", *options]).exit_code == 0
    request = daemon.requests[-1]
    assert (request.method, request.url.path) == (method, "/v1/watch")
    assert (json.loads(request.content) if request.content else None) == body


@pytest.mark.usefixtures("url")
def test_capture_writes_an_array(tmp_path: Path) -> None:
    out = tmp_path / "e.npy"
    assert runner.invoke(app, ["capture", "--out", str(out)]).exit_code == 0
    assert np.load(out).tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.5]]
    result = runner.invoke(app, ["capture", "--out", str(tmp_path / "no" / "e.npy")])
    assert result.exit_code == 2
    assert "cannot write" in result.stderr


@pytest.mark.usefixtures("url")
def test_label_without_scores_is_shown_alone(daemon: Daemon, answers: dict[str, Any]) -> None:
    alone = {**answers["classification"], "confidence": None, "scores": None}
    daemon.first = [httpx.Response(200, json=alone)]
    assert runner.invoke(app, ["classify"]).stdout == "7  epoch e1\n"


def test_remedy_is_said_where_it_is_known() -> None:
    example = example_status()
    assert "remedy" not in status_in_words(example)
    safe = example.model_copy(update={"state": "safe", "remedy": "check_panel_wiring"})
    assert "\nremedy    check_panel_wiring\n" in status_in_words(safe)


@pytest.mark.usefixtures("url")
@pytest.mark.parametrize("as_json", [True, False])
def test_watch_prints_one_line_an_event(daemon: Daemon, as_json: bool) -> None:
    base = {"at": "2026-01-02T03:04:05Z"}
    sent: list[dict[str, Any]] = [
        {"kind": "state", "state": "safe", "detail": "dead", "remedy": "run_doctor"},
        {"kind": "mask", "epoch": "e1"},
        {"kind": "capture", "capture": "c1", "epoch": "e1"},
        {"kind": "classification", "capture": "c", "epoch": "e", "label": "7"},
        {"kind": "rotation", "policy": {"mode": "off"}},
        {"kind": "fault", "code": "sensor_failed", "detail": "no", "remedy": "restart"},
        {"kind": "gap", "missed": 4},
        {"kind": "gap", "missed": None},
    ]
    text = "".join(
        f"event: {each['kind']}\ndata: {json.dumps({**base, 'id': f'b-{n}', **each})}\n\n"
        for n, each in enumerate(sent)
    )
    daemon.first = [httpx.Response(200, text=text)]
    result = runner.invoke(app, ["watch", "--count", "8", *(["--json"] if as_json else [])])
    assert result.exit_code == 0
    lines = result.stdout.splitlines()
    assert len(lines) == len(sent)
    if as_json:
        assert [json.loads(line)["kind"] for line in lines] == [each["kind"] for each in sent]
        return
    words = (
        "dead  remedy: run_doctor",
        "e1",
        "e1",
        "7  epoch e",
        "off",
        "no  remedy: restart",
        "4 events",
        "restarted",
    )
    for line, word in zip(lines, words, strict=True):
        assert word in line


@pytest.mark.usefixtures("url")
@pytest.mark.parametrize(
    ("status", "code", "exit_code"),
    [
        (422, "invalid_request", 5),
        (429, "queue_full", 6),
        (503, "sensor_failed", 7),
        (500, "internal_error", 8),
    ],
)
def test_every_error_class_has_its_exit_code(
    daemon: Daemon, make_problem: Problem, status: int, code: str, exit_code: int
) -> None:
    daemon.first = [make_problem(status, code)]
    result = runner.invoke(app, ["classify"])
    assert result.exit_code == exit_code
    assert result.stderr == f"veilcam: error: what went wrong: {code} [{code}, request r1]\n"


@pytest.mark.usefixtures("url")
def test_unreadable_answer_has_its_exit_code(daemon: Daemon) -> None:
    daemon.first = [httpx.Response(200, text="hello")]
    assert runner.invoke(app, ["status"]).exit_code == 9


def test_absent_daemon_has_its_exit_code() -> None:
    result = runner.invoke(app, ["status", "--url", "http://127.0.0.1:1"])
    assert result.exit_code == 3
    assert "is veilcamd running there?" in result.stderr


def test_silent_daemon_has_its_exit_code() -> None:
    import socket

    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"http://127.0.0.1:{silent.getsockname()[1]}"
        result = runner.invoke(app, ["status", "--url", address, "--timeout", "0.05"])
    assert result.exit_code == 4


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
        (["look", "--off", "--rate", "2/s"], "give one of"),
        (["look", "--off", "--quiet-hours", "22-7"], "--quiet-hours goes with"),
        (["look", "--rate", "often"], "'often' is no rate: use 2/s"),
        (["look", "--on-request", "--quiet-hours", "late"], "'late' are no hours: use 22-7"),
        (["rotate", "--every-captures", "1", "--reuse", "-1"], "--reuse -1: should be greater"),
        (["rotate", "--every-seconds", "1", "--jitter", "1"], "jitter 1 s leaves a mask less"),
    ],
)
def test_bad_usage_is_one_line_and_exit_code_2(arguments: list[str], message: str) -> None:
    result = runner.invoke(app, arguments)
    assert result.exit_code == 2
    assert message in result.stderr
    assert result.stderr.count("\n") == 1
