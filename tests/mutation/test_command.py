"""The command on a small repository: what it runs, keeps, writes and ends with."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest
import typer

from . import __main__ as command
from .subjects import SUBJECTS, Subject

SOURCE = "def larger(a, b):\n    return a > b\n"


@pytest.fixture
def subjects(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two modules: one is tested, of the other the test looks at nothing."""
    root = tmp_path / "repository"
    for name, test in (("tried", "assert not larger(1, 1)"), ("untried", "assert larger")):
        (root / "client").mkdir(parents=True, exist_ok=True)
        (root / "client" / f"{name}.py").write_text(SOURCE)
        text = f"from {name} import larger\n\n\ndef test() -> None:\n    {test}\n"
        (root / f"test_{name}.py").write_text(text)
    subprocess.run(["git", "init", "-q", root], check=True)
    table = tuple(
        Subject(name, (f"client/{name}.py",), (f"test_{name}.py",)) for name in ("tried", "untried")
    )
    monkeypatch.setattr(command, "ROOT", root)
    monkeypatch.setattr(command, "SUBJECTS", table)


@pytest.mark.slow
@pytest.mark.usefixtures("subjects")
def test_the_share_is_told_recorded_and_too_low(tmp_path: Path) -> None:
    out, figures = tmp_path / "out", tmp_path / "figures.json"
    with pytest.raises(SystemExit) as ended:
        command.main(count=2, seed=3, workers=2, out=out, figures=figures)
    assert ended.value.code == 1
    report = (out / "report.md").read_text()
    assert "1 of 2 (50%, bar 85%, seed 3)" in report
    assert "client/untried.py:2 comparison (survived)" in report
    figure = json.loads(figures.read_text())["mutants_killed_by_room"]
    assert figure["value"] == 0.5
    assert figure["command"].startswith("python -m tests.mutation")


@pytest.mark.slow
@pytest.mark.usefixtures("subjects")
def test_it_goes_on_where_it_was_stopped(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    command.main(subjects="tried", workers=1, out=out)
    assert "0 left: client/tried.py:2 killed" in capsys.readouterr().err
    before = (out / "results.jsonl").read_text()
    command.main(subjects="tried", workers=1, out=out)
    assert capsys.readouterr().err == ""
    assert (out / "results.jsonl").read_text() == before
    assert "1 of 1" in (out / "report.md").read_text()


def test_subjects_are_chosen_by_name(tmp_path: Path) -> None:
    assert command.choose("") == SUBJECTS
    assert [subject.name for subject in command.choose("epochs, fence")] == ["epochs", "fence"]
    with pytest.raises(typer.BadParameter, match="'moon' is unknown: use some of fence, "):
        command.choose("fence,moon")
    with pytest.raises(typer.BadParameter, match="of all subjects"):
        command.main(subjects="fence", figures=tmp_path / "figures.json")
