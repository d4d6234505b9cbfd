"""The other views in Chromium: health, calibration, privacy, tokens, events, log, and the API."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest
from playwright.sync_api import Page, Route, expect
from tests.page.conftest import Daemon, Open, confirm, log_in

from veilcam_client.wire.bundles import example_bundle
from veilcam_client.wire.calibration import CalibrationRun

pytestmark = pytest.mark.page

SCENES = ("dark", "white card", "lamp")


def run(stage: str, scene: str | None, exposures: int, **others: Any) -> dict[str, Any]:
    told = {"stage": stage, "scene": scene, "exposures": exposures, "total": 330}
    return CalibrationRun.model_validate(
        {"instruction": None, "detail": None, **told, **others}
    ).model_dump()


def test_calibration_asks_for_its_three_scenes_one_after_the_other(open_page: Open) -> None:
    """Of a camera whose scenes a person sets; a simulated one sets them itself."""
    confirmed: list[str] = []
    state: dict[str, Any] = {"run": None}

    def waiting(index: int) -> dict[str, Any]:
        scene = SCENES[index]
        return run("waiting", scene, 100 * index, instruction=f"Set the {scene}.")

    def answer(route: Route) -> None:
        if route.request.url.endswith("/scene"):
            confirmed.append(json.loads(route.request.post_data or "{}")["scene"])
            left = len(confirmed) < len(SCENES)
            state["run"] = waiting(len(confirmed)) if left else run("fitting", None, 330)
        elif route.request.method == "POST":
            state["run"] = waiting(0)
        elif route.request.method == "GET":
            route.fulfill(json={"signed": None, "run": state["run"]})
            return
        else:
            state["run"] = run("cancelled", None, 330)
        route.fulfill(json=state["run"])

    page = open_page()
    page.route(re.compile("/v1/calibration"), answer)
    page.get_by_role("link", name="Calibrate").click()
    expect(
        page.get_by_text("Nothing yet: the camera is taken to be as it was drawn.")
    ).to_be_visible()
    page.get_by_role("button", name="Begin").click()
    for scene in SCENES:
        expect(page.get_by_text(f"Set the {scene}.")).to_be_visible()
        step = page.locator("[aria-current=step]")
        expect(step).to_have_text(re.compile(scene, re.IGNORECASE))
        page.get_by_role("button", name="Scene is set").click()
    expect(page.get_by_text("All is measured.")).to_be_visible()
    assert confirmed == list(SCENES)
    expect(page.get_by_role("button", name="Scene is set")).to_have_count(0)
    confirm(page, "End it")
    expect(page.get_by_text("The calibration was ended, and nothing was changed.")).to_be_visible()


def test_a_token_is_made_shown_once_used_and_revoked(open_page: Open) -> None:
    page = open_page("/#tokens")
    page.get_by_label("For whom or what").fill("hall lamp")
    page.get_by_label("Days that it lasts").fill("2")
    page.get_by_role("button", name="Make token").click()
    secret = page.locator(".secret")
    expect(secret).to_have_text(re.compile("^vc_[0-9a-f]{12}_[0-9a-f]{64}$"))
    made = secret.inner_text()
    page.get_by_role("button", name="Done").click()
    expect(secret).to_have_count(0)
    assert made not in page.content()

    other = open_page(known=False)
    log_in(other, made)
    expect(other.get_by_role("heading", name="Live")).to_be_visible()
    # What only an owner may do stands in no list, and says so where it is gone to.
    for name in ("Tokens", "Bundles", "Calibrate", "Log"):
        expect(other.get_by_role("link", name=name, exact=True)).to_have_count(0)
    other.goto(f"{other.url}#tokens")
    expect(other.get_by_text("yours lacks the scope admin:tokens")).to_be_visible()

    confirm(page, "Revoke hall lamp", "Revoke")
    expect(page.get_by_role("button", name="Revoke hall lamp")).to_have_count(0)
    other.reload()
    expect(other.get_by_label("Token")).to_be_visible()


def test_the_privacy_card_is_a_table(open_page: Open, daemon: Daemon) -> None:
    with daemon.camera() as camera:
        status = json.loads(camera.status().model_dump_json())
    status["bundle"]["card"] = json.loads(example_bundle().model_dump_json())["card"]
    page = open_page("/#privacy")
    expect(page.get_by_text("These masks have no privacy card")).to_be_visible()
    expect(page.get_by_text("Sealed to no receivers")).to_be_visible()
    page.route("**/v1/status", lambda route: route.fulfill(json=status))
    page.reload()
    row = page.get_by_role("row", name=re.compile("T1 ciphertext only"))
    expect(row).to_have_text(re.compile("PASS.*0.2 points.*0.8 points"))


def test_events_stand_there_as_they_happen(open_page: Open, daemon: Daemon) -> None:
    page = open_page("/#events")
    line = page.get_by_role("listitem").filter(has_text=re.compile(r"It saw \d"))
    with daemon.camera() as camera:
        camera.classify()
    expect(line).not_to_have_count(0)
    masks = page.get_by_role("listitem").filter(has_text="A new mask is shown")
    expect(masks).to_have_count(0)
    page.get_by_label("Masks and captures, too").check()
    with daemon.camera() as camera:
        camera.rotation.advance()
    expect(masks).not_to_have_count(0)


def test_log_says_what_left_and_who_changed_what(open_page: Open, daemon: Daemon) -> None:
    page = open_page("/#log")
    record = re.compile(r"^(start|request|refused|capture) \d+$")
    expect(page.get_by_text(record).first).to_be_visible()
    with daemon.camera() as camera:
        before = camera.rotation.get().policy
        answer = camera.classify()
        camera.rotation.set(before)
    page.get_by_role("button", name="Load again").click()
    expect(page.get_by_text("action PUT /v1/rotation").first).to_be_visible()
    expect(page.get_by_text(f"epoch {answer.epoch}, number {answer.number}")).to_be_visible()
    token = daemon.make_token("no log", ("read:status",))
    other = open_page(known=False)
    log_in(other, token)
    other.goto(f"{other.url}#log")
    expect(other.get_by_text("yours lacks the scope read:log")).to_be_visible()


def test_address_that_names_no_view_shows_the_first(open_page: Open) -> None:
    page = open_page("/#constructor")
    expect(page.get_by_role("heading", name="Live", level=1)).to_be_visible()


def test_the_api_is_a_page_of_the_daemon(open_page: Open) -> None:
    page: Page = open_page("/docs")
    expect(page.locator("h1")).to_have_text(re.compile("^The API, version"))
    document = page.evaluate(
        """async () => (await fetch("/v1/openapi.json", {headers: {
            "Veilcam-Session": localStorage.getItem("veilcam-session")}})).json()"""
    )
    count = sum(len(operations) for operations in document["paths"].values())
    expect(page.locator("article")).to_have_count(count)
    capture = page.locator("article#capture")
    expect(capture.locator("h3")).to_have_text("POST /v1/captures")
    expect(capture).to_contain_text("camera.capture()")
    stranger = open_page("/docs", known=False)
    expect(stranger.get_by_role("alert")).to_have_text("Log in to read it: the camera")
    expect(stranger.locator("article")).to_have_count(0)


def test_list_of_operations_follows_the_text(open_page: Open) -> None:
    page = open_page("/docs")
    operations, places = page.locator("article"), page.locator("#index a")
    expect(operations).not_to_have_count(0)
    expect(places).to_have_count(operations.count())
    page.get_by_role("link", name="POST /v1/captures", exact=True).focus()
    page.keyboard.press("Enter")
    expect(page.locator("article#capture h3")).to_be_in_viewport()
    expect(page.locator("#index [aria-current]")).to_have_attribute("href", "#capture")
    page.keyboard.press("End")
    expect(places.last).to_have_attribute("aria-current", "true")
    expect(places.last).to_be_in_viewport()
    page.set_viewport_size({"width": 390, "height": 844})
    expect(places.first).to_be_hidden()
    page.locator("#index summary").focus()
    page.keyboard.press("Enter")
    expect(places.first).to_be_visible()
    page.keyboard.press("Tab")
    expect(places.first).to_be_focused()
    other = open_page("/docs#capture")
    expect(other.locator("article#capture h3")).to_be_in_viewport()
