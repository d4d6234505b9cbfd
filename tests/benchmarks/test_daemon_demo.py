"""The accuracy of the demonstration as a figure; that it runs, the tests of the server show."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from benchmarks.daemon import demo
from rich.console import Console

from veilcam_server.demo.run import Plan
from veilcam_server.demo.tally import Sample, Tally


@pytest.mark.parametrize(
    ("fresh", "wrong_classifier", "name"),
    [
        (False, False, "demo_accuracy"),
        (False, True, "demo_wrong_classifier_accuracy"),
        (True, False, "demo_fresh_accuracy"),
    ],
)
def test_accuracy_of_the_demonstration_is_recorded(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    *,
    fresh: bool,
    wrong_classifier: bool,
    name: str,
) -> None:
    plans: list[Plan] = []

    def demonstrated(plan: Plan, console: Console) -> Tally:
        plans.append(plan)
        rights = [True, False, True, True, False, True]
        return Tally([Sample("a", 0, right, settle=0, capture=0, rest=0) for right in rights])

    monkeypatch.setattr(demo, "demonstrate", demonstrated)
    figures, bundle, out = (tmp_path / each for each in ("figures.json", "a.veilcam", "out"))
    figures.write_text('{"other": {"value": 1}}')
    plan = Plan(fresh=fresh, bundle=bundle, out=out, captures=6, wrong_classifier=wrong_classifier)
    demo.main(
        fresh=fresh,
        wrong_classifier=wrong_classifier,
        bundle=bundle,
        captures=6,
        out=out,
        figures=figures,
    )
    assert plans == [plan]
    written = json.loads(figures.read_text())
    assert written["other"] == {"value": 1}
    assert set(written[name]) == {"value", "command", "commit", "date", "machine"}
    assert written[name]["value"] == 0.6667
    assert "accuracy=0.667 captures=6" in capsys.readouterr().out
