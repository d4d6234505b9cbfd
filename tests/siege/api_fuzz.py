"""Every route of the API under made-up requests, by callers of every kind; nothing secret leaves.

    python -m tests.siege.api_fuzz --figures benchmarks/results/daemon.json

Schemathesis makes requests from the daemon's own OpenAPI document, valid ones and others. A real
daemon gets them over TCP, from callers with each single scope, with all, with none, and with tokens
that are revoked or missing; with stored masks and raw embeddings, and with fresh masks whose
embeddings leave white or sealed. No answer may be a 5xx but a documented 503, nor have a status, a
media type or a shape that the document does not name.

Then every byte that left is searched for what must not leave (``leaks``). What left is every header
and body, the log, the metrics, the events and the audit files. Keys of epochs are those that a
receiver opens: the daemon tells them to nobody else. Of its private key the state directory must
hold nothing.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import hypothesis
import numpy as np
import requests
import schemathesis
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.rig import work_folder
from hypothesis.errors import Unsatisfiable
from jsonschema import Draft202012Validator  # type: ignore[import-untyped]
from rich.progress import track
from schemathesis.core.result import Ok
from tests.siege.leaks import Planted, plant, plant_device, plant_epochs, plant_receiver

from veilcam_client.keys.blocks import Opener
from veilcam_client.keys.envelopes import open_key
from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE
from veilcam_client.wire.captures import NPY_MEDIA_TYPE, Capture, SealedEmbedding
from veilcam_client.wire.sealing import Release
from veilcam_client.wire.tokens import SCOPES
from veilcam_server.demo.daemon import running
from veilcam_server.demo_data import BUNDLE, FRESH, load_digits
from veilcam_server.devices.simulated.scenes import write_scene
from veilcam_server.sealing.receivers import ReceiverStore
from veilcam_server.security.audit import DONE, REFUSED
from veilcam_server.security.tokens import TokenStore
from veilcam_training.bundle import Bundle, read_bundle

EVENTS, LISTENED = 2048, 1.0
"""Of an event stream so much is read [bytes], and for so long [s]."""
MORE = 5
"""So many times as many requests come from the caller with every scope."""
RAW_BUDGET = 200
"""Embeddings that may leave raw behind one mask: so few that all masks are spent on the way."""
BUNDLE_BYTES = 1_000_000
"""Files of a state directory that are larger are bundles."""
TAKING = ("/v1/captures", "/v1/classifications")
"""Routes whose answers hold embeddings."""
PROBES = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE", "BREW")

# Made-up bytes, as for every file.
schemathesis.serializer.alias([BUNDLE_MEDIA_TYPE, NPY_MEDIA_TYPE], "application/octet-stream")

_UNIQUE = re.compile(
    rb"(?im)(^(x-request-id|date): .*$|\b(request_id|request|at|timestamp|ms)\b[^,}]*)"
)
"""Of headers and log lines: what makes each different and holds nothing."""


@dataclass
class Findings:
    """What came back."""

    requests: int = 0
    statuses: Counter[int] = field(default_factory=Counter)
    defects: list[str] = field(default_factory=list)
    """5xx other than a documented 503."""
    undocumented: list[str] = field(default_factory=list)
    """Statuses, media types and shapes that the document does not name."""
    left: dict[bytes, str] = field(default_factory=dict)
    """Everything that left, and where it was seen first."""
    sealed: dict[tuple[str, int], Capture] = field(default_factory=dict)
    """Sealed embeddings, by epoch and number."""
    made: set[str] = field(default_factory=set)
    """Tokens that were made meanwhile; each left once, in the answer that made it."""

    def leaks(self, planted: Planted) -> list[str]:
        """Where something was found that must not leave."""
        found = []
        for content, place in track(self.left.items(), "searching"):
            found += [f"{place}: {name}" for name in planted.found_in(content)]
            found += [f"{place}: a token" for token in self.made if token[16:].encode() in content]
        return found


class Fuzz:
    """Asks one daemon, and checks every answer against its document.

    Args:
        url: of the daemon.
        callers: Authorization headers by name, None for none; one is ``everything``.
        examples: requests of each kind for each operation; five times as many where every scope
            is there, which hides nothing behind a 403.
        seed: that they are made from.
    """

    def __init__(
        self, url: str, callers: Mapping[str, str | None], examples: int, seed: int
    ) -> None:
        self.findings = Findings()
        self._url, self._callers = url, callers
        self._session = requests.Session()
        self._session.trust_env = False
        headers = {"Authorization": callers["everything"] or ""}
        answer = self._session.get(f"{url}/v1/openapi.json", headers=headers)
        answer.raise_for_status()
        self._document: dict[str, Any] = answer.json()
        schema = schemathesis.openapi.from_dict(self._document)
        operations = [each.ok() for each in schema.get_all_operations() if isinstance(each, Ok)]
        assert len(operations) == sum(map(len, self._document["paths"].values()))
        self._cases = {
            (each.method.upper(), each.path): _cases(each, MORE * examples, seed)
            for each in operations
        }

    def run(self, bundle: bytes | None = None) -> None:
        """Send everything, as every caller; upload ``bundle`` as well."""
        for name in track(self._callers, "asking"):
            for (method, path), cases in self._cases.items():
                for case in cases if name == "everything" else cases[::MORE]:
                    self._send(name, method, path, case.as_transport_kwargs(base_url=self._url))
            self._pair(name)
            if bundle is not None:
                path = "/v1/bundles"
                headers = {"Content-Type": BUNDLE_MEDIA_TYPE}
                upload = {"url": self._url + path, "headers": headers}
                self._send(name, "POST", path, {**upload, "data": bundle})
                digest = hashlib.sha256(bundle).hexdigest()
                url = f"{self._url}{path}/{digest}/activate"
                self._send(name, "POST", f"{path}/{{digest}}/activate", {"url": url})
        for name in ("everything", "nobody"):
            for path, operations in self._document["paths"].items():
                url = self._url + re.sub(r"\{\w+\}", "0", path)
                for method in PROBES:
                    # HEAD is GET without a body.
                    if {"HEAD": "get"}.get(method, method.lower()) not in operations:
                        self._send(name, method, None, {"url": url})

    def _pair(self, name: str) -> None:
        """Pair a receiver twice, look for it, and remove it twice."""
        path, guest = "/v1/receivers", ReceiverKey.generate().public
        url = self._url + path
        for _ in range(2):
            question = {"label": "guest", "key": str(guest)}
            self._send(name, "POST", path, {"url": url, "json": question})
        self._send(name, "GET", path, {"url": url})
        for _ in range(2):
            self._send(name, "DELETE", f"{path}/{{receiver_id}}", {"url": f"{url}/{guest.id}"})

    def _send(self, name: str, method: str, path: str | None, request: dict[str, Any]) -> None:
        headers = {
            key: value
            for key, value in (request.pop("headers", None) or {}).items()
            if key.lower() != "authorization"
        }
        authorization = self._callers[name]
        if authorization is not None:
            headers["Authorization"] = authorization
        request = {**request, "method": method, "headers": headers, "stream": True}
        with self._session.request(**request, timeout=60) as answer:
            content = _read(answer) if _streams(path) and answer.ok else answer.content
        findings = self.findings
        findings.requests += 1
        findings.statuses[answer.status_code] += 1
        place = f"{method} {path or request['url']} as {name}: {answer.status_code}"
        complaint = self._complaint(method, path, answer, content)
        if answer.status_code >= 500 and (answer.status_code != 503 or complaint):
            findings.defects.append(place)
        elif complaint:
            findings.undocumented.append(f"{place}, {complaint}")
        if path == "/v1/tokens" and answer.status_code == 201:
            findings.made.add(answer.json()["secret"])
            content = b""
        if path in TAKING and answer.ok and b'"form":"sealed"' in content:
            taken = Capture.model_validate_json(content)
            findings.sealed[taken.epoch, taken.number] = taken
        head = "".join(f"{key}: {value}\n" for key, value in answer.headers.items())
        findings.left.setdefault(content, place)
        findings.left.setdefault(_UNIQUE.sub(b"", head.encode()), f"headers of {place}")

    def _complaint(
        self, method: str, path: str | None, answer: requests.Response, content: bytes
    ) -> str | None:
        """What the document does not say of this answer."""
        media_type = answer.headers.get("content-type", "").partition(";")[0]
        if path is None:
            right = answer.status_code in (401, 403, 404, 405, 422)
            return None if right and media_type == "application/problem+json" else media_type
        documented = self._document["paths"][path][method.lower()]["responses"]
        if str(answer.status_code) not in documented:
            return "a status that is not documented"
        offered = documented[str(answer.status_code)].get("content", {"": {}})
        if media_type not in offered:
            return f"media type {media_type!r}"
        if not media_type.endswith("json"):
            return None
        schema = {
            "allOf": [offered[media_type]["schema"]],
            "components": self._document["components"],
        }
        error = next(Draft202012Validator(schema).iter_errors(json.loads(content)), None)
        return None if error is None else f"another shape: {error.message[:200]}"


def _streams(path: str | None) -> bool:
    return path == "/v1/events"


def _read(answer: requests.Response) -> bytes:
    """The beginning of a stream without an end, whose heartbeats break every silence."""
    content, begun = b"", time.monotonic()
    for chunk in answer.iter_content(256):
        content += chunk
        if len(content) >= EVENTS or time.monotonic() - begun > LISTENED:
            break
    return content


def _cases(operation: Any, examples: int, seed: int) -> list[schemathesis.Case[Any]]:
    """Requests that the document allows, and such that it does not."""
    found: list[schemathesis.Case[Any]] = []
    for mode in (schemathesis.GenerationMode.POSITIVE, schemathesis.GenerationMode.NEGATIVE):

        @hypothesis.seed(seed)
        @hypothesis.settings(
            max_examples=examples,
            database=None,
            deadline=None,
            suppress_health_check=list(hypothesis.HealthCheck),
            phases=[hypothesis.Phase.generate],
        )
        @hypothesis.given(operation.as_strategy(generation_mode=mode))
        def collect(case: schemathesis.Case[Any]) -> None:
            found.append(case)

        try:
            collect()
        except Unsatisfiable:
            continue  # nothing about this operation can be wrong
    return found


def make_callers(store: TokenStore) -> tuple[dict[str, str | None], list[str]]:
    """Callers with each scope, with all, and with none; and the tokens they have."""
    made = {scope: store.create(f"only {scope}", (scope,), None) for scope in SCOPES}
    everything, revoked = (store.create(name, SCOPES, None) for name in ("everything", "revoked"))
    store.revoke(revoked.id)
    callers: dict[str, str | None] = {
        "everything": f"Bearer {everything.secret}",
        "nobody": None,
        "revoked": f"Bearer {revoked.secret}",
        **{f"only {scope}": f"Bearer {token.secret}" for scope, token in made.items()},
    }
    return callers, [token.secret for token in (*made.values(), everything, revoked)]


@dataclass(frozen=True)
class Setting:
    """One daemon to ask, and what it must keep."""

    bundle: Path
    release: Release
    receiver: ReceiverKey | None = None


def ask_daemon(
    setting: Setting, directory: Path, examples: int, seed: int
) -> tuple[Findings, list[str]]:
    """Start a daemon, ask it everything, stop it, and search what left; returns what leaked."""
    directory.mkdir()
    state, scene = directory / "state", directory / "scene.npy"
    write_scene(scene, load_digits().images[seed % 100])
    options = ["--auth", "tokens", "--release", setting.release]
    options += ["--settle", "0", "--exposure", "0", "--log-level", "debug", "--scene-api"]
    if setting.release == "raw":
        options += ["--raw-budget", str(RAW_BUDGET)]
    bundle = read_bundle(setting.bundle)
    store = TokenStore(state)
    callers, tokens = make_callers(store)
    if setting.receiver is not None:
        ReceiverStore(state).add("archive", setting.receiver.public)
    with running(setting.bundle, scene, directory, *options) as url:
        fuzz = Fuzz(url, callers, examples, seed)
        fuzz.run(setting.bundle.read_bytes())
        # Once more while the sensor sees nothing: faults are told of as well.
        scene.unlink()
        fuzz.run()
    closed = Planted()
    if setting.receiver is not None:
        plant_receiver(closed, setting.receiver, directory)
        plant_sealed(closed, bundle, setting.receiver, list(fuzz.findings.sealed.values()))
    kept = [
        f"{path.name}: {name}"
        for path in _kept(state)
        for name in closed.found_in(path.read_bytes())
    ]
    planted = plant(bundle, tokens)
    plant_device(planted, state)
    planted.include(closed)
    for path in (directory / "veilcamd.log", *state.glob(f"{DONE}*"), *state.glob(f"{REFUSED}*")):
        for number, line in enumerate(path.read_bytes().splitlines(), start=1):
            fuzz.findings.left.setdefault(_UNIQUE.sub(b"", line), f"{path.name}, line {number}")
    return fuzz.findings, kept + fuzz.findings.leaks(planted)


def _kept(state: Path) -> list[Path]:
    """All files of a state directory, but for bundles, which hold no key."""
    files = [path for path in state.rglob("*") if path.is_file()]
    return [path for path in files if path.stat().st_size < BUNDLE_BYTES]


def plant_sealed(
    planted: Planted, bundle: Bundle, receiver: ReceiverKey, answers: Sequence[Capture]
) -> None:
    """What a receiver opens, and nobody else: keys of epochs, and the embeddings themselves."""
    keys: dict[str, EpochKey] = {}
    opener = Opener(receiver)
    for answer in answers:
        assert isinstance(answer.embedding, SealedEmbedding)
        if answer.epoch not in keys:
            keys[answer.epoch] = open_key(answer.embedding.envelope, receiver, device=None)
        opened = np.asarray(opener.open(answer).embedding)
        planted.add_weights("an embedding that left sealed", opened)
    plant_epochs(planted, bundle, list(keys.values()))


def main(
    *,
    examples: Annotated[
        int, typer.Option(min=1, help="Requests of each kind, operation and caller.")
    ] = 20,
    seed: Annotated[int, typer.Option(min=0, help="That requests are made from.")] = 1,
    figures: FiguresOption = None,
) -> None:
    """Ask the daemon everything, and search what it says for what it must not."""
    # What is asked here in a second, nobody asks in an hour.
    os.environ["VEILCAM_RATE_LIMIT"] = "1e6"
    os.environ["VEILCAM_HEARTBEAT"] = "0.2"
    settings = (
        Setting(BUNDLE, "raw"),
        Setting(FRESH, "white"),
        Setting(FRESH, "sealed", ReceiverKey.generate()),
    )
    defects, undocumented, leaks = list[str](), list[str](), list[str]()
    with work_folder() as folder:
        for number, setting in enumerate(settings):
            begun = time.perf_counter()
            findings, leaked = ask_daemon(setting, folder / str(number), examples, seed)
            defects += findings.defects
            undocumented += findings.undocumented
            leaks += leaked
            size = sum(map(len, findings.left)) / 1e6
            print(
                f"{setting.bundle.name}, {setting.release}: {findings.requests} requests, "
                f"{len(findings.left)} different contents of {size:.1f} MB, "
                f"{time.perf_counter() - begun:.0f} s"
            )
            counts = sorted(findings.statuses.items())
            print("  " + ", ".join(f"{count} x {status}" for status, count in counts))
    for name, found in (("5xx", defects), ("undocumented", undocumented), ("leaks", leaks)):
        print(f"{name}: {len(found)}")
        for line in found[:20]:
            print(f"  {line}")
    record(
        figures,
        {
            "fuzz_5xx": len(defects),
            "fuzz_leaks": len(leaks),
            "fuzz_undocumented": len(undocumented),
        },
    )
    if defects or undocumented or leaks:
        raise SystemExit(1)


if __name__ == "__main__":
    typer.run(main)
