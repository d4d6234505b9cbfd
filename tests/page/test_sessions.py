"""Sessions in Chromium: a wrong token, a restart, an end, and what the browser keeps."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect
from tests.page.conftest import PATIENCE, Daemon, Open, log_in

pytestmark = pytest.mark.page


def test_a_wrong_token_is_said_to_be_one(open_page: Open) -> None:
    page = open_page(known=False)
    for token, told in (
        ("vc_000000000000_" + 64 * "0", "This token is not known here, or it has ended."),
        ("ein Schlüssel", "This is no token."),
    ):
        log_in(page, token)
        expect(page.get_by_role("alert").filter(has_text=told)).to_be_visible()
    expect(page.get_by_role("navigation")).to_be_hidden()


def test_a_token_that_may_not_see_the_state_is_told_what_it_lacks(
    open_page: Open, daemon: Daemon
) -> None:
    page = open_page(known=False)
    log_in(page, daemon.make_token("blind", ("classify",)))
    expect(page.get_by_role("alert").filter(has_text="lacks the scope read:status")).to_be_visible()


def test_the_token_is_given_once_and_kept_nowhere(open_page: Open, daemon: Daemon) -> None:
    page = open_page(known=False)
    log_in(page, daemon.token)
    expect(page.get_by_role("heading", name="Live")).to_be_visible()
    kept = json.dumps(page.context.storage_state())
    assert daemon.token not in kept
    assert daemon.token.rpartition("_")[2] not in kept
    (cookie,) = page.context.cookies(f"{daemon.url}/v1/status")
    assert cookie["httpOnly"]
    assert cookie["sameSite"] == "Strict"
    assert page.evaluate("document.cookie") == ""
    page.reload()
    expect(page.get_by_role("heading", name="Live")).to_be_visible()
    page.get_by_role("button", name="Log out").click()
    expect(page.get_by_label("Token")).to_be_visible()
    # The browser's half alone is worth nothing, and the page's is gone.
    assert page.evaluate("localStorage.length") == 0
    again = f"{daemon.url}/v1/"
    page.context.add_cookies([{"name": cookie["name"], "value": cookie["value"], "url": again}])
    page.reload()
    expect(page.get_by_label("Token")).to_be_visible()


def test_two_cameras_of_one_host_do_not_disturb_each_other(
    chromium: Browser, daemon: Daemon, tmp_path: Path
) -> None:
    second = Daemon(tmp_path)
    second.start()
    context = chromium.new_context()
    try:
        page = context.new_page()
        page.set_default_timeout(PATIENCE)
        for camera in (daemon, second):
            page.goto(camera.url)
            expect(page.get_by_text("sudo veilcamd token first")).to_be_visible()
            log_in(page, camera.token)
            expect(page.get_by_role("heading", name="Live")).to_be_visible()
            place = camera.url.removeprefix("http://")
            expect(page).to_have_title(f"Live: {place}, Veilcam")
            expect(page.locator("header")).to_contain_text(place)
        page.get_by_role("button", name="Log out").click()
        expect(page.get_by_label("Token")).to_be_visible()
        page.goto(daemon.url)
        expect(page.get_by_role("heading", name="Live")).to_be_visible()
    finally:
        context.close()
        second.stop()


def test_a_session_that_ended_is_asked_for_again_in_the_same_place(
    open_page: Open, daemon: Daemon
) -> None:
    token = daemon.make_token("short")
    page = open_page("/#health", known=False)
    log_in(page, token)
    expect(page.get_by_role("heading", name="Health")).to_be_visible()
    daemon.revoke(token)
    ended = page.get_by_role("alert").filter(has_text="This session has ended.")
    expect(ended).to_be_visible()
    log_in(page, daemon.token)
    expect(page.get_by_role("heading", name="Health")).to_be_visible()


def test_the_daemon_restarts_and_the_page_comes_back(open_page: Open, daemon: Daemon) -> None:
    page = open_page()
    label, notice = page.locator("output.label"), page.locator("#notice")
    expect(label).to_have_text(re.compile(r"^\d$"))
    # An event has come by then: without one, nothing would be missed.
    page.get_by_role("link", name="Events").click()
    page.get_by_label("Masks and captures, too").check()
    with daemon.camera() as camera:
        camera.rotation.advance()
    masks = page.get_by_role("listitem").filter(has_text="A new mask is shown")
    expect(masks).not_to_have_count(0)
    page.get_by_role("link", name="Live").click()
    daemon.stop()
    try:
        expect(notice).to_have_text(re.compile("The daemon does not answer."))
    finally:
        daemon.start()
    expect(notice).to_be_hidden()
    expect(page.locator("#state")).to_have_text("Ready")
    page.get_by_role("button", name="Hold up a 1").click()
    expect(label).to_have_text("1")
    page.get_by_role("link", name="Events").click()
    expect(page.get_by_text("The daemon was restarted")).to_be_visible()


def test_a_page_that_is_opened_before_the_daemon_waits_for_it(
    open_page: Open, daemon: Daemon
) -> None:
    page = open_page()
    page.route("**/v1/session", lambda route: route.abort())
    page.reload()
    expect(page.locator("#notice")).to_have_text(re.compile("The daemon does not answer."))
    page.unroute("**/v1/session")
    expect(page.get_by_role("heading", name="Live")).to_be_visible()
    expect(page.locator("#notice")).to_be_hidden()
