"""One command and one click: what `make serve` starts, in Chromium."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect
from tests.docs.lines import ROOT, Desk, Line, lines, make_serve
from tests.page.conftest import PATIENCE, log_in

pytestmark = pytest.mark.page


@pytest.fixture
def served(tmp_path: Path) -> Iterator[str]:
    with Desk(tmp_path).serving(*make_serve()) as url:
        yield url


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


def test_first_token_of_readme_opens_the_page(chromium: Browser, tmp_path: Path) -> None:
    first = Line("sudo veilcamd token first")
    assert first in lines((ROOT / "README.md").read_text())
    desk = Desk(tmp_path)
    context = chromium.new_context()
    page = context.new_page()
    page.set_default_timeout(PATIENCE)
    with desk.serving(*make_serve(), "--auth", "tokens") as url:
        desk.run(first)
        page.goto(url)
        log_in(page, desk.said("TOKEN"))
        expect(page.locator("output.label:not(.none)")).to_be_visible()
        context.close()
