"""The page for everybody: axe-core, keyboard, phone, dark, and less motion."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import Literal

import pytest
from playwright.sync_api import Page, expect
from tests.page.conftest import PHONE, WIDE, Daemon, Open

pytestmark = pytest.mark.page

LOG_IN = "Log in"
VIEWS = {
    "/": "Live",
    "/#health": "Health",
    "/#calibration": "Calibration",
    "/#privacy": "Privacy",
    "/#tokens": "Tokens",
    "/#events": "Events",
    "/docs": "The API",
    "/#": LOG_IN,
}
SCHEMES: tuple[Literal["light", "dark"], ...] = ("light", "dark")
Record = Callable[[str, object], None]


def violations(page: Page) -> list[str]:
    """What axe-core finds, in words."""
    found = page.evaluate("async () => (await axe.run()).violations")
    return [
        f"{each['id']}: {', '.join(str(node['target']) for node in each['nodes'])}"
        for each in found
    ]


def settled(page: Page, title: str) -> None:
    """Wait until a view has what it asks for."""
    expect(page.get_by_role("heading", level=1)).to_contain_text(title)
    page.wait_for_load_state("load")
    expect(page.locator("main .card")).not_to_have_count(0)


@pytest.mark.parametrize(("path", "title"), VIEWS.items(), ids=VIEWS.values())
def test_axe_finds_nothing_on_any_view(
    open_page: Open, record_property: Record, path: str, title: str
) -> None:
    page = open_page(path, known=title != LOG_IN)
    if title == LOG_IN:
        expect(page.get_by_label("Token")).to_be_visible()
    else:
        settled(page, title)
    # What is folded away is looked at, too.
    page.evaluate("document.querySelectorAll('details').forEach((each) => { each.open = true; })")
    found: list[str] = []
    for viewport, scheme in product((WIDE, PHONE), SCHEMES):
        page.set_viewport_size(viewport)
        page.emulate_media(color_scheme=scheme)
        found += [f"{scheme}, {viewport['width']} wide: {each}" for each in violations(page)]
        width = page.evaluate("document.documentElement.scrollWidth")
        assert width <= viewport["width"], f"{path} is {width} wide"
    record_property("axe_violations", len(found))
    assert found == []


def test_axe_finds_nothing_in_what_comes_and_goes(
    open_page: Open, record_property: Record, daemon: Daemon
) -> None:
    page = open_page("/#tokens")
    page.get_by_label("For whom or what").fill("axe")
    page.get_by_role("button", name="Make it").click()
    expect(page.locator(".secret")).to_be_visible()
    found = violations(page)
    page.get_by_role("button", name="Revoke axe").click()
    expect(page.get_by_role("dialog")).to_be_visible()
    found += violations(page)
    page.get_by_role("dialog").get_by_role("button", name="Revoke").click()
    page.goto(f"{daemon.url}/#calibration")
    page.get_by_role("button", name="Begin").click()
    expect(page.get_by_role("button", name="End it")).to_be_visible()
    found += violations(page)
    page.get_by_role("button", name="End it").click()
    page.get_by_role("dialog").get_by_role("button", name="End it").click()
    expect(page.get_by_text("The calibration was ended")).to_be_visible()
    page.goto(f"{daemon.url}/")
    page.get_by_role("button", name="Take one").click()
    expect(page.locator(".picture canvas")).to_be_visible()
    page.route("**/v1/**", lambda route: route.abort())
    page.get_by_role("button", name="Look once").click()
    expect(page.get_by_role("alert").filter(has_text="does not answer")).to_be_visible()
    found += violations(page)
    record_property("axe_violations", len(found))
    assert found == []


def test_all_is_reached_with_the_keyboard(open_page: Open) -> None:
    page = open_page()
    expect(page.locator("output.label")).to_be_visible()
    page.keyboard.press("Tab")
    expect(page.get_by_role("link", name="Skip to the content")).to_be_focused()
    page.keyboard.press("Enter")
    expect(page.locator("main")).to_be_focused()
    reached = []
    for _ in range(25):
        page.keyboard.press("Tab")
        reached.append(
            page.evaluate("document.activeElement.ariaLabel || document.activeElement.innerText")
        )
    assert {"Look once", "When it looks", "Change it now", "Take one", "Hold up a 0"} <= set(
        reached
    )
    page.get_by_role("link", name="Health").focus()
    page.keyboard.press("Enter")
    expect(page.get_by_role("heading", name="Health")).to_be_visible()
    expect(page.locator("main")).to_be_focused()
    outline = page.get_by_role("link", name="Live")
    outline.focus()
    page.keyboard.press("Tab")
    assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"


def test_nothing_moves_for_who_wants_less_motion(open_page: Open) -> None:
    page = open_page(reduced_motion="reduce")
    expect(page.locator("output.label")).to_be_visible()
    moving = page.evaluate(
        """[...document.querySelectorAll("*")].map(getComputedStyle).filter((style) =>
          parseFloat(style.transitionDuration) > 0 || parseFloat(style.animationDuration) > 0
        ).length"""
    )
    assert moving == 0
