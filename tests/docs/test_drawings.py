"""The drawings are of the camera that the code is for."""

from __future__ import annotations

import runpy
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import pytest

from veilcam_optics.camera.geometry import Camera

ROOT = Path(__file__).resolve().parents[2]
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
