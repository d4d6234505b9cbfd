"""``veilcamd siege``: rows, their verdicts, and the status."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner

from veilcam_server.cli.main import app
from veilcam_server.siege import run
from veilcam_server.siege.ground import SHORT, Extent, Ground, Judgement

runner = CliRunner()
seen: list[Extent] = []


async def holds(ground: Ground, judgement: Judgement) -> None:
    seen.append(ground.extent)
    judgement.at_most("lost", 0, 0, figure="kills_lost")


async def breaks(_: Ground, judgement: Judgement) -> None:
    judgement.holds("it lives", true=False)


async def lacks(_: Ground, judgement: Judgement) -> None:
    judgement.untried = "no disk of one's own"


@pytest.fixture(autouse=True)
def _rows(monkeypatch: pytest.MonkeyPatch) -> None:
    seen.clear()
    monkeypatch.setattr(run, "ROWS", {"holds": holds, "breaks": breaks, "lacks": lacks})


def test_every_row_is_run_and_one_that_fails_is_the_status() -> None:
    ended = runner.invoke(app, ["siege"])
    assert ended.exit_code == 1
    lines = [line.split() for line in ended.stdout.splitlines() if line.strip()]
    assert [line[:2] for line in lines if line[0] in ("ok", "FAIL", "-")] == [
        *(["ok", "holds"], ["FAIL", "breaks"], ["-", "lacks"])
    ]
    assert "not so: it lives" in ended.stdout
    assert "no disk of one's own" in ended.stdout
    assert seen == [Extent()]


def test_one_row_in_its_short_form_as_json() -> None:
    ended = runner.invoke(app, ["siege", "--short", "--only", "holds", "--json"])
    assert ended.exit_code == 0, ended.output
    found = json.loads(ended.stdout)
    assert found["figures"] == {"kills_lost": 0}
    [row] = found["rows"]
    assert (row["row"], row["outcome"], row["missed"]) == ("holds", "passed", [])
    assert row["found"] == ["lost 0 (at most 0)"]
    assert seen == [SHORT]


def test_what_could_not_be_tried_is_no_failure() -> None:
    assert runner.invoke(app, ["siege", "--only", "lacks"]).exit_code == 0


def test_a_row_that_there_is_not_is_refused_with_those_that_there_are() -> None:
    ended = runner.invoke(app, ["siege", "--only", "moon"])
    assert ended.exit_code == 1
    assert "--only moon: rows are holds, breaks, lacks" in ended.stderr
