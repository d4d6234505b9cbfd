"""The API under made-up requests, made short; and that a leak and a defect would be noticed."""

from __future__ import annotations

import asyncio
import base64
import hashlib
import json
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import structlog
import uvicorn
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from tests.server.conftest import Bench
from tests.siege import api_fuzz, leaks

from veilcam_client.keys.blocks import Sealer
from veilcam_client.keys.envelopes import seal_key
from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.captures import Capture, Exposure, Notes, Timing
from veilcam_client.wire.sealing import Release
from veilcam_server.api.app import create_app
from veilcam_server.masks.fresh import FreshSource
from veilcam_server.masks.source import Mask
from veilcam_server.sealing.identity import KEY_NAME, DeviceKey
from veilcam_server.security.admission import Admission
from veilcam_server.security.audit import DONE, REFUSED, AuditLog
from veilcam_server.security.limits import RateLimit
from veilcam_server.security.site import Site
from veilcam_server.security.tokens import TokenStore

if TYPE_CHECKING:
    from veilcam_training.bundle import Bundle


@pytest.fixture
def store(tmp_path: Path) -> TokenStore:
    return TokenStore(tmp_path / "state")


@pytest.fixture
def daemon(bench: Bench, store: TokenStore, tmp_path: Path) -> Iterator[str]:
    """URL of an application that listens, with a log and audit files."""
    with serving(bench, store, tmp_path) as url:
        yield url


@contextmanager
def serving(bench: Bench, store: TokenStore, tmp_path: Path) -> Iterator[str]:
    audit, refused = AuditLog(tmp_path / DONE), AuditLog(tmp_path / REFUSED)
    admission = Admission(store, Site(), audit, refused, RateLimit(1e6, 1000))
    service = bench.service(bench.camera())
    with (
        (tmp_path / "log").open("w") as log,
        # The protocol is named: see listeners.py.
        socket.socket(socket.AF_INET, socket.SOCK_STREAM, socket.IPPROTO_TCP) as listener,
    ):
        listener.bind(("127.0.0.1", 0))
        listener.listen()  # who asks before the server has started waits for it
        structlog.configure(logger_factory=structlog.PrintLoggerFactory(log))
        config = uvicorn.Config(
            create_app(service, admission), log_config=None, server_header=False
        )
        server = uvicorn.Server(config)
        thread = threading.Thread(target=lambda: asyncio.run(server.serve([listener])))
        thread.start()
        try:
            yield f"http://127.0.0.1:{listener.getsockname()[1]}"
        finally:
            service.end_streams()
            server.should_exit = True
            thread.join(30)
    audit.close()
    refused.close()


def ask_everything(
    bench: Bench,
    store: TokenStore,
    callers: dict[str, str | None],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> api_fuzz.Findings:
    monkeypatch.setattr(api_fuzz, "LISTENED", 0.1)
    monkeypatch.setattr(api_fuzz, "MORE", 2)
    with serving(bench, store, tmp_path) as url:
        fuzz = api_fuzz.Fuzz(url, callers, examples=1, seed=3)
        fuzz.run()
    for path in ("log", DONE, REFUSED):
        text = (tmp_path / path).read_bytes()
        assert text
        fuzz.findings.left[text] = path
    return fuzz.findings


@pytest.mark.slow
def test_nothing_fails_and_nothing_leaks(
    bench: Bench, store: TokenStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    callers, tokens = api_fuzz.make_callers(store)
    found = ask_everything(bench, store, callers, tmp_path, monkeypatch)
    planted = leaks.plant(bench.bundle, tokens)
    assert found.defects == found.undocumented == found.leaks(planted) == []
    assert {200, 201, 401, 403, 404, 405, 422} <= set(found.statuses)
    assert any(b'"form":"raw"' in content for content in found.left)
    assert any(b"veilcam_http_request_duration_seconds" in content for content in found.left)
    assert found.made


@pytest.mark.slow
@pytest.mark.parametrize("release", ["sealed", "white"])
def test_no_key_of_an_epoch_leaves(
    *,
    fresh_bundle: Bundle,
    store: TokenStore,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    release: Release,
) -> None:
    keys, generate = list[EpochKey](), EpochKey.generate

    def drawn(*, device: str, bundle: str) -> EpochKey:
        key = generate(device=device, bundle=bundle)
        keys.append(EpochKey(bytes(key.reveal()), device=device, bundle=bundle))
        return key

    monkeypatch.setattr(EpochKey, "generate", drawn)
    bench = Bench(fresh_bundle, tmp_path / "state", FreshSource(fresh_bundle), release=release)
    receiver = ReceiverKey.generate()
    bench.receivers.add("archive", receiver.public)
    callers, tokens = api_fuzz.make_callers(store)
    found = ask_everything(bench, store, callers, tmp_path, monkeypatch)
    planted = leaks.plant(fresh_bundle, tokens)
    leaks.plant_epochs(planted, fresh_bundle, keys)
    leaks.plant_receiver(planted, receiver, tmp_path)
    leaks.plant_device(planted, bench.state_dir)
    api_fuzz.plant_sealed(planted, fresh_bundle, receiver, list(found.sealed.values()))
    assert found.defects == found.undocumented == found.leaks(planted) == []
    assert bool(found.sealed) == (release == "sealed")
    assert any(f'"form":"{release}"'.encode() in content for content in found.left)
    assert len(keys) > 1


NOTES = Notes(
    exposure=Exposure(started_after_shown_s=0.1, settle_s=0.1, duration_s=0.01),
    timing=Timing(queue_s=0.0, rotation_s=0.0, settle_s=0.0, capture_s=0.0),
)


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
    weights = bundle.pairs[2].weights["0.weight"]
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


def make_key(number: int, device: str = "0f" * 32) -> EpochKey:
    return EpochKey(hashlib.sha256(bytes([number])).digest(), device=device, bundle="0f" * 32)


@pytest.mark.slow
def test_masks_decoders_and_keys_of_epochs_are_found(fresh_bundle: Bundle) -> None:
    keys = [make_key(number) for number in range(6)]
    planted = leaks.Planted()
    leaks.plant_epochs(planted, fresh_bundle, keys[:5])
    source = FreshSource(fresh_bundle)

    def mask(number: int) -> Mask:
        return source.make(keys[number], "white", frozenset())

    for number in (0, 4):
        levels = repr(mask(number).levels.tolist()).encode()
        assert planted.found_in(levels) == {f"mask of epoch {number}"}
    assert planted.found_in(repr(mask(5).levels.tolist()).encode()) == set()
    reader: Any = mask(1).reader
    estimator = repr(reader.decoder.estimator.tolist()).encode()
    [found] = planted.found_in(estimator)
    assert found.endswith("estimator of epoch 1")
    for derived, name in (
        (keys[3].reveal(), "the key of epoch 3"),
        (keys[3].levels(), "the key of levels of epoch 3"),
        (keys[3].rotation(), "the key of the rotation of epoch 3"),
        (keys[3].sealing(), "the sealing key of epoch 3"),
    ):
        assert planted.found_in(repr(list(derived)).encode()) == {name}
        assert planted.found_in(base64.b64encode(derived)) == {name}


def test_private_keys_are_found(tmp_path: Path) -> None:
    receiver, device = ReceiverKey.generate(), DeviceKey.open(tmp_path)
    planted = leaks.Planted()
    leaks.plant_receiver(planted, receiver, tmp_path)
    leaks.plant_device(planted, tmp_path)
    for path, name in (("receiver", "a receiver's"), (KEY_NAME, "the device's")):
        assert planted.found_in((tmp_path / path).read_bytes()) == {f"{name} private key"}
    public = f"{receiver.public} {device.public} {device.sign(b'')}".encode()
    assert planted.found_in(public) == set()


def test_what_a_receiver_opens_is_found_where_it_stands_open(fresh_bundle: Bundle) -> None:
    receiver, signer = ReceiverKey.generate(), DeviceKey(Ed25519PrivateKey.generate())
    key = make_key(0, signer.public)
    envelope = seal_key(key, signer, epoch="0" * 32, bundle="0f" * 32, receivers=[receiver.public])
    at, values = datetime(2026, 1, 1, tzinfo=UTC), np.linspace(0.1, 0.7, 20, dtype=np.float32)
    sealed = Sealer(key, envelope).seal(0, at, values, NOTES)
    taken = Capture(id="1", epoch="0" * 32, number=0, taken_at=at, embedding=sealed)
    planted = leaks.Planted()
    api_fuzz.plant_sealed(planted, fresh_bundle, receiver, [taken])
    assert planted.found_in(taken.model_dump_json().encode()) == set()
    assert planted.found_in(repr(values.tolist()).encode()) == {"an embedding that left sealed"}
    assert planted.found_in(bytes(key.reveal())) == {"the key of epoch 0"}


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
