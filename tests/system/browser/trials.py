"""Trials of a page on daemons of their own: where it comes from, and under which name it asks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import httpx
from tests.system.browser.asks import Ask
from tests.system.browser.foreign_page import Result, Watched, show

from veilcam_client.wire.tokens import SCOPES
from veilcam_server.demo.daemon import running
from veilcam_server.demo_data import BUNDLE, load_digits
from veilcam_server.devices.simulated.scenes import write_scene
from veilcam_server.security.tokens import TokenStore

LAN_NAME = "camera.lan"
"""An address that is no loopback's, so that browsers leave ``Sec-Fetch-Site`` out without TLS."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One page; ``daemon`` is None where its own name has come to lead to the daemon."""

    auth: str
    host: str
    daemon: str | None


TRIALS = {
    "another site": Trial("none", "page.example", "127.0.0.1"),
    "another port": Trial("none", "localhost", "localhost"),
    "no Sec-Fetch-Site": Trial("none", "page.example", LAN_NAME),
    "a name that was rebound": Trial("none", "page.example", None),
    "a daemon with tokens": Trial("tokens", "page.example", "127.0.0.1"),
}


@contextmanager
def daemon(folder: Path, auth: str) -> Iterator[Watched]:
    folder.mkdir()
    state, scene, headers = folder / "state", folder / "scene.npy", {}
    write_scene(scene, load_digits().images[0])
    if auth == "tokens":
        store = TokenStore(state)
        headers["Authorization"] = f"Bearer {store.create('watch', SCOPES, None).secret}"
    options = (
        *("--auth", auth, "--scene-api", "--hosts", LAN_NAME, "--settle", "0", "--exposure", "0"),
        # What a page could learn stands in the clear.
        *("--release", "raw", "--raw-budget", "1000"),
    )
    with running(BUNDLE, scene, folder, *options) as url:
        yield Watched(url, state, headers)


def try_page(
    program: str, folder: Path, trial: Trial, asks: Mapping[str, Ask], at: Watched
) -> Result:
    port = httpx.URL(at.url).port
    target = None if trial.daemon is None else f"http://{trial.daemon}:{port}"
    return show(program, folder, asks, at, host=trial.host, target=target)


def try_program(asks: Mapping[str, Ask], at: Watched) -> list[str]:
    idle = []
    with httpx.Client(base_url=at.url, headers=at.headers, trust_env=False, timeout=60) as client:
        for name, ask in asks.items():
            before = at.state()
            answered = ask.by_program(client)
            if not answered or (ask.method != "GET" and at.state() == before):
                idle.append(name)
            client.delete("/v1/lease", params={"force": "true"})
        client.delete("/v1/calibration")
    return idle
