"""What is written down of who asked, and what follows where it cannot be."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.unit.server.damage import DAMAGES
from tests.unit.server.security.conftest import bearer

from veilcam_client.wire.tokens import NewToken
from veilcam_server.errors import ProblemError, StartError, StorageError
from veilcam_server.security.admission import Admission
from veilcam_server.security.audit import DONE, REFUSED, AuditLog, read_audit
from veilcam_server.security.limits import RateLimit
from veilcam_server.security.site import Site
from veilcam_server.security.tokens import TokenStore

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench, Running

pytestmark = pytest.mark.anyio


@pytest.fixture
def logs(tmp_path: Path) -> Iterator[tuple[AuditLog, AuditLog]]:
    done, refused = AuditLog(tmp_path / DONE), AuditLog(tmp_path / REFUSED)
    yield done, refused
    done.close()
    refused.close()


def lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


async def test_audit_log_says_who_did_what(
    running: Running, store: TokenStore, logs: tuple[AuditLog, AuditLog], tmp_path: Path
) -> None:
    token: NewToken = store.create("a lamp", ("classify", "read:status"), None)
    admission = Admission(store, Site(), *logs, RateLimit(1e-9, 4))
    async with running(admission=admission) as client:
        await client.post("/v1/classifications", content=b"{}")
        client.headers["Authorization"] = f"Bearer {token.secret}"
        request = {"X-Request-Id": "r-1", "Content-Type": "application/json"}
        await client.post("/v1/classifications", headers=request, content=b"{}")
        await client.get("/v1/status")
        await client.post("/v1/rotation/advance")
        await client.get("/v1/nothing/" + "x" * 500)
        for _ in range(5):
            assert (await client.post("/v1/classifications")).status_code == 429
    done, refused = lines(tmp_path / DONE), lines(tmp_path / REFUSED)
    assert [(entry["action"][:30], entry["status"], entry.get("code")) for entry in done] == [
        ("POST /v1/classifications", 200, None),
        ("POST /v1/rotation/advance", 403, "forbidden"),
        ("GET /v1/nothing/" + "x" * 14, 404, "not_found"),
    ]
    assert {(entry["caller"], entry["label"]) for entry in done} == {(token.id, "a lamp")}
    assert done[0]["request"] == "r-1"
    assert done[0]["at"] < done[1]["at"]
    assert [entry["code"] for entry in refused] == ["unauthorized"]
    assert "caller" not in refused[0]
    text = (tmp_path / DONE).read_text() + (tmp_path / REFUSED).read_text()
    assert token.secret.rpartition("_")[2] not in text
    assert max(map(len, text.splitlines())) < 500


async def test_full_files_are_numbered_and_the_oldest_go(tmp_path: Path) -> None:
    log = AuditLog(tmp_path / "a.jsonl", limit=400, kept=2)
    for number in range(40):
        log.write("act", number=number)
    log.close()
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["a.jsonl", "a.jsonl.1", "a.jsonl.2"]
    assert all(path.stat().st_size <= 400 for path in tmp_path.iterdir())
    numbers = [entry["number"] for entry in read_audit(tmp_path / "a.jsonl")]
    assert numbers == list(range(numbers[0], 40))
    assert len(numbers) > 10
    again = AuditLog(tmp_path / "a.jsonl", limit=400, kept=2)
    again.write("act", number=40)
    again.close()
    assert read_audit(tmp_path / "a.jsonl")[-1]["number"] == 40


@contextmanager
def full_disk(log: AuditLog) -> Iterator[None]:
    """The kernel's own full device in place of the file."""
    file, full = log._file, os.open("/dev/full", os.O_RDWR)
    log._file = full
    yield
    log._file = file
    os.close(full)


class Told:
    """An audit log and the faults of it."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "a.jsonl"
        self.faults: list[ProblemError] = []
        self.log = AuditLog(self.path, report=self.faults.append)

    def actions(self) -> list[str]:
        return [entry["action"] for entry in read_audit(self.path)]


@pytest.fixture
def told(tmp_path: Path) -> Iterator[Told]:
    made = Told(tmp_path)
    yield made
    made.log.close()


def test_audit_log_that_cannot_be_written_is_told_once_and_stops_nothing(
    told: Told, capsys: pytest.CaptureFixture[str]
) -> None:
    told.log.write("first")
    with full_disk(told.log):
        for _ in range(3):
            told.log.write("lost")
    told.log.write("last")
    assert told.log.lost == 3
    (fault,) = told.faults
    assert isinstance(fault, StorageError)
    assert "cannot be written (No space left on device): check the state" in str(fault)
    assert capsys.readouterr().out.count("can be written again") == 1
    assert told.actions() == ["first", "last"]
    with full_disk(told.log):
        told.log.write("lost")
    assert len(told.faults) == 2


def test_line_that_must_be_durable_is_or_is_refused(
    told: Told, flushed: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    told.log.write("capture")
    assert flushed == [told.path.parent.name]  # once: the file is new
    for _ in range(2):
        told.log.write("change", durable=True)
    assert flushed[1:] == ["a.jsonl", "a.jsonl"]
    with full_disk(told.log), pytest.raises(StorageError, match="No space left"):
        told.log.write("lost", durable=True)

    def fail(descriptor: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(StorageError, match="Input/output error"):
        told.log.write("in doubt", durable=True)
    assert told.log.lost == 2
    assert len(told.faults) == 1


def test_no_change_is_begun_while_nothing_can_be_written(told: Told) -> None:
    told.log.require()
    assert not told.path.exists()
    with full_disk(told.log):
        told.log.write("lost")
        for _ in range(2):
            with pytest.raises(StorageError):
                told.log.require()
    told.log.require()
    told.log.require()
    assert [(entry["action"], entry["lost"]) for entry in read_audit(told.path)] == [
        ("audit log was out of reach", 3)
    ]


def test_half_a_line_does_not_spoil_the_next_one(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    path.write_bytes(b'{"at": "x", "action": "whole"}\n{"at": "x", "acti')
    log = AuditLog(path)
    log.write("next")
    log.close()
    entries = read_audit(path)
    assert [entry["action"] for entry in entries] == ["whole", "a line that is damaged", "next"]
    assert entries[1] == {"at": "", "action": "a line that is damaged", "file": "a.jsonl"}


def test_part_of_a_line_on_a_full_disk_does_not_spoil_the_next_one(
    told: Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = os.write
    with monkeypatch.context() as patch:
        patch.setattr(os, "write", lambda file, line: write(file, line[:10]))
        told.log.write("half")
    assert told.log.lost == 1
    told.log.write("whole")
    told.log.write("whole")
    assert told.actions() == ["a line that is damaged", "whole", "whole"]


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_damaged_audit_log_is_read_and_goes_on(told: Told, damage: Callable[[Path], None]) -> None:
    for _ in range(3):
        told.log.write("before")
    told.log.close()
    damage(told.path)
    told.log.write("after")
    assert told.actions()[-1] == "after"
    assert set(told.actions()) <= {"before", "a line that is damaged", "after"}


def test_file_that_is_removed_while_it_is_written_is_made_anew(told: Told) -> None:
    told.log.write("before")
    told.path.unlink()
    told.log.write("after")
    assert told.actions() == ["after"]


def test_file_that_cannot_be_opened_is_opened_as_soon_as_it_can(told: Told) -> None:
    told.path.mkdir()
    told.log.write("lost")
    assert (told.log.lost, len(told.faults)) == (1, 1)
    told.path.rmdir()
    told.log.write("written")
    assert told.actions() == ["written"]


def test_entries_are_objects_with_a_time_and_an_action(tmp_path: Path) -> None:
    path = tmp_path / "a.jsonl"
    path.write_bytes(b'[]\n{"at": "x"}\n\n\xff\n{"at": "x", "action": "act", "more": 1}\n')
    assert [entry["action"] for entry in read_audit(path)] == [
        *3 * ["a line that is damaged"],
        "act",
    ]
    path.unlink()
    assert read_audit(path) == []
    path.mkdir()
    with pytest.raises(StartError, match=r"a\.jsonl cannot be read \(Is a directory\)"):
        read_audit(path)


async def test_no_change_is_acknowledged_whose_line_is_not_on_the_disk(
    running: Running, logs: tuple[AuditLog, AuditLog], bench: Bench
) -> None:
    """Captures go on; what outlives the daemon is not answered for, and then not begun."""
    done, _ = logs
    put = {"mode": "captures", "captures": 5}
    async with running(admission=Admission(audit=done)) as client:
        assert (await client.put("/v1/rotation", json=put)).is_success
        with full_disk(done):
            assert (await client.post("/v1/captures")).is_success
            for captures in (6, 7):
                answer = await client.put("/v1/rotation", json={**put, "captures": captures})
                assert (answer.status_code, answer.json()["code"]) == (503, "storage_failed")
                assert answer.headers["Retry-After"] == "1"
                policy = (await client.get("/v1/rotation")).json()["policy"]
                assert policy == {**put, "reuse": 0}
            assert (await client.post("/v1/rotation/advance")).is_success
            refused = await client.put("/v1/rotation", json={"mode": "never"})
            assert refused.json()["code"] == "storage_failed"
        assert (await client.put("/v1/rotation", json={**put, "captures": 8})).is_success
        assert (await client.get("/v1/rotation")).json()["policy"]["captures"] == 8
    entries = read_audit(done._path)
    assert [(entry["action"], entry.get("status")) for entry in entries] == [
        ("PUT /v1/rotation", 200),
        ("audit log was out of reach", None),
        ("PUT /v1/rotation", 200),
    ]


async def test_change_whose_line_fails_is_not_answered_for(
    running: Running, logs: tuple[AuditLog, AuditLog], store: TokenStore
) -> None:
    done, _ = logs
    admin = {**bearer(store, "admin:tokens", "read:status")}
    asked = {"label": "a lamp", "scopes": ["read:status"]}
    async with running(admission=Admission(store, audit=done)) as client:
        client.headers.update(admin)
        once = {"Idempotency-Key": "k"}
        with full_disk(done):
            answer = await client.post("/v1/tokens", json=asked, headers=once)
        assert (answer.status_code, answer.json()["code"]) == (503, "storage_failed")
        assert "secret" not in answer.text
        # It was made, and is told once that can be written down.
        again = await client.post("/v1/tokens", json=asked, headers=once)
        assert again.status_code == 201
        assert len(store.tokens()) == 2
    assert [entry["action"] for entry in read_audit(done._path)] == [
        "audit log was out of reach",
        "POST /v1/tokens",
    ]


async def test_change_is_flushed_and_a_capture_is_not(
    running: Running, logs: tuple[AuditLog, AuditLog], monkeypatch: pytest.MonkeyPatch
) -> None:
    done, _ = logs
    durable: list[tuple[str, bool]] = []
    write = done.write

    def noted(action: str, **details: Any) -> None:
        durable.append((action, details["durable"]))
        write(action, **details)

    monkeypatch.setattr(done, "write", noted)
    async with running(admission=Admission(audit=done)) as client:
        await client.put("/v1/rotation", json={"mode": "off"})
        await client.post("/v1/captures")
        await client.post("/v1/rotation/advance")
        await client.put("/v1/rotation", json={"mode": "never"})
    assert durable == [
        ("PUT /v1/rotation", True),
        ("POST /v1/captures", False),
        ("POST /v1/rotation/advance", False),
        ("PUT /v1/rotation", False),
    ]
