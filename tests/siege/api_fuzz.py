"""Row of the API's fuzzer: every route under made-up requests, and a search for secrets in it all.

Schemathesis makes requests from the daemon's own OpenAPI document, valid ones and others. A real
daemon gets them over TCP, from callers with each single scope, with all, with none, and with tokens
that are revoked or missing. It has stored masks and raw embeddings, or fresh masks whose embeddings
leave sealed. No answer may be a 5xx but a documented 503, nor have a status, a media type
or a shape that the document does not name.

Then every header, body, line of both logs is searched for secrets (``leaks``).
Epoch keys are those that the daemon draws: :func:`serve` writes them beside its state.
"""

from __future__ import annotations

import hashlib
import json
import re
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import hypothesis
import requests
import schemathesis
from hypothesis.errors import Unsatisfiable
from jsonschema import Draft202012Validator  # type: ignore[import-untyped]
from schemathesis.core.result import Ok
from tests.siege.ground import SERVE, UNHINDERED, Ground, Judgement
from tests.siege.leaks import Planted
from tests.siege.samples import fresh_bundle, written

from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE
from veilcam_client.wire.captures import NPY_MEDIA_TYPE, Capture
from veilcam_client.wire.rotation import EverySeconds
from veilcam_client.wire.sealing import Release
from veilcam_client.wire.tokens import SCOPES, Scope
from veilcam_server.daemon import serve as serve_daemon
from veilcam_server.demo_data import BUNDLE, FRESH
from veilcam_server.sealing.receivers import ReceiverStore
from veilcam_server.security.log import FOLDER
from veilcam_server.security.tokens import TokenStore
from veilcam_server.settings import Settings
from veilcam_training.bundle import read_bundle

EVENTS, LISTENED = 2048, 0.5  # [bytes, s] of a stream that are read
RAW_BUDGET = 200
"""Embeddings that may leave raw behind one mask: so few that all masks are spent on the way."""
BUNDLE_BYTES = 1_000_000
TAKING = ("/v1/captures", "/v1/classifications")
PROBES = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE", "BREW")
EXPECTED = {200, 201, 401, 403, 404, 405, 422}
"""Statuses without which too little was asked."""
DRAWN = "drawn-keys"

# Made-up bytes, as for every file.
schemathesis.serializer.alias([BUNDLE_MEDIA_TYPE, NPY_MEDIA_TYPE], "application/octet-stream")

_UNIQUE = re.compile(
    rb"(?im)(^(x-request-id|date): .*$|\b(request_id|request|at|timestamp|ms)\b[^,}]*)"
)
"""Parts of headers and log lines that make each different and hold nothing."""


def serve(settings: Settings, on_listening: Callable[[str], None]) -> None:
    """Serve as the daemon does, and write down every epoch key that is drawn."""
    generate, drawn = EpochKey.generate, settings.state_dir.with_name(DRAWN)

    def generated(*, device: str, bundle: str) -> EpochKey:
        key = generate(device=device, bundle=bundle)
        with drawn.open("a") as stream:
            stream.write(f"{bytes(key.reveal()).hex()} {device} {bundle}\n")
        return key

    EpochKey.generate = generated  # type: ignore[method-assign]
    serve_daemon(settings, on_listening)


@dataclass
class Findings:
    statuses: Counter[int] = field(default_factory=Counter)
    defects: list[str] = field(default_factory=list)
    undocumented: list[str] = field(default_factory=list)
    left: dict[bytes, str] = field(default_factory=dict)
    sealed: dict[tuple[str, int], Capture] = field(default_factory=dict)
    made: set[str] = field(default_factory=set)

    def leaks(self, planted: Planted) -> list[str]:
        found = []
        for content, place in self.left.items():
            found += [f"{place}: {name}" for name in planted.found_in(content)]
            found += [f"{place}: a token" for token in self.made if token[16:].encode() in content]
        return found


class Fuzz:
    """Caller of one daemon, who checks every answer against its document."""

    def __init__(
        self, url: str, callers: Mapping[str, str | None], examples: int, more: int
    ) -> None:
        self.findings = Findings()
        self._url, self._callers = url, callers
        self._session = requests.Session()
        self._session.trust_env = False
        headers = {"Authorization": f"Bearer {callers['everything']}"}
        answer = self._session.get(f"{url}/v1/openapi.json", headers=headers)
        answer.raise_for_status()
        self.document: dict[str, Any] = answer.json()
        self._more, self._cases = more, _all_cases(answer.text, more * examples)

    def run(self, bundle: bytes | None = None) -> None:
        for name in self._callers:
            for (method, path), cases in self._cases.items():
                for case in cases if name == "everything" else cases[:: self._more]:
                    request = case.as_transport_kwargs(base_url=self._url)
                    self.send(name, method, path, **request)
            self._come_and_go(name, bundle)
        for name in ("everything", "nobody"):
            for path, operations in self.document["paths"].items():
                url = self._url + re.sub(r"\{\w+\}", "0", path)
                for method in PROBES:
                    # HEAD is GET without a body.
                    if {"HEAD": "get"}.get(method, method.lower()) not in operations:
                        self.send(name, method, None, url=url)

    def _come_and_go(self, name: str, bundle: bytes | None) -> None:
        guest = ReceiverKey.generate().public
        question, path = {"label": "guest", "key": str(guest)}, "/v1/receivers"
        self.send(name, "POST", path, json=question)
        self.send(name, "POST", path, json=question)
        self.send(name, "GET", path)
        for _ in range(2):
            url = f"{self._url}{path}/{guest.id}"
            self.send(name, "DELETE", f"{path}/{{receiver_id}}", url=url)
        if bundle is not None:
            path, kind = "/v1/bundles", {"Content-Type": BUNDLE_MEDIA_TYPE}
            self.send(name, "POST", path, data=bundle, headers=kind)
            url = f"{self._url}{path}/{hashlib.sha256(bundle).hexdigest()}/activate"
            self.send(name, "POST", f"{path}/{{digest}}/activate", url=url)

    def send(self, name: str, verb: str, path: str | None, **request: Any) -> None:
        headers = requests.structures.CaseInsensitiveDict(request.pop("headers", None) or {})
        headers.pop("Authorization", None)
        if self._callers[name] is not None:
            headers["Authorization"] = f"Bearer {self._callers[name]}"
        request = {"url": f"{self._url}{path}", **request, "method": verb, "headers": headers}
        request["stream"] = True
        with self._session.request(**request, timeout=60) as answer:
            streams = path == "/v1/events" and answer.ok
            content = _beginning(answer) if streams else answer.content
        findings = self.findings
        findings.statuses[answer.status_code] += 1
        place = f"{verb} {path or request['url']} as {name}: {answer.status_code}"
        complaint = self._complaint(verb, path, answer, content)
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
        media_type = answer.headers.get("content-type", "").partition(";")[0]
        if path is None:
            right = answer.status_code in (401, 403, 404, 405, 422)
            return None if right and media_type == "application/problem+json" else media_type
        documented = self.document["paths"][path][method.lower()]["responses"]
        if str(answer.status_code) not in documented:
            return "a status that is not documented"
        offered = documented[str(answer.status_code)].get("content", {"": {}})
        if media_type not in offered:
            return f"media type {media_type!r}"
        if not media_type.endswith("json"):
            return None
        whole = {"components": self.document["components"]}
        schema = {"allOf": [offered[media_type]["schema"]], **whole}
        error = next(Draft202012Validator(schema).iter_errors(json.loads(content)), None)
        return None if error is None else f"another shape: {error.message[:200]}"


def _beginning(answer: requests.Response) -> bytes:
    """Return the beginning of a stream without an end, whose heartbeats break every silence."""
    content, begun = b"", time.monotonic()
    for chunk in answer.iter_content(256):
        content += chunk
        if len(content) >= EVENTS or time.monotonic() - begun > LISTENED:
            break
    return content


@cache
def _all_cases(document: str, examples: int) -> dict[tuple[str, str], list[schemathesis.Case[Any]]]:
    content = json.loads(document)
    schema = schemathesis.openapi.from_dict(content)
    operations = [each.ok() for each in schema.get_all_operations() if isinstance(each, Ok)]
    assert len(operations) == sum(map(len, content["paths"].values()))
    return {(each.method.upper(), each.path): _cases(each, examples) for each in operations}


def _cases(operation: Any, examples: int) -> list[schemathesis.Case[Any]]:
    found: list[schemathesis.Case[Any]] = []
    for mode in (schemathesis.GenerationMode.POSITIVE, schemathesis.GenerationMode.NEGATIVE):

        @hypothesis.seed(1)
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


def make_callers(store: TokenStore, scopes: Sequence[Scope]) -> dict[str, str | None]:
    names = {**{f"only {scope}": (scope,) for scope in scopes}, "everything": SCOPES}
    made = {name: store.create(name, scopes, None).secret for name, scopes in names.items()}
    revoked = store.create("revoked", SCOPES, None)
    store.revoke(revoked.id)
    return {**made, "revoked": revoked.secret, "nobody": None}


async def fuzzed(ground: Ground, judgement: Judgement) -> None:
    findings, leaks = Findings(), list[str]()
    releases: tuple[Release, ...] = ("raw", "sealed")
    for release in releases if ground.extent.whole else releases[1:]:
        found, leaked = ask_daemon(ground, release)
        findings.statuses += found.statuses
        findings.defects += [f"{release}: {each}" for each in found.defects]
        findings.undocumented += [f"{release}: {each}" for each in found.undocumented]
        leaks += [f"{release}: {each}" for each in leaked]
        said = any(f'"form":"{release}"'.encode() in content for content in found.left)
        judgement.holds(f"{release} embeddings left", true=said)
    missing = EXPECTED - set(findings.statuses)
    asked = findings.statuses.total()
    judgement.holds(f"answers of every kind {sorted(missing) or ''}", true=not missing)
    judgement.none(f"5xx of {asked} requests", findings.defects, "fuzz_5xx")
    judgement.none(f"leaks of {asked} requests", leaks, "fuzz_leaks")
    judgement.none("undocumented", findings.undocumented, "fuzz_undocumented")


def ask_daemon(ground: Ground, release: Release) -> tuple[Findings, list[str]]:
    given: dict[str, Any] = {"raw_budget": RAW_BUDGET} if release == "raw" else {}
    if ground.extent.whole:
        given["bundle"] = BUNDLE if release == "raw" else FRESH
    elif release != "raw":
        given["bundle"] = written(ground.folder / f"{release}.veilcam", fresh_bundle())
    given |= {"settle": 0.0, "exposure": 0.0, "rotation": EverySeconds(seconds=10.0), **UNHINDERED}
    given |= {"release": release, "scene_api": True, "log_level": "debug"}
    settings = ground.settings(f"api-fuzz-{release}", **given)
    state, bundle, receiver = settings.state_dir, read_bundle(settings.bundle), None
    callers = make_callers(TokenStore(state), SCOPES if ground.extent.whole else SCOPES[:1])
    if release == "sealed":
        receiver = ReceiverKey.generate()
        ReceiverStore(state).add("archive", receiver.public)
    own = f"{__name__}:serve" if ground.serve == SERVE else None
    with ground.start(settings, serve=own) as daemon:
        fuzz = Fuzz(daemon.address.url, callers, ground.extent.examples, ground.extent.more)
        fuzz.run(settings.bundle.read_bytes())
        if ground.extent.whole:
            # Once more while the sensor sees nothing: faults are told of as well.
            Path(settings.scenes[0]).unlink()
            fuzz.run()
    findings = fuzz.findings
    closed = Planted()
    if receiver is not None:
        closed.add_receiver(receiver, state.parent)
        closed.add_sealed(receiver, list(findings.sealed.values()))
    drawn = [line.split() for line in state.with_name(DRAWN).read_text().splitlines()]
    keys = [EpochKey(bytes.fromhex(key), device=own, bundle=of) for key, own, of in drawn]
    closed.add_epochs(bundle, keys)
    leaked = [
        f"{path.name}: {name}"
        for path in state.rglob("*")
        if path.is_file() and path.stat().st_size < BUNDLE_BYTES
        for name in closed.found_in(path.read_bytes())
    ]
    closed.add_bundle(bundle)
    closed.add_tokens(token for token in callers.values() if token is not None)
    closed.add_device(state)
    for path in (state.with_name("veilcamd.log"), *(state / FOLDER).iterdir()):
        for number, line in enumerate(path.read_bytes().splitlines(), start=1):
            findings.left.setdefault(_UNIQUE.sub(b"", line), f"{path.name}, line {number}")
    return findings, leaked + findings.leaks(closed)
