"""Fuzzers and soak notice leaks, defects, harm, mixed masks and repetitions."""

from __future__ import annotations

import base64
import hashlib
import itertools
import json
import os
import random
import time
from collections.abc import Callable
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from tests.siege import api_fuzz, bundle_fuzz, soak
from tests.siege.ground import QUICK, Ground
from tests.siege.leaks import Planted
from tests.siege.mutations import MUTATIONS, mutated
from tests.siege.samples import fresh_bundle, small_bundle, written
from tests.siege.test_engine import NOTES

import veilcam_server.daemon
from veilcam_client.keys.blocks import Sealer
from veilcam_client.keys.envelopes import seal_key
from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.captures import Capture
from veilcam_server.camera.camera import MaskedCamera
from veilcam_server.devices.simulated.panel import Crystal
from veilcam_server.masks.fresh import FreshSource
from veilcam_server.sealing.identity import KEY_NAME, DeviceKey
from veilcam_server.settings import Settings
from veilcam_training.bundle import read_bundle


def serve_leaky(settings: Settings, on_listening: Callable[[str], None]) -> None:
    """Serve, but answer some routes with a defect, or with a mask in another shape."""
    daemon: Any = veilcam_server.daemon
    create, levels = daemon.create_app, read_bundle(settings.bundle).pairs[0].levels
    answers = {"/v1/lease": (500, b"Internal"), "/v1/rotation": (200, levels.tobytes().hex())}

    def created(*given: Any) -> Any:
        app = create(*given)

        async def leaky(scope: Any, receive: Any, send: Any) -> None:
            if scope.get("path") not in answers or scope["method"] != "GET":
                await app(scope, receive, send)
                return
            status, content = answers[scope["path"]]
            headers = [(b"content-type", b"application/json")]
            await send({"type": "http.response.start", "status": status, "headers": headers})
            await send({"type": "http.response.body", "body": json.dumps(str(content)).encode()})

        return leaky

    daemon.create_app = created
    api_fuzz.serve(settings, on_listening)


@pytest.mark.slow
def test_defects_undocumented_answers_and_leaks_are_noticed(tmp_path: Path) -> None:
    with ExitStack() as stack:
        ground = Ground(f"{__name__}:serve_leaky", tmp_path, QUICK, stack)
        findings, leaked = api_fuzz.ask_daemon(ground, "raw")
    assert all(" /v1/lease " in place for place in findings.defects)
    assert all(" /v1/rotation " in place for place in findings.undocumented)
    assert findings.defects
    assert "another shape" in findings.undocumented[0]
    assert {leak.partition(": mask ")[2] for leak in leaked} == {"0"}


Write = Callable[[Any], bytes]


def as_text(levels: Any) -> list[int]:
    return [int(level) for level in levels.ravel()]


LEVELS: tuple[Write, ...] = (
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
)
WEIGHTS: tuple[Write, ...] = (
    lambda weights: json.dumps(weights.astype(float).tolist()).encode(),
    lambda weights: str(np.round(weights[0, :5], 6).tolist()).encode(),
    lambda weights: weights.astype(np.float32).tobytes(),
    lambda weights: weights.astype(np.float64).tobytes(),
    lambda weights: base64.b64encode(weights[1:].tobytes()),
    lambda weights: weights.tobytes().hex().encode(),
)


@pytest.mark.parametrize(
    ("part", "write"),
    [*(("levels", write) for write in LEVELS), *(("weights", write) for write in WEIGHTS)],
)
def test_levels_and_weights_are_found_however_they_are_written(part: str, write: Write) -> None:
    planted, bundle = Planted(), small_bundle()
    planted.add_bundle(bundle)
    if part == "levels":
        secret, name = bundle.pairs[1].levels, "mask 1"
        other: Any = np.random.default_rng(1).integers(0, 64, secret.shape).astype(np.uint8)
    else:
        secret, name = bundle.pairs[2].weights["0.weight"], "weights of pair 2, 0.weight"
        other = secret + 1
    assert planted.found_in(write(secret)) == {name}
    assert planted.found_in(write(other)) == set()


def test_tokens_and_private_keys_are_found(tmp_path: Path) -> None:
    receiver, device, digits = (
        ReceiverKey.generate(),
        DeviceKey.open(tmp_path),
        os.urandom(32).hex(),
    )
    secret, planted, raw = f"veilcam_{'0' * 7}_{digits}", Planted(), bytes.fromhex(digits)
    planted.add_tokens([secret])
    planted.add_receiver(receiver, tmp_path)
    planted.add_device(tmp_path)
    padded = base64.b64encode(b"pad" + raw)
    for content in (secret.encode(), secret[20:60].encode(), raw, padded, repr(list(raw)).encode()):
        assert planted.found_in(content) == {"a token"}
    for path, name in (("receiver", "a receiver's"), (KEY_NAME, "the device's")):
        assert planted.found_in((tmp_path / path).read_bytes()) == {f"{name} private key"}
    public = f"{receiver.public} {device.public} {device.sign(b'')}".encode()
    assert planted.found_in(public) == set()


def make_key(number: int, device: str = "0f" * 32) -> EpochKey:
    return EpochKey(hashlib.sha256(bytes([number])).digest(), device=device, bundle="0f" * 32)


@pytest.mark.slow
def test_masks_decoders_and_keys_of_epochs_are_found() -> None:
    keys, planted, bundle = [make_key(number) for number in range(6)], Planted(), fresh_bundle()
    planted.add_epochs(bundle, keys[:5])
    masks = [FreshSource(bundle).make(key, frozenset()) for key in keys]
    for number in (0, 4):
        levels = repr(masks[number].levels.tolist()).encode()
        assert planted.found_in(levels) == {f"mask of epoch {number}"}
    assert planted.found_in(repr(masks[5].levels.tolist()).encode()) == set()
    reader: Any = masks[1].reader
    [found] = planted.found_in(repr(reader.decoder.estimator.tolist()).encode())
    assert found.endswith("estimator of epoch 1")
    key = keys[3]
    for derived, name in (
        (key.reveal(), "key"),
        (key.levels(), "key of levels"),
        (key.sealing(), "sealing key"),
    ):
        for content in (repr(list(derived)).encode(), base64.b64encode(derived)):
            assert planted.found_in(content) == {f"the {name} of epoch 3"}


def test_sealed_embedding_is_found_where_it_stands_open() -> None:
    receiver, signer = ReceiverKey.generate(), DeviceKey(Ed25519PrivateKey.generate())
    key = make_key(0, signer.public)
    envelope = seal_key(key, signer, epoch="0" * 32, bundle="0f" * 32, receivers=[receiver.public])
    at, values = datetime(2026, 1, 1, tzinfo=UTC), np.linspace(0.1, 0.7, 20, dtype=np.float32)
    sealed = Sealer(key, envelope).seal(0, at, values, NOTES)
    taken = Capture(id="1", epoch="0" * 32, number=0, taken_at=at, embedding=sealed)
    planted = Planted()
    planted.add_sealed(receiver, [taken])
    assert planted.found_in(taken.model_dump_json().encode()) == set()
    assert planted.found_in(repr(values.tolist()).encode()) == {"an embedding that left sealed"}
    assert planted.found_in(bytes(key.reveal())) == {"an opened key"}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    path = tmp_path_factory.mktemp("bundles") / "a.veilcam"
    return [written(path, bundle).read_bytes() for bundle in (small_bundle(), fresh_bundle())]


def test_seed_gives_the_same_file_again(data: list[bytes]) -> None:
    for seed in range(len(MUTATIONS)):
        assert mutated(seed, data) == mutated(seed, data)


def refuse_badly(*_: object) -> str:
    raise ValueError("secret")


def die(*_: object) -> str:
    os._exit(11)


def hang(*_: object) -> str:
    time.sleep(60)
    return "refused"


def gorge(*_: object) -> str:
    return str(len(bytearray(2**33)))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("harm", "word"),
    [(refuse_badly, "ValueError"), (die, "died"), (hang, "over"), (gorge, "MemoryError")],
)
def test_harm_of_a_bundle_is_noticed(
    *,
    data: list[bytes],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    harm: bundle_fuzz.Attempt,
    word: str,
) -> None:
    monkeypatch.setattr(bundle_fuzz, "SLOW", 2.0)
    outcome = bundle_fuzz.try_all([3], data, tmp_path, harm)
    assert outcome.results == {"crash": 1}
    assert word in outcome.failures[0]


@pytest.mark.slow
def test_soak_counts_faults_as_errors_and_starts_engines_again(tmp_path: Path) -> None:
    random.seed(5)
    outcome = soak.soak(tmp_path, 80, faults=0.5, every=20)
    assert outcome.errors > 0
    assert outcome.captures > 40
    assert outcome.mixed == outcome.reused == outcome.lost == 0


def shifted(_: object, weights: Any) -> Any:
    return (weights[1:9, :8].double(),)


def fail(*_: object, **__: object) -> None:
    raise ZeroDivisionError


@pytest.mark.parametrize(
    ("of", "name", "wrong", "counts"),
    [
        (soak.CornerLight, "response", shifted, lambda o: o.mixed == o.captures == 10),
        # The guard accuses most of them.
        (soak, "CRYSTAL", Crystal(scan=5e-4, settle=0.02), lambda o: o.mixed + o.lost > 0),
        (MaskedCamera, "capture", fail, lambda o: o.lost == 10),
    ],
    ids=["light of another mask", "a panel that settles too slowly", "an unknown exception"],
)
def test_soak_notices(
    *,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    of: object,
    name: str,
    wrong: object,
    counts: Callable[[soak.Outcome], bool],
) -> None:
    monkeypatch.setattr(of, name, wrong)
    assert counts(soak.soak(tmp_path, 10, faults=0.0))


def test_soak_notices_keys_and_names_that_come_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    keys, names = itertools.cycle(range(1, 8)), itertools.cycle(range(7))

    def generate(*, device: str, bundle: str) -> EpochKey:
        return EpochKey(bytes([next(keys)]) * 32, device=device, bundle=bundle)

    with monkeypatch.context() as patch:
        patch.setattr(EpochKey, "generate", generate)
        assert soak.soak(tmp_path / "keys", 20, faults=0.0).reused > 0
    drawn = "veilcam_server.camera.epochs.secrets.token_hex"
    monkeypatch.setattr(drawn, lambda _: f"{next(names):032x}")
    outcome = soak.soak(tmp_path / "names", 20, faults=0.0)
    assert outcome.reused > 0
    assert outcome.lost > 0  # the receiver, too, refuses what comes again
