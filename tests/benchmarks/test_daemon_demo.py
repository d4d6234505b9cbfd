"""The accuracy of the demonstration as a figure, of a few captures."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from benchmarks.daemon import demo
from tests.server.conftest import make_bundle, make_fresh_bundle

from veilcam_training.bundle import Bundle, write_bundle


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "options", "name"),
    [
        (make_bundle, {"wrong_classifier": True}, "demo_wrong_classifier_accuracy"),
        (make_fresh_bundle, {"fresh": True}, "demo_fresh_accuracy"),
    ],
)
def test_the_accuracy_is_kept(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    *,
    make: Callable[[], Bundle],
    options: dict[str, bool],
    name: str,
) -> None:
    figures = tmp_path / "figures.json"
    figures.write_text('{"other": {"value": 1}}')
    bundle = tmp_path / "made.veilcam"
    write_bundle(bundle, make())
    demo.main(bundle=bundle, captures=6, out=tmp_path / "out", figures=figures, **options)
    written = json.loads(figures.read_text())
    assert written["other"] == {"value": 1}
    figure = written[name]
    assert set(figure) == {"value", "command", "commit", "date", "machine"}
    assert f"accuracy={figure['value']:.3f} captures=6" in capsys.readouterr().out
