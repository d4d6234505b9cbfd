"""The page for everybody: axe-core, keyboard, phone, dark, and less motion."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import pytest
from playwright.sync_api import ViewportSize, expect
from tests.page.conftest import (
    PHONE,
    WIDE,
    Open,
    violations,
)

pytestmark = pytest.mark.page

LOG_IN = "Log in"
VIEWS = {
    "Live": ("/", "output.label:not(.none)"),
    "Health": ("/#health", "[data-outcome]"),
    "Receivers": ("/#receivers", "text=Nobody is paired"),
    "Bundles": ("/#bundles", "text=What its masks give away"),
    "Calibrate": ("/#calibrate", "text=This is the first job of a real camera"),
    "Privacy": ("/#privacy", "text=These masks have no privacy card"),
    "Tokens": ("/#tokens", "[aria-label='Revoke all']"),
    "Events": ("/#events", "text=Masks and captures, too"),
    "Log": ("/#log", "[aria-live] b"),
    "The API": ("/docs", "article"),
    LOG_IN: ("/#", "text=Token"),
}
"""Path by title, and what is there once a view has what it asked for."""
Scheme = Literal["light", "dark"]
LOOKS: tuple[tuple[ViewportSize, Scheme], ...] = ((WIDE, "light"), (PHONE, "dark"))
"""Each width and each scheme once: colours do not depend on the width."""
Record = Callable[[str, object], None]


@pytest.mark.parametrize("title", VIEWS)
def test_axe_finds_nothing_on_any_view(
    open_page: Open, record_property: Record, title: str
) -> None:
    path, content = VIEWS[title]
    page = open_page(path, known=title != LOG_IN, axe=True)
    expect(page.locator("h1")).to_contain_text(title)
    expect(page.locator(content).first).to_be_visible()
    # What is folded away is looked at, too.
    page.evaluate("document.querySelectorAll('details').forEach((each) => { each.open = true; })")
    primary = page.locator("button:not(.plain, .digit)")
    for card in page.locator(".card").all():
        assert card.locator(primary).locator("visible=true").count() <= 1, card.inner_text()
    found: list[str] = []
    for viewport, scheme in LOOKS:
        page.set_viewport_size(viewport)
        page.emulate_media(color_scheme=scheme)
        found += [f"{scheme}, {viewport['width']} wide: {each}" for each in violations(page)]
        width = page.evaluate("document.documentElement.scrollWidth")
        assert width <= viewport["width"], f"{path} is {width} wide"
    record_property("axe_violations", len(found))
    assert found == []


def test_axe_finds_nothing_in_what_comes_and_goes(open_page: Open, record_property: Record) -> None:
    page = open_page("/#tokens", axe=True)
    page.get_by_label("For whom or what").fill("axe")
    page.get_by_role("button", name="Make token").click()
    expect(page.locator(".secret")).to_be_visible()
    found = violations(page)
    page.get_by_role("button", name="Revoke axe").click()
    expect(page.get_by_role("dialog")).to_be_visible()
    found += violations(page)
    page.get_by_role("dialog").get_by_role("button", name="Revoke").click()
    page.get_by_role("link", name="Live").click()
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
    wanted = {"Look once", "When it looks", "Change mask", "Take one", "Hold up a 0", "Faults"}
    reached = set[str]()
    for _ in range(page.locator("main :is(a, button, summary, input, select)").count()):
        page.keyboard.press("Tab")
        reached.add(
            page.evaluate("document.activeElement.ariaLabel || document.activeElement.innerText")
        )
    assert wanted <= reached
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
