"""Lines of curl and of Python in the OpenAPI document: each does what it stands beside."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest
import uvicorn
from jsonschema import Draft202012Validator  # type: ignore[import-untyped]
from PIL import Image
from pydantic import BaseModel
from tests.unit.server.conftest import make_bundle

from veilcam_client import Camera, models
from veilcam_client.errors import ApiError
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.pairing import PairingLine
from veilcam_client.wire.rotation import RotationOff
from veilcam_client.wire.tokens import SCOPES
from veilcam_server.api.app import create_app
from veilcam_server.api.openapi import document
from veilcam_server.api.samples import SAMPLES, URL
from veilcam_server.daemon import build_service
from veilcam_server.devices.simulated.scenes import write_scene
from veilcam_server.security.admission import open_admission
from veilcam_server.settings import Settings
from veilcam_training.bundle import write_bundle

pytestmark = pytest.mark.slow

REFUSED = {"confirm_scene": 409}
"""A simulated camera sets its scenes itself, so that none is waited for."""


@dataclass
class Daemon:
    """One in this process, with a camera that is asked between samples."""

    url: str
    document: dict[str, Any]
    camera: Camera
    folder: Path
    variables: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.other = (self.folder / "hall.veilcam").read_bytes()
        paths = self.document["paths"].values()
        self.operations = {each["operationId"]: each for path in paths for each in path.values()}

    def prepare(self, operation: str) -> None:
        camera, names = self.camera, self.variables
        match operation:
            case "begin_session" | "end_session":
                answer = httpx.post(f"{self.url}/v1/session", headers=self.headers)
                names["HALF"] = answer.json()["half"]
                name, value = next(iter(answer.cookies.items()))
                # As curl keeps cookies: name and value of a host, for a path.
                row = ("#HttpOnly_127.0.0.1", "FALSE", "/v1", "FALSE", "0", name, value)
                (self.folder / "cookies").write_text("\t".join(row) + "\n")
            case "revoke_token":
                names["TOKEN_ID"] = camera.tokens.create("gone", ["classify"], seconds=60).id
            case "add_receiver" | "remove_receiver" | "claim_pairing":
                key = ReceiverKey.generate().public
                names["RECEIVER_KEY"] = str(key)
                if operation == "remove_receiver":
                    names["RECEIVER_ID"] = camera.receivers.add("gone", key).id
                if operation == "claim_pairing":
                    line = PairingLine.parse(camera.receivers.offer().line)
                    names["SECRET"] = line.secret.hex()
            case "activate_bundle" | "remove_bundle":
                first = next(each for each in camera.bundles.list().bundles if each.configured)
                camera.bundles.activate(first.digest)
                names["DIGEST"] = camera.bundles.install(self.other).digest
            case "events":
                # Something happens once the stream is there.
                threading.Timer(0.3, camera.rotation.advance).start()
            case "cancel_calibration":
                camera.calibration.start(repeats=2)
            case "log":
                camera.classify()

    def clear(self, operation: str) -> None:
        match operation:
            case "start_calibration":
                self.camera.calibration.cancel()
            case "set_watch":
                self.camera.watch.set(models.OnRequest())
            case "take_lease":
                self.camera.lease.release()
            case "set_faults":
                self.camera.simulation.set_faults(models.Faults())
                self.camera.rotation.advance()
            case "add_receiver" | "claim_pairing":
                for each in self.camera.receivers.list().receivers:
                    self.camera.receivers.remove(each.id)

    @property
    def headers(self) -> dict[str, str]:
        return {"Authorization": f"Bearer {self.variables['TOKEN']}"}


@contextmanager
def serving(app: Any) -> Iterator[str]:
    config = uvicorn.Config(app, port=0, log_config=None, timeout_graceful_shutdown=1)
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        while not server.started:
            time.sleep(0.01)
        host, port = server.servers[0].sockets[0].getsockname()
        yield f"http://{host}:{port}"
    finally:
        server.should_exit = True
        thread.join()


@pytest.fixture(scope="module")
def daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    folder = tmp_path_factory.mktemp("samples")
    bundle, scene = folder / "first.veilcam", folder / "scene.npy"
    write_bundle(bundle, make_bundle())
    write_bundle(folder / "hall.veilcam", dataclasses.replace(make_bundle(), task="hall"))
    # Gray: behind an open window a bright scene and its noise saturate the sensor.
    picture = np.full((28, 28), 100, np.uint8)
    write_scene(scene, picture)
    Image.fromarray(picture).save(folder / "scene.png")
    settings = Settings(
        device="simulated",
        auth="tokens",
        bundle=bundle,
        scenes=(str(scene),),
        scene_api=True,
        state_dir=folder / "state",
        settle=0.0,
        exposure=0.0,
        rotation=RotationOff(),
        release="raw",
        raw_budget=1000,
    )
    service = build_service(settings)
    with open_admission(settings) as admission:
        assert admission.tokens is not None
        token = admission.tokens.create("samples", SCOPES, None).secret
        app = create_app(service, admission)
        with serving(app) as url, Camera(url, token=token) as camera:
            yield Daemon(url, document(app), camera, folder, {"TOKEN": token})


OPERATIONS = [
    *SAMPLES,
    *("metrics", "openapi", "doctor", "page", "docs", "page_file", "healthz", "readyz"),
]


def sources(daemon: Daemon, operation: str) -> tuple[dict[str, str], dict[str, Any]]:
    found = daemon.operations[operation]
    return {each["lang"]: each["source"] for each in found["x-codeSamples"]}, found


def by_curl(daemon: Daemon, source: str) -> tuple[int, str]:
    """Status and body of the answer to a line of curl; of a stream, what comes in a second."""
    longest = 1 if "--no-buffer" in source else 60
    options = f'curl -s -m {longest} -w "\\n%{{http_code}}"'
    line = source.replace(URL, daemon.url).replace("curl", options, 1)
    done = subprocess.run(
        ["sh", "-c", line],
        cwd=daemon.folder,
        env={**os.environ, **daemon.variables, "NAME": "app.js", "no_proxy": "*"},
        capture_output=True,
        text=True,
        check=False,
    )
    body, _, status = done.stdout.rpartition("\n")
    return int(status), body


def by_python(daemon: Daemon, source: str) -> Any:
    names = {
        **vars(models),
        **{name.lower(): value for name, value in daemon.variables.items()},
        "httpx": httpx,
        "Path": Path,
        "camera": daemon.camera,
        "name": "app.js",
    }
    return eval(source.replace(URL, daemon.url), names)


def check(daemon: Daemon, found: dict[str, Any], status: int, body: str) -> None:
    content = found["responses"][str(status)].get("content", {})
    if "application/json" in content:
        schema = {
            **content["application/json"]["schema"],
            "components": daemon.document["components"],
        }
        assert not list(Draft202012Validator(schema).iter_errors(json.loads(body)))
    else:
        assert bool(body) is bool(content)


@pytest.mark.thorough
@pytest.mark.parametrize("operation", OPERATIONS)
def test_both_lines_do_what_they_stand_beside(
    daemon: Daemon, operation: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(daemon.folder)
    lines, found = sources(daemon, operation)
    good = next(int(status) for status in found["responses"] if status < "300")
    expected = REFUSED.get(operation, good)

    daemon.prepare(operation)
    if shutil.which("curl") is None:
        pytest.skip("no curl: on Debian, apt install curl")
    status, body = by_curl(daemon, lines["curl"])
    assert status == expected, body
    if status == good:
        check(daemon, found, status, body)
    daemon.clear(operation)

    daemon.prepare(operation)
    ask: Callable[[], Any] = lambda: by_python(daemon, lines["Python"])  # noqa: E731
    if operation in REFUSED:
        with pytest.raises(ApiError) as refused:
            ask()
        assert refused.value.status == expected
    else:
        result = ask()
        if isinstance(result, httpx.Response):
            assert result.status_code == good
            check(daemon, found, good, result.text)
        else:
            assert isinstance(result, BaseModel)
    daemon.clear(operation)


def test_every_operation_is_among_them(daemon: Daemon) -> None:
    assert set(daemon.operations) == set(OPERATIONS)
