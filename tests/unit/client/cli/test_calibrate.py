"""Calibrations through the command line."""

from __future__ import annotations

import json
from typing import Any

import httpx
import pytest
from tests.unit.client.conftest import MEASURING, Daemon, problem
from typer.testing import CliRunner

from veilcam_client.cli import calibrate as command
from veilcam_client.cli.format import event_in_words
from veilcam_client.cli.main import app
from veilcam_client.events import CalibrationChanged
from veilcam_client.wire.calibration import examples
from veilcam_client.wire.events import EVENT

runner = CliRunner()
WAITING = {**MEASURING, "stage": "waiting", "scene": "lamp", "instruction": "Put a lamp there."}
DONE = {**MEASURING, "stage": "done", "scene": None, "exposures": 330}
FAILED = {**DONE, "stage": "failed", "detail": "too little light: light it"}
QUANTITY = {"value": 0.00003, "uncertainty": 0.000001, "residual": 0.01}
SIGNED = next(each.signed for each in examples() if hasattr(each, "signed")).model_dump(mode="json")
SIGNED["record"].update(dead_rows=[20], drift=-0.001, shift_y_m=QUANTITY)


def said(run: dict[str, Any], status: int = 200) -> httpx.Response:
    return httpx.Response(status, json=run)


def looked(run: dict[str, Any] | None, signed: dict[str, Any] | None = None) -> httpx.Response:
    return said({"signed": signed, "run": run})


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch, url: str) -> None:
    monkeypatch.setattr(command, "_EVERY", 0.0)


@pytest.mark.usefixtures("quick")
def test_person_is_asked_for_scenes_and_told_what_was_found(daemon: Daemon) -> None:
    daemon.first = [
        said(MEASURING, 202),
        looked(WAITING),
        said({**MEASURING, "scene": "lamp", "exposures": 300}),
        looked(DONE, SIGNED),
        looked(DONE, SIGNED),
    ]
    result = runner.invoke(app, ["calibrate", "--repeats", "3"], input="\n")
    assert result.exit_code == 0, result.output
    assert json.loads(daemon.requests[0].content) == {"repeats": 3}
    for words in ("Put a lamp there.", "10 of 330 exposures of dark", "300 of 330"):
        assert words in result.stderr
    for words in ("shift along y [um]          30", "dead rows: 20", "drifted by -0.1 %"):
        assert words in result.stdout


@pytest.mark.usefixtures("quick")
def test_calibration_comes_as_json(daemon: Daemon) -> None:
    daemon.first = [said(DONE, 202), looked(DONE, SIGNED)]
    result = runner.invoke(app, ["calibrate", "--json"])
    assert json.loads(result.stdout)["signed"]["record"]["dead_rows"] == [20]


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(
    ("run", "reason"), [(FAILED, "too little light"), ({**DONE, "stage": "cancelled"}, "cancelled")]
)
def test_calibration_that_failed_is_said(daemon: Daemon, run: dict[str, Any], reason: str) -> None:
    daemon.first = [said(run, 202), looked(run)]
    result = runner.invoke(app, ["calibrate"])
    assert result.exit_code == 6
    assert reason in result.stderr
    assert "nothing was changed" in result.stderr


@pytest.mark.usefixtures("quick")
def test_caller_that_goes_away_cancels_its_calibration(daemon: Daemon) -> None:
    daemon.first = [said(WAITING, 202), said(DONE)]
    result = runner.invoke(app, ["calibrate"], input="")
    assert result.exit_code != 0
    assert [request.method for request in daemon.requests] == ["POST", "DELETE"]


@pytest.mark.usefixtures("quick")
def test_refusal_cancels_nothing(daemon: Daemon) -> None:
    daemon.first = [problem(409, "calibration_impossible")]
    assert runner.invoke(app, ["calibrate"]).exit_code == 4
    assert len(daemon.requests) == 1


@pytest.mark.parametrize(
    ("run", "words"),
    [
        (WAITING, "waiting  Put a lamp there."),
        (MEASURING, "measuring  10 of 330 exposures of dark"),
        (DONE, "done  330 of 330 exposures"),
        (FAILED, "failed  too little light: light it"),
    ],
)
def test_calibration_event_in_words(run: dict[str, Any], words: str) -> None:
    told = {"id": "a-1", "at": "2026-01-02T03:04:05Z", "kind": "calibration", "run": run}
    event = EVENT.validate_json(json.dumps(told))
    assert isinstance(event, CalibrationChanged)
    assert event_in_words(event) == words
