"""One command and one click: what `make serve` starts, in Chromium."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect
from tests.page.conftest import PATIENCE

pytestmark = pytest.mark.page

ROOT = Path(__file__).resolve().parents[2]


def command() -> list[str]:
    shown = subprocess.run(
        ["make", "--dry-run", "--always-make", f"--directory={ROOT}", "serve"],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    (line,) = (each for each in shown.replace("\\\n", " ").splitlines() if "veilcamd serve" in each)
    words = shlex.split(line)[1:]
    words[words.index("--port") + 1] = "0"
    return [sys.executable, "-m", "veilcam_server", *words]


@pytest.fixture
def served(tmp_path: Path) -> Iterator[str]:
    environment = {**os.environ, "VEILCAM_STATE_DIRECTORY": str(tmp_path / "state")}
    with subprocess.Popen(
        command(),
        cwd=ROOT,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    ) as process:
        assert process.stdout is not None
        try:
            lines = (line for line in process.stdout if "listening on" in line)
            yield next(lines).split()[-1]
        finally:
            process.terminate()
            process.wait(60)


def test_a_label_changes_after_one_command_and_one_click(chromium: Browser, served: str) -> None:
    context = chromium.new_context()
    page = context.new_page()
    page.set_default_timeout(PATIENCE)
    page.goto(served)
    label = page.locator("output.label")
    page.get_by_role("button", name="Hold up a 1").click()
    expect(label).to_have_text("1")
    # Nothing is to log in to, and nothing to log out of.
    expect(page.get_by_role("button", name="Log out")).to_have_count(0)
    page.get_by_role("link", name="Tokens").click()
    expect(page.get_by_text("This daemon wants no tokens")).to_be_visible()
    page.goto(f"{served}/docs")
    expect(page.locator("article")).not_to_have_count(0)
    context.close()
