"""The API under made-up requests, made short; and that a leak and a defect would be noticed."""

from __future__ import annotations

import asyncio
import base64
import json
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import structlog
import uvicorn
from tests.stress import api_fuzz, leaks

from veilcam_server.api.app import create_app
from veilcam_server.security.admission import Admission
from veilcam_server.security.audit import DONE, REFUSED, AuditLog
from veilcam_server.security.limits import RateLimit
from veilcam_server.security.site import Site
from veilcam_server.security.tokens import TokenStore

if TYPE_CHECKING:
    from tests.server.conftest import Bench

    from veilcam_training.bundle import Bundle


@pytest.fixture
def store(tmp_path: Path) -> TokenStore:
    return TokenStore(tmp_path / "state")


@pytest.fixture
def daemon(bench: Bench, store: TokenStore, tmp_path: Path) -> Iterator[str]:
    """URL of an application that listens, with a log and audit files."""
    audit, refused = AuditLog(tmp_path / DONE), AuditLog(tmp_path / REFUSED)
    admission = Admission(store, Site(), audit, refused, RateLimit(1e6, 1000))
    service = bench.service(bench.camera())
    with (
        (tmp_path / "log").open("w") as log,
        # The protocol is named: see listeners.py.
        socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP) as listener,
    ):
        listener.bind(("127.0.0.1", 0))
        structlog.configure(logger_factory=structlog.PrintLoggerFactory(log))
        config = uvicorn.Config(
            create_app(service, admission), log_config=None, server_header=False
        )
        server = uvicorn.Server(config)
        thread = threading.Thread(target=lambda: asyncio.run(server.serve([listener])))
        thread.start()
        yield f"http://127.0.0.1:{listener.getsockname()[1]}"
        service.end_streams()
        server.should_exit = True
        thread.join(30)
    audit.close()
    refused.close()


@pytest.mark.slow
def test_nothing_fails_and_nothing_leaks(
    daemon: str, store: TokenStore, bench: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(api_fuzz, "LISTENED", 0.1)
    monkeypatch.setattr(api_fuzz, "MORE", 2)
    callers, tokens = api_fuzz.make_callers(store)
    fuzz = api_fuzz.Fuzz(daemon, callers, examples=1, seed=3)
    fuzz.run()
    found = fuzz.findings
    planted = leaks.plant(bench.bundle, tokens)
    for path in ("log", DONE, REFUSED):
        text = (tmp_path / path).read_bytes()
        assert text
        found.left[text] = path
    assert found.defects == found.undocumented == found.leaks(planted) == []
    assert {200, 201, 401, 403, 404, 405, 422} <= set(found.statuses)
    assert any(b'"form":"raw"' in content for content in found.left)
    assert any(b"veilcam_http_request_duration_seconds" in content for content in found.left)
    assert found.made


LEVELS = "a mask's levels"


def as_text(levels: Any) -> list[int]:
    return [int(level) for level in levels.ravel()]


@pytest.mark.parametrize(
    "write",
    [
        lambda levels: levels.tobytes(),
        lambda levels: b"..." + levels.ravel()[5:40].tobytes(),
        lambda levels: np.ascontiguousarray(levels.T).tobytes(),
        lambda levels: json.dumps(levels.tolist()).encode(),
        lambda levels: repr(levels.ravel()[7:60].tolist()).encode(),
        lambda levels: " ".join(map(str, as_text(levels))).encode(),
        lambda levels: json.dumps((levels.ravel() / 63).tolist()).encode(),
        lambda levels: repr((levels.ravel() / np.float32(63)).tolist()).encode(),
        lambda levels: b"x" + levels.tobytes().hex().encode(),
        lambda levels: levels.tobytes().hex().upper().encode(),
        lambda levels: b'{"m":"' + base64.b64encode(levels.tobytes()) + b'"}',
        lambda levels: base64.urlsafe_b64encode(b"a" + levels.tobytes()),
        lambda levels: b"veilcam_x{m=" + b'"' + str(as_text(levels)).encode() + b'"} 1',
    ],
)
def test_levels_are_found_however_they_are_written(
    bundle: Bundle, write: Callable[[Any], bytes]
) -> None:
    planted = leaks.plant(bundle, [])
    other = np.random.default_rng(1).integers(0, 64, bundle.pairs[1].levels.shape).astype(np.uint8)
    assert planted.found_in(write(bundle.pairs[1].levels)) == {"mask 1"}
    assert planted.found_in(write(other)) == set()


@pytest.mark.parametrize(
    "write",
    [
        lambda weights: json.dumps(weights.astype(float).tolist()).encode(),
        lambda weights: str(np.round(weights[0, :5], 6).tolist()).encode(),
        lambda weights: weights.astype(np.float32).tobytes(),
        lambda weights: weights.astype(np.float64).tobytes(),
        lambda weights: base64.b64encode(weights[1:].tobytes()),
        lambda weights: weights.tobytes().hex().encode(),
    ],
)
def test_weights_are_found_however_they_are_written(
    bundle: Bundle, write: Callable[[Any], bytes]
) -> None:
    planted = leaks.plant(bundle, [])
    weights = bundle.pairs[2].weights["0.weight"].numpy()
    assert planted.found_in(write(weights)) == {"weights of pair 2, 0.weight"}
    assert planted.found_in(write(weights + 1)) == set()


def test_secrets_are_found(bundle: Bundle, store: TokenStore) -> None:
    secret = store.create("x", ("classify",), None).secret
    planted = leaks.plant(bundle, [secret])
    raw = bytes.fromhex(secret[16:])
    for content in (
        f"token={secret}".encode(),
        secret[20:60].encode(),
        raw,
        base64.b64encode(b"pad" + raw),
        repr(list(raw)).encode(),
    ):
        assert planted.found_in(content) == {"a token"}


def test_masks_and_decoders_of_fresh_epochs_are_found(fresh_bundle: Bundle, secret: Any) -> None:
    from veilcam_server.masks.fresh import FreshSource

    planted = leaks.Planted()
    leaks.plant_fresh(planted, fresh_bundle, secret, range(70, 75))
    source = FreshSource(fresh_bundle, secret, form="white")
    for counter in (70, 74):
        levels = source.make(counter, "").levels
        assert planted.found_in(repr(levels.tolist()).encode()) == {f"mask of epoch {counter}"}
    levels = source.make(75, "").levels
    assert planted.found_in(repr(levels.tolist()).encode()) == set()
    reader: Any = source.make(71, "").reader
    estimator = repr(reader.decoder.estimator.numpy().tolist()).encode()
    [found] = planted.found_in(estimator)
    assert found.endswith("estimator of epoch 71")
    assert planted.found_in(repr(list(secret.reveal())).encode()) == {"the mask secret"}


@pytest.mark.slow
def test_a_defect_and_what_is_not_documented_are_noticed(
    daemon: str, store: TokenStore, bench: Bench
) -> None:
    def fail() -> None:
        raise RuntimeError(json.dumps(bench.bundle.pairs[0].levels.tolist()))

    callers, _ = api_fuzz.make_callers(store)
    fuzz = api_fuzz.Fuzz(daemon, callers, examples=1, seed=3)
    bench.sensor.before = fail
    fuzz._send("everything", "POST", "/v1/captures", {"url": f"{daemon}/v1/captures"})
    assert fuzz.findings.defects == ["POST /v1/captures as everything: 500"]
    bench.sensor.before = lambda: None
    answers = fuzz._document["paths"]["/v1/captures"]["post"]["responses"]
    right = answers["200"]["content"]
    for wrong, complaint in (
        ({"200": {"content": {}}}, "media type 'application/json'"),
        ({"200": {"content": {**right, "application/json": {"schema": False}}}}, "another shape"),
        ({}, "a status that is not documented"),
    ):
        answers.pop("200")
        answers.update(wrong)
        fuzz._send("everything", "POST", "/v1/captures", {"url": f"{daemon}/v1/captures"})
        assert complaint in fuzz.findings.undocumented[-1]
        answers.setdefault("200", None)
