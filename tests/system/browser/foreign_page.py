"""Server of a page of another site, the browser that shows it, and what came of its requests."""

from __future__ import annotations

import http.client
import http.server
import json
import os
import shutil
import signal
import subprocess
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import httpx
from tests.system.browser.asks import Ask
from tests.unit.server.logs import events

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
PATIENCE = 300.0
"""Longest wait for a page to have made all its requests [s]; they take about 20."""
LONGEST_ANSWER = 60.0  # [s]
STATE = ("rotation", "bundles", "lease", "calibration", "receivers")


def browser() -> str | None:
    return next(filter(None, map(shutil.which, PROGRAMS)), None)


@dataclass(frozen=True)
class Watched:
    url: str
    state_dir: Path
    headers: Mapping[str, str] = field(default_factory=dict)

    def state(self) -> dict[str, Any]:
        with httpx.Client(
            base_url=self.url, headers=self.headers, trust_env=False, timeout=LONGEST_ANSWER
        ) as client:
            found = {path: client.get(f"/v1/{path}").json() for path in STATE}
            diagnostics = client.get("/v1/diagnostics").json()
            found["events"] = diagnostics["events"]
            if self.headers:
                found["tokens"] = client.get("/v1/tokens").json()
        # Time goes by, and the next mask is prepared.
        del found["rotation"]["epoch_age_s"], found["rotation"]["preparation"]
        # What is refused for another reason than the site stands here too.
        found["done"] = len(events(self.state_dir, "request"))
        return found

    def refusals(self) -> list[str]:
        return [entry["code"] for entry in events(self.state_dir, "refused")]


@dataclass
class Result:
    """What the page of one site read (None: nothing), changed, and was refused for."""

    learned: dict[str, str | None] = field(default_factory=dict)
    changed: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)

    @property
    def acted(self) -> list[str]:
        told = [name for name, learned in self.learned.items() if learned is not None]
        return sorted({*told, *self.changed})


class _Handler(http.server.BaseHTTPRequestHandler):
    server: _Server

    def do_GET(self) -> None:
        if self.path.startswith("/v1/"):
            self._relay()
        elif self.path == "/asks":
            self._answer(json.dumps(self.server.told()).encode(), "application/json")
        elif self.path.startswith("/noticed/"):
            noticed = self.server.noticed(self.path.removeprefix("/noticed/"))
            self._answer(json.dumps(noticed).encode(), "application/json")
        elif self.path.startswith("/body/"):
            self._answer(self.server.asks[self.path.removeprefix("/body/")].body, "x/x")
        else:
            self._answer(Path(__file__).with_name("page.html").read_bytes(), "text/html")

    def do_POST(self) -> None:
        if self.path.startswith("/v1/"):
            self._relay()
            return
        content = self.rfile.read(int(self.headers.get("Content-Length", "0")))
        if self.path == "/done":
            self.server.done.set()
        else:
            self.server.note(self.path.removeprefix("/learned/"), json.loads(content))
        self._answer(b"", "text/plain")

    do_PUT = do_DELETE = do_OPTIONS = do_POST  # noqa: N815

    def _relay(self) -> None:
        """The name of this server leads to the daemon now: what comes goes there as it is."""
        target = urlsplit(self.server.watched.url)
        connection = http.client.HTTPConnection(
            target.hostname or "", target.port, timeout=LONGEST_ANSWER
        )
        content = self.rfile.read(int(self.headers.get("Content-Length", "0")))
        connection.putrequest(self.command, self.path, skip_host=True, skip_accept_encoding=True)
        for name, value in self.headers.items():
            connection.putheader(name, value)
        connection.endheaders(content)
        answer = connection.getresponse()
        self.send_response(answer.status)
        self.send_header("Content-Type", answer.headers["Content-Type"])
        self.end_headers()
        self.wfile.write(answer.read1(2**16))
        connection.close()

    def _answer(self, content: bytes, media_type: str) -> None:
        self.send_response(200)
        self.send_header("Content-Type", media_type)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: object) -> None:
        pass


class _Server(http.server.ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self, asks: Mapping[str, Ask], target: str | None, watched: Watched) -> None:
        super().__init__(("127.0.0.1", 0), _Handler)
        self.asks, self.watched, self._target = asks, watched, target
        self.done, self.result = threading.Event(), Result()
        self._before, self._refused = watched.state(), len(watched.refusals())
        self._refused_so_far = self._refused

    def told(self) -> list[dict[str, Any]]:
        # Without a target the page asks its own host, whose name has come to lead to the daemon.
        return [ask.for_page(self._target or "") for ask in self.asks.values()]

    def note(self, name: str, learned: str | None) -> None:
        self.result.learned[name] = learned
        self.noticed(name)
        self._refused_so_far = len(self.watched.refusals())

    def noticed(self, name: str) -> bool:
        """Whether the daemon refused this request, the only one under way, or is another by it."""
        now = self.watched.state()
        changed, self._before = now != self._before, now
        if changed:
            self.result.changed.append(name)
        return changed or len(self.watched.refusals()) > self._refused_so_far

    def finish(self) -> Result:
        self.result.refused = self.watched.refusals()[self._refused :]
        return self.result


def show(
    program: str,
    folder: Path,
    asks: Mapping[str, Ask],
    watched: Watched,
    *,
    host: str,
    target: str | None,
) -> Result:
    server = _Server(asks, target, watched)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    try:
        with _running(program, folder, f"http://{host}:{server.server_port}/"):
            if not server.done.wait(PATIENCE):
                asked = ", ".join(server.result.learned) or "nothing"
                raise TimeoutError(f"the page has not come to its end; asked: {asked}")
        return server.finish()
    finally:
        server.shutdown()
        server.server_close()


@contextmanager
def _running(program: str, folder: Path, url: str) -> Iterator[None]:
    folder.mkdir(parents=True, exist_ok=True)
    command = [
        *(program, "--headless", "--disable-gpu", "--disable-dev-shm-usage", "--no-first-run"),
        # The page is ours, and root has no sandbox.
        *("--no-sandbox", "--disable-popup-blocking", "--disable-background-networking"),
        *(f"--user-data-dir={folder / 'profile'}", "--no-proxy-server"),
        *("--host-resolver-rules=MAP * 127.0.0.1", url),
    ]
    with (folder / "browser.log").open("w") as log:
        process = subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True)
        try:
            yield
        finally:
            # With all that it has started.
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
