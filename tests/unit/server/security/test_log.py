"""The log: it goes on whatever befalls it, says what did, and has who did what."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from structlog.testing import capture_logs
from tests.unit.server.damage import DAMAGES
from tests.unit.server.logs import events, open_log, records
from tests.unit.server.security.conftest import bearer

from veilcam_client.keys.log import NOTHING_BEFORE, is_genuine, line_digest, line_of, verify_log
from veilcam_client.wire.log import LogRecord
from veilcam_client.wire.tokens import NewToken
from veilcam_server.errors import ProblemError, StorageError
from veilcam_server.security import log as module
from veilcam_server.security.admission import Admission
from veilcam_server.security.limits import RateLimit
from veilcam_server.security.log import FOLDER, Log
from veilcam_server.security.site import Site
from veilcam_server.security.tokens import TokenStore
from veilcam_server.system.state_folder import read_file

if TYPE_CHECKING:
    from tests.unit.server.conftest import Running

pytestmark = pytest.mark.anyio
FULL = OSError(errno.ENOSPC, "No space left on device")
SMALL = 2000
"""Room for three captures [bytes]."""


@contextmanager
def full_disk(patch: pytest.MonkeyPatch, written: int = 5) -> Iterator[None]:
    """A disk that takes no more than some bytes of a line."""
    real = os.pwrite
    with patch.context() as within:
        within.setattr(os, "pwrite", lambda file, data, at: real(file, data[:written], at))
        yield


class Rig:
    def __init__(self, state_dir: Path) -> None:
        self.state_dir, self.folder = state_dir, state_dir / FOLDER
        self.faults: list[ProblemError] = []

    def open(self, **limits: int) -> Log:
        made = open_log(self.state_dir, **limits)
        made.begin(self.faults.append)
        return made

    def life(self, captures: int, **limits: int) -> None:
        log = self.open(**limits)
        capture_all(log, captures)
        log.close()

    def said(self) -> list[LogRecord]:
        """All records, which follow from each other."""
        found = records(self.state_dir)
        assert all(map(is_genuine, found))
        for one, following in pairwise(found):
            assert following.position == one.position + 1
            assert following.previous == line_digest(line_of(one))
        return found

    def kinds(self) -> list[str]:
        return kinds(self.said())


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return Rig(tmp_path)


def capture(number: int) -> dict[str, str | int]:
    return {
        "epoch": "9f" * 16,
        "number": number,
        "mask": "1a" * 32,
        "tested_s": 60,
        "answer": f"{number:064x}",
    }


def capture_all(log: Log, captures: int) -> None:
    for number in range(captures):
        log.append("capture", capture(number))


def kinds(found: list[LogRecord]) -> list[str]:
    """Kinds of entries; of a start what came before it."""
    return [str(each.facts.get("after", each.kind)) for each in found]


def test_log_tells_of_every_life_in_order(rig: Rig) -> None:
    rig.life(2)
    rig.life(1)
    found = rig.said()
    assert kinds(found) == ["nothing", "capture", "capture", "stop", "stop", "capture", "stop"]
    assert (found[0].previous, found[0].position) == (NOTHING_BEFORE, 0)
    assert [each.facts for each in found[1:3]] == [capture(0), capture(1)]
    assert not rig.faults
    assert rig.folder.stat().st_mode & 0o777 == 0o700
    assert {path.stat().st_mode & 0o777 for path in rig.folder.iterdir()} == {0o600}


def test_end_without_a_stop_is_said(rig: Rig) -> None:
    capture_all(rig.open(), 1)
    rig.open()
    assert rig.kinds() == ["nothing", "capture", "cut"]
    assert not rig.faults


def test_command_writes_beside_a_daemon_and_before_and_after_it(rig: Rig) -> None:
    def command() -> None:
        log = open_log(rig.state_dir, limit=SMALL)
        log.append("command", {"action": "token create"}, durable=True)
        log.close()

    command()
    daemon = rig.open(limit=SMALL)
    for number in range(5):
        daemon.append("capture", capture(number))
        command()
    daemon.close()
    command()
    rig.open(limit=SMALL).close()
    both = ["capture", "command"]
    assert rig.kinds() == ["command", "nothing", *5 * both, "stop", "command", "stop", "stop"]
    assert not rig.faults
    assert len(list(rig.folder.iterdir())) > 1


def test_dropped_records_are_said_and_the_size_is_bounded(rig: Rig) -> None:
    log = rig.open(limit=SMALL, kept=2)
    capture_all(log, 20)
    found = rig.said()
    said = [each.facts["before"] for each in found if each.kind == "dropped"]
    assert said[-1] == found[0].position
    assert len(list(rig.folder.iterdir())) <= 3
    assert all(path.stat().st_size <= SMALL for path in rig.folder.iterdir())
    numbers = [int(each.facts["number"]) for each in found if each.kind == "capture"]
    assert numbers == list(range(numbers[0], 20))
    assert not verify_log(b"".join(line_of(each) + b"\n" for each in found)).findings


def test_refused_requests_do_not_push_out_the_rest(rig: Rig) -> None:
    log = rig.open(limit=8000, kept=2)
    log.append("request", {"action": "PUT /v1/rotation", "status": 200})
    for _ in range(200):
        log.append("refused", {"action": "GET /v1/status", "code": "unauthorized"})
    assert rig.kinds()[:2] == ["nothing", "request"]
    refused = events(rig.state_dir, "refused")
    assert 2 <= len(refused) < 5
    # The next file has room for some again, and tells how many there were.
    capture_all(log, 12)
    log.append("refused", {"action": "GET /v1/status", "code": "unauthorized"})
    told = events(rig.state_dir, "refused")
    assert told[-1]["others"] == 200 - len(refused)
    for _ in range(200):
        log.append("refused", {"action": "GET /v1/status", "code": "unauthorized"})
    log.close()
    assert events(rig.state_dir, "stop")[-1]["refused"] > 190
    rig.open(limit=8000, kept=2).append("refused", {"action": "GET /v1/status"})
    assert events(rig.state_dir, "refused")[-1]["action"] == "GET /v1/status"
    assert rig.kinds()[1] == "request"


def test_records_come_in_pages_over_all_files(rig: Rig) -> None:
    log = rig.open(limit=SMALL)
    capture_all(log, 9)
    everything = log.records(None, 100)
    assert [each.position for each in everything.records] == list(range(10))
    assert everything.next is None
    found: list[LogRecord] = []
    after: int | None = None
    while page := log.records(after, 4).records:
        found += page
        after = page[-1].position
    assert tuple(found) == everything.records
    assert log.records(None, 4).next == 3
    assert log.records(5, 4).next is None
    assert log.records(7, 100).records == everything.records[8:]
    assert log.records(9, 4).records == log.records(99, 4).records == ()
    assert log.records(None, 4, newest=True).records == everything.records[6:]
    assert log.records(None, 40, newest=True).records == everything.records


def test_file_that_is_dropped_meanwhile_is_passed_over(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = rig.open(limit=SMALL)
    capture_all(log, 9)
    oldest, *_ = sorted(rig.folder.iterdir())
    read = read_file

    def dropped(path: Path) -> bytes:
        oldest.unlink(missing_ok=True)
        return read(path)

    monkeypatch.setattr(module, "read_file", dropped)
    assert log.records(None, 100).records[0].position > 0


def test_records_shown_are_on_the_disk(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    """A record that a power cut disowned would accuse an honest camera."""
    log = rig.open()
    capture_all(log, 2)
    flushed: list[int] = []
    monkeypatch.setattr(os, "fsync", lambda file: flushed.append(os.fstat(file).st_size))
    capture_all(log, 1)
    log.append("request", {"action": "POST /v1/rotation/advance"})
    assert not flushed
    [path] = rig.folder.iterdir()
    size = path.stat().st_size
    log.records(None, 1)
    assert flushed == [size]
    log.append("request", {"action": "PUT /v1/rotation"}, durable=True)
    log.close()
    assert size < flushed[1] < flushed[2] == path.stat().st_size


def test_file_is_on_the_disk_before_the_next_begins(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = rig.open(limit=SMALL)
    flushed: list[int] = []
    monkeypatch.setattr(os, "fsync", lambda file: flushed.append(os.fstat(file).st_size))
    capture_all(log, 3)
    first, _ = sorted(rig.folder.iterdir())
    assert flushed[0] == first.stat().st_size


def test_entry_that_must_be_durable_is_or_is_refused(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = rig.open()
    with full_disk(monkeypatch), pytest.raises(StorageError, match="No space left"):
        log.append("request", {"action": "lost"}, durable=True)
    descriptors = len(os.listdir("/proc/self/fd"))

    def fail(_: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(StorageError, match=r"Input/output error.*check the state"):
        log.append("request", {"action": "in doubt"}, durable=True)
    with pytest.raises(StorageError, match="Input/output error"):
        log.records(None, 1)
    assert len(os.listdir("/proc/self/fd")) == descriptors
    assert log.missed == 2


def test_no_change_is_begun_while_nothing_can_be_written(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = rig.open()
    log.require()
    with full_disk(monkeypatch):
        log.append("request", {"action": "lost"})
        for _ in range(2):
            with pytest.raises(StorageError):
                log.require()
    log.require()
    log.require()
    assert [each["entries"] for each in events(rig.state_dir, "gap")] == [1]


@pytest.mark.parametrize("damage", DAMAGES)
def test_damaged_log_goes_on_and_says_so(rig: Rig, damage: str) -> None:
    rig.life(5)
    DAMAGES[damage](rig.folder / f"{0:020d}.jsonl")
    rig.life(1)
    if damage == "removed":  # as if there had been none: an empty folder says nothing
        assert rig.kinds() == ["nothing", "capture", "stop"]
        return
    [fault] = rig.faults
    assert (fault.code, fault.remedy) == ("state_lost", "check_disk")
    [said] = events(rig.state_dir, "damage")
    assert str(said["lost"]) in str(fault)
    assert "which is in log.damaged" in str(fault)
    assert said["lost"].startswith("all of it" if rig.said()[0].kind == "damage" else "its")


@pytest.mark.parametrize(
    ("damage", "left"),
    [
        (lambda held: held[:-1], 6),
        (lambda held: held[:-40], 6),
        (lambda held: held + b"{", 7),
        (lambda held: held + bytes(200), 7),
        (lambda held: held + held[-300:-2], 7),
        (lambda held: held.replace(b'"position":6', b'"position":7'), 6),
        (lambda _: b"", 6),
        (lambda _: b"\n\n\xff", 6),
    ],
)
def test_damaged_end_is_set_aside(rig: Rig, damage: Callable[[bytes], bytes], left: int) -> None:
    capture_all(rig.open(limit=SMALL), 6)  # the newest file has one record
    newest = sorted(rig.folder.iterdir())[-1]
    held = newest.read_bytes()
    assert held.count(b"\n") == 1
    newest.write_bytes(damage(held))
    rig.life(1, limit=SMALL)
    assert rig.kinds()[left:] == ["damage", "cut", "capture", "stop"]
    [aside] = (rig.state_dir / "log.damaged").iterdir()
    assert aside.name == newest.name
    assert damage(held).endswith(aside.read_bytes())


@pytest.mark.parametrize(
    "damage",
    [
        lambda lines: [*lines[:2], b"x" * len(lines[2]), *lines[3:]],
        lambda lines: [*lines[:2], lines[2].replace(b"capture", b"captxre"), *lines[3:]],
        lambda lines: [*lines[:2], lines[2].replace(b'"number":1', b'"number":2'), *lines[3:]],
        lambda lines: [*lines[:2], *lines[3:]],
        lambda lines: [*lines[:2], lines[3], lines[2], *lines[4:]],
    ],
)
def test_damage_before_the_end_is_left_as_it_is_and_said_at_every_start(
    rig: Rig, damage: Callable[[list[bytes]], list[bytes]]
) -> None:
    rig.life(5)
    [path] = rig.folder.iterdir()
    damaged = b"\n".join(damage(path.read_bytes().split(b"\n")))
    path.write_bytes(damaged)
    for number in (1, 2):
        rig.faults.clear()
        rig.life(0)
        assert [fault.code for fault in rig.faults] == ["state_lost"]
        assert "records in " in str(rig.faults[0])
        assert len(events(rig.state_dir, "damage")) == number
    assert path.read_bytes().startswith(damaged)
    log = rig.open()
    assert [each.position for each in log.records(None, 2).records] in ([0, 1], [0, 2], [0, 3])


def test_file_in_the_middle_that_is_gone_is_said_and_one_that_cannot_be_read_stays(
    rig: Rig,
) -> None:
    rig.life(6, limit=SMALL)
    middle = sorted(rig.folder.iterdir())[1]
    middle.unlink()
    rig.open(limit=SMALL).close()
    assert "records in 1 places" in str(rig.faults[0])
    rig.faults.clear()
    os.mkfifo(middle)
    log = rig.open(limit=SMALL)
    capture_all(log, 1)
    assert [fault.code for fault in rig.faults] == ["storage_failed"]
    assert middle.is_fifo()
    assert not (rig.state_dir / "log.damaged").exists()
    middle.unlink()
    capture_all(log, 1)
    assert kinds(records(rig.state_dir))[-4:] == ["damage", "stop", "gap", "capture"]


def test_log_of_another_device_is_set_aside(rig: Rig, tmp_path: Path) -> None:
    rig.life(3)
    for path in rig.state_dir.glob("device-key.json*"):
        path.unlink()
    rig.life(0)
    assert "all of it" in str(rig.faults[0])
    assert rig.kinds() == ["damage", "nothing", "stop"]
    assert list((tmp_path / "log.damaged").iterdir())


def test_full_disk_stops_no_answer_and_the_gap_is_said(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = rig.open()
    capture_all(log, 1)
    with full_disk(monkeypatch):
        capture_all(log, 3)
    [fault] = rig.faults  # once, however many answers
    assert isinstance(fault, StorageError)
    assert "No space left on device" in str(fault)
    assert log.missed == 3
    with capture_logs() as logs:
        capture_all(log, 2)
    [told] = logs
    assert (told["event"], told["missed"]) == ("the log can be written again", 3)
    log.close()
    assert rig.kinds() == ["nothing", "capture", "gap", "capture", "capture", "stop"]
    assert events(rig.state_dir, "gap")[0]["entries"] == 3
    log = rig.open()
    for _ in range(2):  # told again when it fails again
        with full_disk(monkeypatch):
            capture_all(log, 2)
        capture_all(log, 1)
    assert len(rig.faults) == 3


def test_disk_that_is_full_at_the_start_ends_nothing(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    with full_disk(monkeypatch):
        log = rig.open()
        capture_all(log, 2)
        assert [type(fault) for fault in rig.faults] == [StorageError]
        assert log.records(None, 1).records == ()
        assert not list(rig.folder.iterdir())
    capture_all(log, 1)
    log.close()
    assert rig.kinds() == ["nothing", "gap", "capture", "stop"]


def test_full_disk_at_a_new_file_leaves_neither_half_a_line_nor_an_empty_file(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = rig.open(limit=SMALL)
    capture_all(log, 2)
    before = {path.name: path.read_bytes() for path in rig.folder.iterdir()}
    with full_disk(monkeypatch):
        capture_all(log, 2)
    assert {path.name: path.read_bytes() for path in rig.folder.iterdir()} == before
    capture_all(log, 1)
    assert rig.kinds() == ["nothing", "capture", "capture", "gap", "capture"]


def test_half_a_line_that_cannot_be_undone_spoils_no_other(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = rig.open()
    with monkeypatch.context() as patch, full_disk(monkeypatch):
        patch.setattr(os, "ftruncate", lambda *_: (_ for _ in ()).throw(FULL))
        capture_all(log, 1)
    capture_all(log, 1)
    assert rig.kinds() == ["nothing", "damage", "gap", "capture"]


def test_end_that_cannot_be_set_aside_is_tried_again(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig.life(1)
    [path] = rig.folder.iterdir()
    path.write_bytes(path.read_bytes() + b"{")
    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", lambda *_: (_ for _ in ()).throw(FULL))
        log = rig.open()
        capture_all(log, 1)
    capture_all(log, 1)
    log.close()
    assert rig.kinds() == [
        *("nothing", "capture", "stop", "damage", "stop", "gap", "capture", "stop"),
    ]


def test_full_disk_at_the_end_ends_nothing(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    log = rig.open()
    capture_all(log, 1)
    with full_disk(monkeypatch):
        log.close()
        log.close()
    assert len(rig.faults) == 1
    assert rig.kinds() == ["nothing", "capture"]


def test_nothing_is_written_after_the_stop(rig: Rig) -> None:
    log = rig.open()
    log.close()
    capture_all(log, 1)
    log.close()
    assert rig.kinds() == ["nothing", "stop"]


def test_files_that_are_removed_while_it_is_written_are_begun_anew(rig: Rig) -> None:
    log = rig.open()
    capture_all(log, 1)
    for path in rig.folder.iterdir():
        path.unlink()
    rig.folder.rmdir()
    capture_all(log, 1)
    [left] = records(rig.state_dir)
    assert left.position == 2


async def test_log_says_who_did_what(running: Running, store: TokenStore, tmp_path: Path) -> None:
    token: NewToken = store.create("a lamp", ("classify", "read:status"), None)
    log = open_log(tmp_path)
    async with running(admission=Admission(store, Site(), log, RateLimit(1e-9, 4))) as client:
        await client.post("/v1/classifications", content=b"{}")
        client.headers["Authorization"] = f"Bearer {token.secret}"
        request = {"X-Request-Id": "r-1", "Content-Type": "application/json"}
        answered = await client.post("/v1/classifications", headers=request, content=b"{}")
        assert answered.status_code == 200  # it has an entry of its own
        await client.get("/v1/status")
        await client.post("/v1/rotation/advance", headers={"X-Request-Id": "r-2"})
        await client.get("/v1/nothing/" + "x" * 500)
        for _ in range(5):
            assert (await client.post("/v1/classifications")).status_code == 429
    done, refused = events(tmp_path, "request"), events(tmp_path, "refused")
    assert [(entry["action"][:30], entry["status"], entry.get("code")) for entry in done] == [
        ("POST /v1/rotation/advance", 403, "forbidden"),
        ("GET /v1/nothing/" + "x" * 14, 404, "not_found"),
    ]
    assert {(entry["caller"], entry["label"]) for entry in done} == {(token.id, "a lamp")}
    assert done[0]["request"] == "r-2"
    assert [entry["code"] for entry in refused] == ["unauthorized"]
    assert "caller" not in refused[0]
    lines = [line_of(each) for each in records(tmp_path)]
    assert token.secret.rpartition("_")[2].encode() not in b"".join(lines)
    assert max(map(len, lines)) < 900


async def test_no_change_is_acknowledged_whose_entry_is_not_on_the_disk(
    running: Running, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Captures go on; what outlives the daemon is not answered for, and then not begun."""
    log = open_log(tmp_path)
    put = {"mode": "captures", "captures": 5}
    async with running(admission=Admission(log=log)) as client:
        assert (await client.put("/v1/rotation", json=put)).is_success
        with full_disk(monkeypatch):
            assert (await client.post("/v1/captures")).is_success
            for captures in (6, 7):
                answer = await client.put("/v1/rotation", json={**put, "captures": captures})
                assert (answer.status_code, answer.json()["code"]) == (503, "storage_failed")
                assert answer.headers["Retry-After"] == "1"
            assert (await client.post("/v1/rotation/advance")).is_success
            refused = await client.put("/v1/rotation", json={"mode": "never"})
            assert refused.json()["code"] == "storage_failed"
        assert (await client.put("/v1/rotation", json={**put, "captures": 8})).is_success
        assert (await client.get("/v1/rotation")).json()["policy"]["captures"] == 8
    said = [(entry["kind"], entry.get("status")) for entry in events(tmp_path)]
    assert said == [("request", 200), ("gap", None), ("request", 200)]


async def test_change_whose_entry_fails_is_not_answered_for(
    running: Running, store: TokenStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = open_log(tmp_path)
    asked = {"label": "a lamp", "scopes": ["read:status"]}
    async with running(admission=Admission(store, log=log)) as client:
        client.headers.update(bearer(store, "admin:tokens", "read:status"))
        once = {"Idempotency-Key": "k"}
        real, failing = log._write, [True]

        def write(entry: Any, *, durable: bool = False) -> Any:
            if failing and durable:
                raise StorageError("no space left")
            return real(entry, durable=durable)

        monkeypatch.setattr(log, "_write", write)
        answer = await client.post("/v1/tokens", json=asked, headers=once)
        assert (answer.status_code, answer.json()["code"]) == (503, "storage_failed")
        assert "secret" not in answer.text
        # It was made, and is told once that can be written down.
        failing.clear()
        again = await client.post("/v1/tokens", json=asked, headers=once)
        assert again.status_code == 201
        assert len(store.tokens()) == 2
    assert [entry["action"] for entry in events(tmp_path)][-1] == "POST /v1/tokens"
