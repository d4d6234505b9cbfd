"""Engine of the siege: its daemons, clients, attackers, and what they notice."""

from __future__ import annotations

import asyncio
import inspect
import sys
import time
from collections.abc import Callable
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import numpy as np
import pytest
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from tests.siege import attacker
from tests.siege.attacker import Attack, Kind
from tests.siege.client import PATIENCE, Address, Reply
from tests.siege.daemon import FORKS, Circumstances, NoDiskError, fill, started
from tests.siege.damage import all_trials, flipped, sample
from tests.siege.ground import Extent
from tests.siege.starving import p99
from tests.siege.witness import Life, Witness

from veilcam_client.keys.blocks import Sealer
from veilcam_client.keys.envelopes import seal_key
from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.keys.receivers import Receiver, ReceiverKey
from veilcam_client.wire.captures import Capture, Embedding, Exposure, Notes, Timing
from veilcam_server.sealing.identity import DeviceKey
from veilcam_server.security.tokens import TokenStore
from veilcam_server.settings import GivenSettings, Settings

pytestmark = pytest.mark.anyio

SERVE = f"{__name__}:serve"
DEVICE, BUNDLE = DeviceKey(Ed25519PrivateKey.generate()), "0f" * 32
ARCHIVE = ReceiverKey.generate()
AT = datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)
FIRST, SECOND, THIRD, IDLE = (f"{number:032x}" for number in range(4))
NOTES = Notes(
    exposure=Exposure(started_after_shown_s=0.1, settle_s=0.1, duration_s=0.01),
    timing=Timing(queue_s=0.0, rotation_s=0.0, settle_s=0.0, capture_s=0.0),
)


class Handler(BaseHTTPRequestHandler):
    """Server whose answers carry the clock of the token store in their ``Date``."""

    def date_time_string(self, _: float | None = None) -> str:
        clock = inspect.signature(TokenStore).parameters["now"].default
        return super().date_time_string(clock())

    def do_GET(self) -> None:
        self.send_response(200)
        self.end_headers()

    def log_message(self, *_: object) -> None:
        sys.stderr.write("asked\n")
        sys.stderr.flush()


def serve(settings: Settings, on_listening: Callable[[str], None]) -> None:
    with HTTPServer(("127.0.0.1", 0), Handler) as server:
        on_listening(f"http://127.0.0.1:{server.server_port}")
        server.serve_forever()


def settings(tmp_path: Path) -> Settings:
    state = tmp_path / "disk" / "state"
    state.mkdir(parents=True)
    (state / "kept").write_bytes(b"kept")
    bundle = tmp_path / "bundle.veilcam"
    return GivenSettings(bundle=bundle, device="simulated", state_dir=state)


@pytest.mark.slow
async def test_daemon_has_a_log_a_clock_and_no_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("VEILCAM_PORT", "1234")
    given, clock = settings(tmp_path), FORKS.Value("d", 0.0)
    assert given.port != 1234
    with started(SERVE, given, Circumstances(clock=clock)) as daemon:
        for offset in (0.0, -400 * 86_400.0):
            clock.value = offset
            date = (await daemon.address.ask("GET", "/")).headers["date"]
            told = parsedate_to_datetime(date).timestamp()
            assert told == pytest.approx(time.time() + offset, abs=60)
        assert daemon.log.read_text() == "asked\nasked\n"
        assert daemon.resident() > 1
        daemon.kill()
        assert (await daemon.address.ask("GET", "/")).status == 0


@pytest.mark.slow
def test_disk_of_a_daemon_is_its_own_and_can_be_filled(tmp_path: Path) -> None:
    given = settings(tmp_path)
    try:
        with started(SERVE, given, Circumstances(disk=2**20)) as daemon:
            assert (daemon.state / "kept").read_bytes() == b"kept"
            fill(daemon.state.parent)
            with pytest.raises(OSError, match="No space left"):
                (daemon.state / "more").write_bytes(bytes(4096))
            (daemon.state.parent / "ballast").unlink()
            (daemon.state / "more").write_bytes(bytes(4096))
            assert not (given.state_dir / "more").exists()
    except NoDiskError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize(
    ("answer", "status"),
    [
        (b"HTTP/1.1 404 Not Found\r\n\r\n{}", 404),
        (b"HTTP/1.1 200 OK\r\nContent-Length: 5\r\n\r\ncut ", 0),
        (b"nonsense\r\n\r\n", 0),
        (b"", 0),
    ],
)
async def test_answer_that_is_cut_or_none_has_the_status_0(answer: bytes, status: int) -> None:
    heard = []

    async def handle(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        heard.append(await reader.readuntil(b"\r\n\r\n"))
        writer.write(answer)
        writer.close()

    async with await asyncio.start_server(handle, "127.0.0.1", 0) as server:
        address = Address(f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}", token="secret")
        headers = {"Host": "evil.example", "X-Own": "1"}
        assert (await address.ask("PUT", "/v1/rotation", {}, headers)).status == status
    assert (await address.ask("GET", "/")).status == 0
    lines = heard[0].decode().split("\r\n")
    assert lines[0] == "PUT /v1/rotation HTTP/1.1"
    assert {"Host: evil.example", "X-Own: 1", "Authorization: Bearer secret"} <= set(lines)


@pytest.mark.parametrize(("patience", "left"), [(10.0, 8), (0.05, 0)])
async def test_attacker_never_ends_and_knows_what_was_dropped(
    monkeypatch: pytest.MonkeyPatch, patience: float, left: int
) -> None:
    monkeypatch.setattr(attacker, "AGAIN", 0.02)
    monkeypatch.setattr(attacker, "INTERVALS", (0.02,))
    received: list[bytearray] = []

    async def handle(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        received.append(taken := bytearray())
        try:
            async with asyncio.timeout(patience):
                while chunk := await reader.read(4096):
                    taken += chunk
        except (TimeoutError, ConnectionError):
            pass
        writer.close()

    kinds: tuple[Kind, ...] = ("headers", "body", "half handshake", "silent")
    async with await asyncio.start_server(handle, "127.0.0.1", 0) as server:
        address = Address(f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}")
        plan = Attack(address=address, sockets=8, seconds=1.0, lingering=0.5, kinds=kinds)
        losses = await plan.run()
    assert losses.left == left
    assert (losses.opened > 8) == (left == 0)
    assert (losses.longest >= 0.8) == (left > 0)
    headers = [each for each in received if each.startswith(b"GET ")]
    bodies = [each.partition(b"\r\n\r\n")[2] for each in received if each.startswith(b"POST ")]
    assert headers
    assert bodies
    assert not any(b"\r\n\r\n" in each for each in headers)
    assert all(each.startswith(b"{") and len(each) < 100 for each in bodies)
    assert {len(each) for each in received if each.startswith(b"\x16\x03")} == {100}
    assert b"" in received


def test_p99_counts_what_was_not_answered_as_the_longest_wait() -> None:
    replies = [Reply(status=200, seconds=0.001 * number) for number in range(1, 100)]
    assert p99([*replies, Reply(status=200, seconds=5.0)]) == pytest.approx(99.0)
    assert p99([*replies[1:], Reply(), Reply(status=503)]) == 1000 * PATIENCE


def test_files_are_damaged_alone_and_with_their_copies(tmp_path: Path) -> None:
    (tmp_path / "bundles").mkdir()
    active, copy, audit = Path("bundles/active"), Path("bundles/active.copy"), Path("audit")
    for path in (active, copy, audit):
        (tmp_path / path).write_bytes(b"12345678")
    trials = list(all_trials(tmp_path, 2))
    for paths in ((active,), (copy,), (active, copy), (audit,)):
        damaged = [damage(b"12345678") for _, tried, damage in trials if tried == paths]
        assert damaged[:2] == [b"1234", b""]
        assert len(damaged) == 4
        for content in damaged[2:]:
            changes = [a ^ b for a, b in zip(content, b"12345678", strict=True)]
            assert sum(change.bit_count() for change in changes) == 1
    assert trials[0][1] == ()
    assert len(trials) == 17
    assert flipped("", b"") == b""
    few = sample(trials, Extent(starts=5))
    assert (few[0], len(few), len(sample(trials, Extent()))) == (trials[0], 5, 17)


class Epoch:
    def __init__(self, name: str, key: int, receiver: Receiver = ARCHIVE.public) -> None:
        self.name = name
        self._key = EpochKey(bytes([key]) * 32, device=DEVICE.public, bundle=BUNDLE)
        given = {"epoch": name, "bundle": BUNDLE}
        self._envelope = seal_key(self._key, DEVICE, receivers=[receiver], **given)

    def take(self, number: int, light: float = 1.0) -> Capture:
        values = np.full((2, 3), light, np.float32)
        sealed = Sealer(self._key, self._envelope).seal(number, AT, values, NOTES)
        return Capture(id="1", epoch=self.name, number=number, taken_at=AT, embedding=sealed)


ONE, TWO = Epoch(FIRST, 1), Epoch(SECOND, 2)

PLAIN = Embedding.from_array(np.ones((2, 3), np.float32))
UNSEALED = Capture(id="1", epoch=SECOND, number=0, taken_at=AT, embedding=PLAIN)
FOREIGN = Epoch(THIRD, 2, ReceiverKey.generate().public).take(0)


@pytest.mark.parametrize(
    ("lives", "repeated", "mixed", "unopened"),
    [
        ([Life([FIRST, IDLE], [ONE.take(3), TWO.take(0)]), Life([THIRD])], [], [], 0),
        ([Life([FIRST, SECOND]), Life([SECOND, THIRD]), Life([IDLE, IDLE])], ["name"] * 2, [], 0),
        ([Life([FIRST], [ONE.take(0)]), Life([], [ONE.take(1)])], ["name", "sealing key"], [], 0),
        ([Life([FIRST], [ONE.take(0), ONE.take(0)])], ["number"], [], 1),
        ([Life([], [ONE.take(0), Epoch(SECOND, 1).take(0)])], ["sealing key"], [], 0),
        ([Life([], [ONE.take(0), ONE.take(2, light=1.01)])], [], [FIRST], 0),
        ([Life([], [UNSEALED, FOREIGN])], [], [], 2),
    ],
)
def test_witness_notices_repetitions_mixed_masks_and_what_it_cannot_open(
    lives: list[Life], repeated: list[str], mixed: list[str], unopened: int
) -> None:
    witness = Witness(ARCHIVE)
    for life in lives:
        witness.see(life)
    taken = sum(len(life.taken) for life in lives)
    assert (witness.repeated, witness.mixed) == (repeated, mixed)
    assert (len(witness.unopened), witness.opened) == (unopened, taken - unopened)
