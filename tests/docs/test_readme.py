"""README and docs say what is: figures as measured, every dependency."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from benchmarks.tables.pages import PAGES, with_tables

ROOT = Path(__file__).resolve().parents[2]


def test_figures_are_those_of_the_result_files() -> None:
    for name in PAGES:
        page = (ROOT / name).read_text()
        assert with_tables(name, page) == page, "run python -m benchmarks.tables"


def test_every_dependency_has_its_reason() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = list(project["dependencies"])
    for extra in project["optional-dependencies"].values():
        wanted += extra
    rows = (ROOT / "docs" / "dependencies.md").read_text()
    for requirement in wanted:
        name = re.split(r"[\[<>=]", requirement)[0]
        assert name == "veilcam" or re.search(rf"\b{re.escape(name)}\b", rows), name
