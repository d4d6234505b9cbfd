"""Six jobs of the page, with Tab, Enter, Space and typed text alone, at two widths.

Each keeps pictures in light and dark under ``build/page``.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

import httpx
import pytest
from playwright.sync_api import Locator, Page, ViewportSize, expect
from tests.page.conftest import AXE, Daemon, Open, violations
from tests.unit.server.bundles.test_card import make_card

from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.models import OnRequest
from veilcam_client.wire.pairing import PairingLine, PairingOffer
from veilcam_server.demo_data import FRESH
from veilcam_training.bundle import add_card, read_bundle, sign_bundle

pytestmark = pytest.mark.page

PICTURES = Path(__file__).resolve().parents[2] / "build" / "page"
SIZES: tuple[ViewportSize, ...] = ({"width": 1280, "height": 900}, {"width": 390, "height": 844})
MOST_TABS = 150
"""Presses that reach everything on a view, once round."""
MOST_SHIFT = 0.1
"""Cumulative layout shift that counts as good (web.dev/articles/cls)."""
SHIFT = """
window.moves = [];
new PerformanceObserver((list) => {
  for (const each of list.getEntries()) if (!each.hadRecentInput) {
    const nodes = each.sources.map(({ node }) => node?.textContent?.slice(0, 40));
    window.moves.push([each.value, ...nodes]);
  }
}).observe({ type: "layout-shift", buffered: true });
"""
Record = Callable[[str, object], None]


class Job:
    """One job on the page, by keyboard.

    Args:
        page: page of the camera.
        name: name of the job, for pictures.
        record: function that takes figures.
    """

    def __init__(self, page: Page, name: str, record: Record) -> None:
        self.page, self.name, self.record = page, name, record
        page.evaluate(AXE)
        page.evaluate(SHIFT)

    def reach(self, target: Locator) -> None:
        """Press Tab until the element has the focus."""
        expect(target).to_be_visible()
        for _ in range(MOST_TABS):
            if target.evaluate("each => each === document.activeElement"):
                return
            self.page.keyboard.press("Tab")
        pytest.fail(f"Tab does not reach {target}")

    def press(self, name: str, role: str = "button", key: str = "Enter") -> None:
        """Reach a button, a link or a fold, and press a key on it."""
        found = self.page.get_by_role(role, name=name, exact=True)  # type: ignore[arg-type]
        if role == "summary":
            found = self.page.locator("summary", has_text=name).locator("visible=true").first
        self.reach(found)
        self.page.keyboard.press(key)

    def type(self, label: str, text: str) -> None:
        """Reach a field and type into it, in the place of what it holds."""
        self.reach(self.page.get_by_label(label, exact=True))
        self.page.keyboard.press("Control+a")
        self.page.keyboard.type(text)

    def view(self, name: str) -> None:
        """Go to a view of the page."""
        self.press(name, "link")
        expect(self.page.get_by_role("heading", name=name, level=1)).to_be_visible()

    def keep(self, moment: str) -> None:
        """Keep pictures, and look for what axe finds, in light and dark."""
        found: list[str] = []
        width = self.page.viewport_size["width"] if self.page.viewport_size else 0
        PICTURES.mkdir(parents=True, exist_ok=True)
        for scheme in ("dark", "light"):
            self.page.emulate_media(color_scheme=scheme)
            path = PICTURES / f"{self.name}-{moment}-{width}-{scheme}.png"
            self.page.screenshot(path=path, full_page=True, animations="disabled")
            found += violations(self.page)
        self.record("axe_violations", len(found))
        assert found == []
        assert self.page.evaluate("document.documentElement.scrollWidth") <= width

    def done(self) -> None:
        """Check that nothing moved by itself, and count the job."""
        moves = self.page.evaluate("window.moves")
        assert sum(value for value, *_ in moves) < MOST_SHIFT, moves
        self.record("page_job", self.name)


@pytest.fixture(params=SIZES, ids=lambda size: f"{size['width']} px")
def begin(
    request: pytest.FixtureRequest, open_page: Open, record_property: Record
) -> Callable[[str], Job]:
    return lambda name: Job(open_page(viewport=request.param), name, record_property)


def test_job_see(begin: Callable[[str], Job], daemon: Daemon) -> None:
    job = begin("see")
    page, label = job.page, job.page.locator("output.label")
    job.press("Hold up a 1", key="Space")
    expect(label).to_have_text("1")
    expect(page.get_by_text(re.compile("^almost sure, for"))).to_be_visible()
    rate = page.locator(".facts div", has_text="Looks a second, last minute").locator("dd")
    expect(rate).to_have_text(re.compile(r"^\d\.\d+$"))
    strip = page.get_by_role("list", name="Labels of the last hour").get_by_role("listitem")
    expect(strip.filter(has_text=re.compile("^1"))).to_be_visible()
    total = page.locator(".facts div", has_text="Captures in total").locator("dd")
    expect(total).to_have_text(re.compile(r"^\d+ \(\d+ by itself\)$"))
    with daemon.camera() as camera:
        # From here on the look that is asked for is the only one.
        camera.watch.set(OnRequest())
    expect(page.get_by_text("It looks when it is asked.")).to_be_visible()
    alone, own = map(int, re.findall(r"\d+", total.inner_text()))
    job.press("Look once")
    expect(total).to_have_text(f"{alone + 1} ({own} by itself)")
    expect(page.get_by_text(re.compile(r"^.*, \d+ s ago$"))).to_be_visible()
    job.keep("label")
    job.view("Health")
    expect(page.get_by_text("Ready: no problem was found")).to_be_visible()
    expect(page.get_by_role("listitem").filter(has_text="state directory")).to_be_visible()
    job.keep("health")
    job.done()


def test_job_rotate_and_watch(begin: Callable[[str], Job]) -> None:
    job = begin("watch")
    page, label = job.page, job.page.locator("output.label")
    epoch = page.get_by_text(re.compile("^Epoch [0-9a-f]{8}, shown for"))
    before = epoch.inner_text()[: len("Epoch 01234567")]
    job.press("Change mask")
    expect(epoch).not_to_contain_text(before)
    job.press("When it looks", "summary")
    job.press("Not at all", key="Space")
    job.press("Apply")
    expect(page.get_by_text("The panel is opaque: the camera sees nothing.")).to_be_visible()
    expect(label).to_have_text("–")
    job.keep("opaque")
    job.press("By itself", key="Space")
    job.type("Looks per second", "2")
    job.press("Apply")
    expect(label).to_have_text(re.compile(r"^\d$"))
    job.done()


def test_job_pair_a_receiver(begin: Callable[[str], Job], daemon: Daemon) -> None:
    job = begin("pair")
    page = job.page
    job.view("Receivers")
    chosen = page.get_by_role("button", pressed=True)
    expect(chosen).to_have_text("operator")
    job.press("viewer", key="Space")
    job.press("Pair a receiver")
    line = PairingLine.parse(page.locator(".secret").inner_text())
    expect(page.get_by_role("img", name="The same line as a QR code")).to_be_visible()
    expect(page.get_by_text(re.compile(r"valid once, for \d+ (s|min) more"))).to_be_visible()
    job.press("Copy")
    expect(page.get_by_text("Copied.")).to_be_visible()
    job.keep("line")
    key = str(ReceiverKey.generate().public)
    claim = {"label": "laptop", "key": key, "secret": line.secret.hex()}
    answer = httpx.post(f"{line.url}/v1/pairing/claim", json=claim)
    assert answer.status_code == 201, answer.text
    paired = page.get_by_role("listitem").filter(has_text="laptop")
    expect(paired).to_contain_text("Fingerprint")
    expect(page.get_by_text("“laptop” is paired.")).to_be_visible()
    expect(page.locator(".secret")).to_have_count(0)
    job.keep("paired")
    job.press("Remove laptop")
    job.press("Remove")
    expect(page.get_by_text("Nobody is paired")).to_be_visible()
    job.done()
    daemon.revoke(answer.json()["token"])


def test_line_that_expires_disappears(open_page: Open) -> None:
    offer = PairingOffer(
        line=f"veilcam://127.0.0.1:1/#{22 * 'A'}",
        code=("101", "010", "101"),
        role="operator",
        expires_at=datetime(2026, 1, 1, 0, 0, 4, tzinfo=UTC),
    )
    page = open_page("/#receivers")
    headers = {"Date": "Thu, 01 Jan 2026 00:00:00 GMT"}
    page.route(
        "**/v1/pairing",
        lambda route: route.fulfill(json=offer.model_dump(mode="json"), headers=headers),
    )
    page.get_by_role("button", name="Pair a receiver").click()
    expect(page.locator(".secret")).to_be_visible()
    expect(page.get_by_text("The line has expired")).to_be_visible()
    expect(page.locator(".secret, canvas")).to_have_count(0)


def test_job_change_the_bundle(begin: Callable[[str], Job], tmp_path: Path) -> None:
    newer = Path(shutil.copy(FRESH, tmp_path / "newer.veilcam"))
    add_card(newer, make_card(read_bundle(newer).subject))
    sign_bundle(newer, 2, None)
    job = begin("bundle")
    page = job.page
    job.view("Bundles")
    used = page.get_by_role("region", name="In use").locator("> .big")
    first = used.inner_text()
    job.reach(page.get_by_label("A file *.veilcam"))
    page.get_by_label("A file *.veilcam").set_input_files(newer)
    job.press("Upload")
    expect(page.get_by_text("can be used here. Read its card, then activate it.")).to_be_visible()
    expect(page.get_by_role("progressbar")).to_have_js_property("value", 1)
    use = page.get_by_role("button", name=re.compile("^Activate mnist"))
    other = str(use.get_attribute("aria-label")).removeprefix("Activate ")
    checked = page.get_by_role("region", name=other, exact=True)
    expect(checked.get_by_text("What its masks give away")).to_be_visible()
    expect(checked.get_by_text("Privacy card: FAIL")).to_be_visible()
    job.keep("checked")
    job.press(f"Activate {other}")
    expect(used).to_have_text(other)
    job.press(f"Go back to {first}")
    job.press("Use it")
    expect(used).to_have_text(first)
    job.press(f"Remove {other}")
    job.press("Remove")
    expect(page.get_by_text("There is no other bundle on this camera.")).to_be_visible()
    job.keep("back")
    job.done()


def test_job_calibrate(begin: Callable[[str], Job]) -> None:
    job = begin("calibrate")
    page = job.page
    job.view("Calibrate")
    for scene in ("Dark", "White card", "Lamp"):
        expect(page.locator(".scenes li", has_text=scene)).to_be_visible()
    job.keep("before")
    job.press("How exact", "summary")
    job.type("Exposures for one measurement", "100")
    job.press("Begin")
    expect(page.get_by_role("progressbar")).to_be_visible()
    expect(page.get_by_text(re.compile(r"^\d+ of \d+ exposures, about .* left$"))).to_be_visible()
    job.keep("measuring")
    job.press("End it")
    dialog = page.get_by_role("dialog")
    job.reach(dialog.get_by_role("button", name="End it"))
    page.keyboard.press("Space")
    expect(page.get_by_text("The calibration was ended")).to_be_visible()
    expect(page.locator("#state")).to_have_text("Ready")
    job.done()


def test_job_tokens_by_role(begin: Callable[[str], Job], daemon: Daemon) -> None:
    job = begin("tokens")
    page = job.page
    job.view("Tokens")
    job.type("For whom or what", "hall lamp")
    job.press("operator", key="Space")
    job.keep("role")
    job.press("Make token")
    expect(page.locator(".secret")).to_have_text(re.compile("^vc_"))
    job.keep("secret")
    job.press("Done")
    expect(page.locator(".secret")).to_have_count(0)
    listed = page.get_by_role("listitem").filter(has_text="hall lamp")
    expect(listed).to_contain_text("operator")
    with daemon.camera() as camera:
        listing = camera.tokens.list().tokens
    (made,) = (each for each in listing if each.label == "hall lamp" and not each.revoked_at)
    assert made.role == "operator"
    job.press("Revoke hall lamp")
    job.press("Revoke")
    expect(listed).to_have_count(0)
    job.done()
