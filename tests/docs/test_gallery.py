"""Every script of the gallery answers its question, in little time, with a picture."""

from __future__ import annotations

import re
import runpy
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = sorted((ROOT / "examples" / "gallery").glob("*.py"))
PAGE = (ROOT / "docs" / "gallery.md").read_text()
LARGEST = 100_000


def numbers(text: str) -> list[float]:
    return [float(found) for found in re.findall(r"\d+(?:\.\d+)?(?:e[+-]?\d+)?", text)]


def answer(name: str, lines: list[str]) -> None:
    """What a script prints is what its question is about."""
    found = [numbers(line.partition(":")[2]) for line in lines]
    match name:
        case "see_psf":
            assert all(brightest > mean > 0 for brightest, mean in found)
        case "compare_methods":
            errors = {
                line.partition(":")[0]: row[0] for line, row in zip(lines, found, strict=True)
            }
            assert errors["the plan"] < 3e-3 < errors["shadows"]
            assert errors["next row and column"] < errors["no interference"]
        case "design_mask":
            ((before, after),) = found
            assert after > 2 * before
        case "choose_panel":
            assert all(0 < above <= count == 100 for above, count, _ in found)
        case "dead_space":
            light, ignored = zip(*found, strict=True)
            assert sorted(light) == list(light)
            assert sorted(ignored, reverse=True) == list(ignored)
        case "break_mask":
            (same,), (fresh,) = found
            assert same > 0.5
            assert fresh < 0.25
        case "own_loop":
            assert found[0][0] < 0.5
            assert found[1][1] < 0.8 * found[1][0]
        case _:
            pytest.fail(f"{name} has no question")


@pytest.mark.slow
@pytest.mark.parametrize("script", SCRIPTS, ids=[path.stem for path in SCRIPTS])
def test_it_answers_its_question(
    script: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out = tmp_path / "out.png"
    monkeypatch.setattr(sys, "argv", [script.name, str(out)])
    runpy.run_path(str(script), run_name="__main__")
    answer(script.stem, capsys.readouterr().out.splitlines())
    kept = ROOT / "docs" / "images" / "gallery" / f"{script.stem}.png"
    with Image.open(out) as drawn, Image.open(kept) as there:
        assert drawn.size == there.size, "the picture of the page is that of the script"
        assert float(np.asarray(drawn.convert("L")).std()) > 5, "something is drawn"


@pytest.mark.parametrize("script", SCRIPTS, ids=[path.stem for path in SCRIPTS])
def test_it_is_on_the_page_with_its_picture(script: Path) -> None:
    name = script.stem
    assert f"](../examples/gallery/{name}.py)" in PAGE
    assert re.search(rf"!\[[^]]+\]\(images/gallery/{name}\.png\)", PAGE)
    picture = ROOT / "docs" / "images" / "gallery" / f"{name}.png"
    assert picture.stat().st_size < LARGEST


def test_the_page_shows_the_adjoint_as_the_script_has_it() -> None:
    [block] = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    assert block in (ROOT / "examples" / "gallery" / "own_loop.py").read_text()
