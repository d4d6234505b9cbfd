"""Reference, drawings and site: as the code is, and fetching nothing."""

from __future__ import annotations

import json
import os
import re
import runpy
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import pytest

from veilcam_optics.camera.geometry import Camera
from veilcam_server.errors import PROBLEMS
from veilcam_server.settings import Settings

ROOT = Path(__file__).resolve().parents[2]
GENERATOR = runpy.run_path(str(ROOT / "docs" / "generate.py"))


@pytest.mark.parametrize("name", GENERATOR["PAGES"])
def test_generated_pages_are_as_the_code_is(name: str) -> None:
    page = (ROOT / "docs" / "reference" / name).read_text()
    assert page == GENERATOR["PAGES"][name](), "run python docs/generate.py"


def test_every_setting_and_code_is_there() -> None:
    settings = (ROOT / "docs" / "reference" / "settings.md").read_text()
    for name in Settings.model_fields:
        assert f"`VEILCAM_{name.upper()}`" in settings
    errors = (ROOT / "docs" / "reference" / "errors.md").read_text()
    said = set(re.findall(r"^[|] `([a-z_]+)` [|]", errors, flags=re.MULTILINE))
    assert said == set(PROBLEMS)


@pytest.mark.slow
def test_the_site_is_built_without_a_warning_and_fetches_nothing(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    pages = list(tmp_path.rglob("*.html"))
    assert len(pages) > 20
    outside = re.compile(r"<(?:script|img|iframe|link|source)[^>]+(?:src|href)=\"(https?:[^\"]+)")
    for page in pages:
        fetched = [url for url in outside.findall(page.read_text()) if "canonical" not in url]
        assert fetched == [], page.name
    index = json.loads((tmp_path / "search" / "search_index.json").read_text())
    assert any("commands" in entry["location"] for entry in index["docs"])


SCRIPT = runpy.run_path(str(ROOT / "docs" / "drawings.py"))


@pytest.mark.parametrize("name", ["stack.svg", "wires.svg"])
def test_drawings_are_as_the_code_has_it(name: str) -> None:
    text = (ROOT / "docs" / "images" / name).read_text()
    assert text == SCRIPT["drawings"]()[name], "run python docs/drawings.py"
    ET.fromstring(text)


def test_another_camera_has_other_dimensions() -> None:
    drawn = SCRIPT["stack"](replace(Camera(), distance=0.006))
    assert "6 mm, front of the sensor" in drawn
    drawn = SCRIPT["wires"]({"data_line": 24, "reset_line": 25})
    assert drawn.index("GPIO 24") < drawn.index("GPIO 25")
