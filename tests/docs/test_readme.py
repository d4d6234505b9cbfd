"""The README says what is: figures as measured, every dependency."""

from __future__ import annotations

import re
import runpy
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text()


def test_figures_are_those_of_the_result_files() -> None:
    script = runpy.run_path(str(ROOT / "benchmarks" / "readme_figures.py"))
    for name in script["PAGES"]:
        page = (ROOT / name).read_text()
        assert script["with_tables"](name, page) == page, "run python -m benchmarks.readme_figures"


def test_every_dependency_has_its_reason() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = list(project["dependencies"])
    for extra in project["optional-dependencies"].values():
        wanted += extra
    rows = README[README.index("## Dependencies") : README.index("## Licence")]
    for requirement in wanted:
        name = re.split(r"[\[<>=]", requirement)[0]
        assert name == "veilcam" or re.search(rf"\b{re.escape(name)}\b", rows), name
