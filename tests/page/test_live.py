"""The page in Chromium: what the camera sees, its mask, its embedding, and what is wrong."""

from __future__ import annotations

import re

import pytest
from playwright.sync_api import Page, expect
from tests.page.conftest import Daemon, Open, log_in

from veilcam_client.models import Rotation

pytestmark = pytest.mark.page


def held_up(page: Page, digit: int) -> None:
    page.get_by_role("button", name=f"Hold up a {digit}").click()
    expect(page.get_by_text(f"It looks at a {digit}.")).to_be_visible()


def shown_epoch(rotation: Rotation) -> str:
    assert rotation.epoch is not None
    return rotation.epoch[:8]


def test_labels_change_by_themselves(open_page: Open) -> None:
    page = open_page()
    label = page.locator("output.label")
    for digit in (1, 0):
        held_up(page, digit)
        expect(label).to_have_text(str(digit))
    expect(page.get_by_text("It looks by itself, up to 2 times a second.")).to_be_visible()
    expect(page.get_by_text(re.compile(r"^almost sure, for \d+ s"))).to_be_visible()
    page.get_by_text("One by one").click()
    before = page.get_by_role("list", name="One by one").get_by_role("listitem")
    expect(before.filter(has_text=re.compile("^1 .* for"))).not_to_have_count(0)
    page.get_by_role("button", name="Nothing").click()
    expect(label).to_have_text("Nothing that it knows")


def test_when_it_looks_is_chosen_here(open_page: Open) -> None:
    page = open_page()
    page.get_by_text("When it looks").click()
    form = page.locator("details", has_text="When it looks")
    form.get_by_role("button", name="Not at all").click()
    form.get_by_role("button", name="Apply").click()
    expect(page.get_by_text("It is off: the panel is opaque.")).to_be_visible()
    expect(page.locator("#state")).to_have_text("Off, and opaque")
    expect(page.get_by_text("The panel is opaque", exact=True)).to_be_visible()
    expect(page.get_by_text("The panel is opaque: the camera sees nothing.")).to_be_visible()
    expect(page.locator("output.label")).to_have_text("–")
    expect(page.get_by_role("button", name="Look once")).to_be_hidden()
    form.get_by_role("button", name="When asked").click()
    form.get_by_label("From").fill("22:00")
    form.get_by_role("button", name="Apply").click()
    expect(form.get_by_role("alert")).to_have_text("Give both times, or none.")
    form.get_by_label("From").fill("")
    form.get_by_role("button", name="Apply").click()
    expect(page.get_by_text("It looks when it is asked.")).to_be_visible()
    held_up(page, 1)
    page.get_by_role("button", name="Look once").click()
    expect(page.locator("output.label")).to_have_text(re.compile(r"^\d$"))
    expect(page.get_by_text(re.compile(r"^(.* sure|a guess), \d+ s ago"))).to_be_visible()


def test_the_mask_is_changed_here(open_page: Open, daemon: Daemon) -> None:
    page = open_page()
    page.get_by_text("When masks change").click()
    form = page.locator("details", has_text="When masks change")
    form.get_by_role("button", name="Every so many seconds").click()
    form.get_by_label("How many").fill("50")
    form.get_by_role("button", name="Apply").click()
    expect(page.get_by_text("From now on: every 50 s.")).to_be_visible()
    expect(page.get_by_text(re.compile(r"It changes in \d\d s\."))).to_be_visible()
    form.get_by_role("button", name="By hand alone").click()
    form.get_by_role("button", name="Apply").click()
    expect(page.get_by_text("It stays until it is changed here.")).to_be_visible()
    epoch = page.get_by_text(re.compile("^Epoch [0-9a-f]{8}, shown for"))
    with daemon.camera() as camera:
        # After a change that was under way, if one was.
        before = shown_epoch(camera.rotation.advance())
        expect(epoch).to_contain_text(before)
        page.get_by_role("button", name="Change mask").click()
        expect(epoch).not_to_contain_text(before)
        expect(epoch).to_contain_text(shown_epoch(camera.rotation.get()))


def test_an_embedding_is_a_picture_where_the_token_may_see_it(
    open_page: Open, daemon: Daemon
) -> None:
    page = open_page()
    page.get_by_role("button", name="Take one").click()
    picture = page.get_by_role("img", name="An embedding of 24 by 32 numbers, raw")
    expect(picture).to_be_visible()
    greys = picture.evaluate(
        "each => new Set(each.getContext('2d').getImageData(0, 0, 32, 24).data).size"
    )
    assert greys > 50
    expect(page.get_by_text(re.compile("^24 × 32 numbers, raw, behind epoch"))).to_be_visible()

    # Of a token that may not, there is not even the place for it.
    other = open_page(known=False)
    token = daemon.make_token("narrow", ("read:status",))
    log_in(other, token)
    expect(other.get_by_text("This token may not see labels")).to_be_visible()
    for name in ("Take one", "Change mask", "Hold up a 1", "Look once"):
        expect(other.get_by_role("button", name=name)).to_have_count(0)


def test_a_fault_appears_with_its_remedy_and_clears(open_page: Open) -> None:
    page, health = open_page(), open_page("/#health")
    expect(health.get_by_role("listitem").filter(has_text="state directory")).to_be_visible()
    page.get_by_text("Faults").click()
    page.get_by_label("What happens").select_option("The sensor is unplugged")
    page.get_by_role("button", name="Break it").click()
    for each in (page, health):
        expect(each.locator("#state")).to_have_text(re.compile("Degraded|Opaque"))
    remedy = "What helps: check the cable of the camera"
    state = health.get_by_role("region", name="Problems")
    expect(state.get_by_text(remedy)).to_be_visible()
    failed = health.get_by_role("region", name="What failed")
    expect(failed.get_by_text(remedy)).not_to_have_count(0)
    page.get_by_role("button", name="Mend it").click()
    page.get_by_role("button", name="Change mask").click()
    for each in (page, health):
        expect(each.locator("#state")).to_have_text("Ready")
    expect(state.get_by_text("Ready: no problem was found")).to_be_visible()
    expect(state.get_by_text(remedy)).to_have_count(0)
    expect(page.locator("output.label")).to_have_text(re.compile(r"^\d$"))


def test_a_picture_of_ones_own_is_held_up(open_page: Open) -> None:
    page = open_page()
    page.get_by_label("Or a picture of yours").set_input_files(
        {"name": "no.png", "mimeType": "image/png", "buffer": b"no picture"}
    )
    scene = page.get_by_role("region", name="Scene")
    expect(scene.get_by_role("alert")).to_have_text(re.compile("image"))
