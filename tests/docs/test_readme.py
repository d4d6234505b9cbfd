"""Lines of README.md: each ends well, with no token and with the one that README makes."""

from __future__ import annotations

from pathlib import Path

import pytest
from benchmarks.people.readme import LEFT, README, concepts, failures, spans, written
from tests.docs.lines import ROOT, Desk, Line, LineError, lines

PAGE = README.read_text()


@pytest.mark.slow
@pytest.mark.thorough
@pytest.mark.parametrize("options", [(), ("--auth", "tokens")], ids=["open", "tokens"])
def test_readme_lines_end_well(options: tuple[str, ...]) -> None:
    assert list(failures(PAGE, *options)) == []


def test_readme_array_takes_two_concepts() -> None:
    assert concepts(PAGE) == ["veilcam pair", "Camera"]
    before = """```
make serve
veilcam receiver keygen receiver.key > receiver.pub
veilcam receiver add receiver.pub --label laptop    # prints the public key
```
```python
from veilcam_client import Camera

Camera("http://127.0.0.1:8787", key="receiver.key").capture().embedding
```
"""
    assert len(concepts(before)) == 7


def test_line_that_is_left_stands_in_readme_and_has_a_test() -> None:
    found = [each.text for each in (*lines(PAGE), *spans(PAGE))]
    for left, reason in LEFT.items():
        assert any(text.startswith(left) for text in found), left
        assert (ROOT / reason.split(": ")[1]).exists(), reason
    assert len(written(PAGE)) >= 10


@pytest.mark.parametrize("line", [Line("false"), Line("raise SystemExit(3)", python=True)])
def test_line_that_fails_is_an_error(tmp_path: Path, line: Line) -> None:
    with pytest.raises(LineError, match=r"ends with [13]"):
        Desk(tmp_path).run(line)


def test_word_of_a_line_is_what_an_earlier_one_printed(tmp_path: Path) -> None:
    desk = Desk(tmp_path)
    desk.run(Line("echo veilcam://HOST:1/#abc"))
    assert desk.run(Line("echo 'LINE'")) == "veilcam://HOST:1/#abc\n"
