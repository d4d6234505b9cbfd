"""A daemon that can be restarted, and Chromium, which shows its page and notes what is asked."""

from __future__ import annotations

import random
import shutil
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any, TypeAlias
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import (
    Browser,
    BrowserContext,
    ConsoleMessage,
    Page,
    Request,
    StorageState,
    ViewportSize,
    expect,
    sync_playwright,
)

from veilcam_client import Camera
from veilcam_client.wire.tokens import SCOPES, Scope
from veilcam_server.demo.daemon import running
from veilcam_server.demo_data import FRESH, load_digits
from veilcam_server.devices.simulated.scenes import write_scene
from veilcam_server.security.tokens import TokenStore

PATIENCE = 120_000.0
"""Longest wait for what a page shall show, on a machine that does much else [ms]."""
CAPTURES = 8
"""Behind each mask: the light of a fresh one takes a simulated camera a fifth of a second, which at
two a second would be half of all that these tests compute."""
AXE = files("axe_playwright_python").joinpath("axe.min.js").read_text()
WIDE: ViewportSize = {"width": 1200, "height": 900}
PHONE: ViewportSize = {"width": 360, "height": 740}

PORTS = range(16_384, 32_768)
"""Below those that a system gives to whoever asks for any: no connection has one of these, so that
nothing takes the daemon's while it is down."""


def free_port() -> int:
    while True:
        with socket.socket() as probe, suppress(OSError):
            probe.bind(("127.0.0.1", port := random.choice(PORTS)))
            return port


@dataclass
class Daemon:
    folder: Path
    port: int = field(default_factory=free_port)
    _started: ExitStack = field(default_factory=ExitStack)

    def __post_init__(self) -> None:
        self.url = f"http://127.0.0.1:{self.port}"
        self.scene = self.folder / "scene.npy"
        write_scene(self.scene, load_digits().images[0])
        self.tokens = TokenStore(self.folder / "state")
        self.token = self.make_token("all")

    def make_token(
        self, label: str, scopes: tuple[Scope, ...] = SCOPES, lifetime: float | None = None
    ) -> str:
        return self.tokens.create(label, scopes, lifetime).secret

    def revoke(self, token: str) -> None:
        self.tokens.revoke(token.split("_")[1])

    def camera(self) -> Camera:
        return Camera(self.url, token=self.token)

    def start(self) -> None:
        options = (
            *("--auth", "tokens", "--scene-api", "--watch", "2/s", "--port", str(self.port)),
            *("--settle", "0", "--exposure", "0", "--every-captures", str(CAPTURES)),
            *("--release", "raw", "--raw-budget", "1000000"),
        )
        self._started.enter_context(running(FRESH, self.scene, self.folder, *options))

    def stop(self) -> None:
        self._started.close()


@pytest.fixture(scope="session")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    made = Daemon(tmp_path_factory.mktemp("daemon"))
    made.start()
    yield made
    made.stop()


@pytest.fixture(scope="session")
def chromium() -> Iterator[Browser]:
    program = shutil.which("chromium")
    assert program is not None, "there is no Chromium: on Debian, apt install chromium"
    expect.set_options(timeout=PATIENCE)
    with sync_playwright() as playwright:
        # The pages are ours, and root has no sandbox. It draws faster without an emulated graphics
        # card.
        found = playwright.chromium.launch(
            executable_path=program, chromium_sandbox=False, args=["--disable-gpu"]
        )
        yield found
        found.close()


@pytest.fixture(scope="session")
def logged_in(chromium: Browser, daemon: Daemon) -> StorageState:
    context = chromium.new_context()
    page = context.new_page()
    page.set_default_timeout(PATIENCE)
    page.goto(daemon.url)
    log_in(page, daemon.token)
    expect(page.get_by_role("heading", name="Live")).to_be_visible()
    listening(page)
    state = context.storage_state()
    context.close()
    return state


def log_in(page: Page, token: str) -> None:
    page.get_by_label("Token").fill(token)
    page.get_by_role("button", name="Log in").click()


def confirm(page: Page, asked: str, answer: str | None = None) -> None:
    page.get_by_role("button", name=asked).click()
    page.get_by_role("dialog").get_by_role("button", name=answer or asked).click()


def listening(page: Page) -> None:
    expect(page.locator("h1")).to_be_visible()
    expect(page.locator("main")).not_to_have_attribute("aria-busy", "true")


def violations(page: Page) -> list[str]:
    # Without the places of what is well, which take most of the time on a long page.
    found = page.evaluate("async () => (await axe.run({ resultTypes: ['violations'] })).violations")
    return [
        f"{each['id']}: {', '.join(str(node['target']) for node in each['nodes'])}"
        for each in found
    ]


Open: TypeAlias = Callable[..., Page]


@pytest.fixture
def open_page(
    chromium: Browser,
    daemon: Daemon,
    logged_in: StorageState,
    record_property: Callable[[str, object], None],
) -> Iterator[Open]:
    """Opens pages of the daemon; none of them may ask anybody else, or come upon an error."""
    contexts: list[BrowserContext] = []
    outside: list[str] = []
    errors: list[str] = []

    def asked(request: Request) -> None:
        own = urlsplit(request.url).netloc == urlsplit(daemon.url).netloc
        if not (own or request.url.startswith("data:")):
            outside.append(request.url)

    def told(message: ConsoleMessage) -> None:
        # That an answer was a problem is told by the page; what its policy keeps from it is not.
        if message.type == "error" and "Failed to load resource" not in message.text:
            errors.append(message.text)

    def watch(page: Page) -> None:
        page.set_default_timeout(PATIENCE)
        page.on("request", asked)
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.on("console", told)

    def opened(path: str = "/", *, known: bool = True, axe: bool = False, **settings: Any) -> Page:
        context = chromium.new_context(
            storage_state=logged_in if known else None,
            **{"viewport": WIDE, "color_scheme": "light", **settings},
        )
        if axe:
            context.add_init_script(AXE)
        contexts.append(context)
        page = context.new_page()
        watch(page)
        page.goto(daemon.url + path)
        listening(page)
        return page

    yield opened
    for context in contexts:
        context.close()
    record_property("outside_requests", len(outside))
    assert outside == []
    assert errors == []


@pytest.fixture(autouse=True)
def _as_it_was(daemon: Daemon) -> Iterator[None]:
    """Whatever a test did to the camera, the next one finds it well, and looking."""
    yield
    from veilcam_client.errors import ApiError
    from veilcam_client.models import EveryCaptures, Faults, Watching

    with daemon.camera() as camera:
        # One that a test left behind when it failed.
        with suppress(ApiError):
            camera.calibration.cancel()
        camera.simulation.set_faults(Faults())
        camera.simulation.hold_scene(None)
        camera.watch.set(Watching(rate_hz=2.0))
        camera.rotation.set(EveryCaptures(captures=CAPTURES))
        # A camera that failed tests its panel before it is ready.
        ends = time.monotonic() + PATIENCE / 1000
        while camera.status().state != "ready" or camera.watch.get().activity != "looking":
            assert time.monotonic() < ends, (camera.status(), camera.watch.get())
            time.sleep(0.1)
