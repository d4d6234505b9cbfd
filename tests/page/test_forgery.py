"""A page on another port of this host, in the browser that is logged in: nothing comes of it.

Its requests are of the same site, so that the browser sends the cookie with them.
"""

from __future__ import annotations

import http.server
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest
from playwright.sync_api import Browser, Page, StorageState
from tests.page.conftest import Daemon

from veilcam_client.models import RotationOff

pytestmark = pytest.mark.page

ATTEMPTS = """
async ({url, half}) => {
  const ways = {
    plain: {method: "POST", credentials: "include", mode: "no-cors"},
    text: {method: "POST", credentials: "include", mode: "no-cors", body: "{}"},
    json: {method: "POST", credentials: "include", headers: {"Content-Type": "application/json"}},
    header: {method: "POST", credentials: "include", headers: {"Veilcam-Session": half}},
    read: {credentials: "include"},
  };
  const learned = {};
  for (const [name, way] of Object.entries(ways)) {
    const path = name === "read" ? "/v1/status" : "/v1/rotation/advance";
    try {
      const answer = await fetch(url + path, way);
      learned[name] = answer.type === "opaque" ? null : await answer.text();
    } catch { learned[name] = null; }
  }
  const frame = document.createElement("iframe");
  frame.name = "target";
  document.body.append(frame);
  const form = Object.assign(document.createElement("form"), {
    method: "POST", action: url + "/v1/rotation/advance", target: "target",
  });
  document.body.append(form);
  // What is refused need not load: a while is what there is to wait for.
  const loaded = (begin) => new Promise((resolve) => {
    frame.onload = resolve;
    setTimeout(resolve, 2000);
    begin();
  });
  await loaded(() => form.submit());
  for (const path of ["/", "/docs"]) {
    await loaded(() => { frame.src = url + path; });
    try { learned[`frame ${path}`] = frame.contentDocument?.body.innerText ?? null; }
    catch { learned[`frame ${path}`] = null; }
  }
  return learned;
}
"""

Server = tuple[str, list[str]]


class _Page(http.server.BaseHTTPRequestHandler):
    cookies: list[str]

    def do_GET(self) -> None:
        self.rfile.read(int(self.headers.get("Content-Length", 0)))
        self.cookies.append(self.headers.get("Cookie", ""))
        self.send_response(200)
        self.send_header("Content-Type", "text/html")
        self.end_headers()
        self.wfile.write(b"<!DOCTYPE html><title>Another page</title><body></body>")

    def do_POST(self) -> None:
        self.do_GET()

    def log_message(self, *_: object) -> None:
        pass


@contextmanager
def serving() -> Iterator[Server]:
    """A server on another port of this host, and the cookies that browsers sent to it."""
    cookies: list[str] = []
    handler = type("Page", (_Page,), {"cookies": cookies})
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}", cookies
        server.shutdown()
        thread.join()


@pytest.fixture
def page(chromium: Browser, logged_in: StorageState) -> Iterator[Page]:
    with serving() as (other, _), chromium.new_context(storage_state=logged_in) as context:
        page = context.new_page()
        page.goto(other)
        yield page


def test_no_other_page_drives_the_daemon_through_a_browser_that_is_logged_in(
    daemon: Daemon, logged_in: StorageState, page: Page
) -> None:
    with daemon.camera() as camera:
        # From here on a mask changes by request alone; a change that was under way is over.
        camera.rotation.set(RotationOff())
        before = camera.rotation.advance().epoch
    half = json.loads(json.dumps(logged_in))["origins"][0]["localStorage"][0]["value"]
    # Even with the page's half, were it to know it.
    for known in ("0" * 64, half):
        learned = page.evaluate(ATTEMPTS, {"url": daemon.url, "half": known})
        assert {name: told for name, told in learned.items() if told} == {}
    assert page.evaluate("localStorage.length") == 0
    with daemon.camera() as camera:
        assert camera.rotation.get().epoch == before
    # The browser does send its half, to every port: nothing but the other one stood in the way.
    with serving() as (target, cookies):
        page.evaluate(ATTEMPTS, {"url": target, "half": half})
    # Two plain posts and what is read, at least; for the others it asks first whether it may.
    assert sum("veilcam-session" in each for each in cookies) >= 3
