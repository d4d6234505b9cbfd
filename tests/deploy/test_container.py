"""The Containerfile fits this checkout; `make test-container` builds it."""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "deploy" / "Containerfile").read_text()


def words(instruction: str) -> list[str]:
    [listed] = re.findall(rf"(?m)^{instruction} (\[.*\])$", TEXT)
    given: list[str] = json.loads(listed)
    return given


@pytest.mark.parametrize(("further", "status"), [((), 0), (("--no-such-option",), 2)])
def test_the_daemon_knows_every_option(further: tuple[str, ...], status: int) -> None:
    _, *options = words("ENTRYPOINT") + words("CMD")
    command = [sys.executable, "-m", "veilcam_server", *options, *further, "--help"]
    assert subprocess.run(command, capture_output=True, check=False).returncode == status


def test_every_package_is_copied_and_the_extra_exists() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    copied = set(re.findall(r"(?m)^COPY (\w+) /source/\1$", TEXT))
    packages = project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"]
    assert {package.split("/")[0] for package in packages} == copied
    [extra] = re.findall(r"'/source\[(\w+)\]'", TEXT)
    assert extra in project["project"]["optional-dependencies"]
