"""Who gets in, for what, how often, and what is written down of it."""

from __future__ import annotations

import asyncio
import errno
import json
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest
from starlette.datastructures import Headers
from tests.server.damage import DAMAGES

from veilcam_client.wire.problems import PROBLEM_MEDIA_TYPE
from veilcam_client.wire.tokens import SCOPES, NewToken, Scope
from veilcam_server.api.app import create_app
from veilcam_server.api.routes import events
from veilcam_server.errors import (
    AuditError,
    ProblemError,
    RateLimitError,
    StartError,
    TooManyRequestsError,
    TooManyStreamsError,
    TooManyStreamsOfOneError,
    TooManyUploadsError,
    TooManyUploadsOfOneError,
)
from veilcam_server.security.admission import Admission, open_admission
from veilcam_server.security.audit import DONE, REFUSED, AuditLog, read_audit
from veilcam_server.security.limits import ConcurrencyLimit, RateLimit
from veilcam_server.security.site import Site
from veilcam_server.security.tokens import TokenStore
from veilcam_server.settings import Settings

if TYPE_CHECKING:
    from tests.server.conftest import Bench, Running

pytestmark = pytest.mark.anyio

OPEN_PATHS = ("/", "/healthz", "/readyz")
"""What everybody may ask; all else wants a token."""


@pytest.fixture
def store(tmp_path: Path) -> TokenStore:
    return TokenStore(tmp_path / "state")


def bearer(store: TokenStore, *scopes: Scope) -> dict[str, str]:
    return {"Authorization": f"Bearer {store.create('test', scopes, None).secret}"}


def filled(path: str) -> str:
    """A path with something in the place of its parameters."""
    return "/".join("000000000000" if "{" in part else part for part in path.split("/"))


def scopes_of(operation: dict[str, Any]) -> list[str]:
    return [scope for each in operation.get("security", []) for scope in each.get("token", [])]


def body_of(operation: dict[str, Any]) -> dict[str, str]:
    """The media type that a route takes."""
    taken = operation.get("requestBody", {}).get("content", ["application/json"])
    return {"Content-Type": next(iter(taken))}


async def test_every_route_wants_a_scope_and_lets_nobody_in_without(
    running: Running, store: TokenStore, bench: Bench
) -> None:
    tokens = {scope: bearer(store, scope) for scope in SCOPES}
    async with running(admission=Admission(tokens=store)) as client:
        document = await client.get("/v1/openapi.json", headers=tokens["read:status"])
        paths = document.json()["paths"]
        assert len(paths) > 5
        for path, operations in paths.items():
            for method, operation in operations.items():
                wanted = scopes_of(operation)
                if path in OPEN_PATHS:
                    assert not wanted
                    continue
                assert wanted, f"{method} {path} wants no scope"
                assert set(wanted) <= set(SCOPES)
                answer = await client.request(method, filled(path))
                assert answer.status_code == 401, (method, path)
                for scope, headers in tokens.items():
                    if scope in wanted:
                        continue
                    answer = await client.request(
                        method,
                        filled(path),
                        headers={**headers, **body_of(operation)},
                        content="{}",
                    )
                    assert answer.status_code == 403, (method, path, scope)
                    assert answer.json()["code"] == "forbidden"
                    assert f"the scope {wanted[0]}:" in answer.json()["detail"]
    assert bench.sensor.captures == 0


async def test_every_route_is_in_the_openapi_document(bench: Bench) -> None:
    def walk(routes: Any) -> Iterator[tuple[str, str]]:
        for route in routes:
            inner = getattr(route, "original_router", None)
            if inner is not None:
                yield from walk(inner.routes)
            else:
                for method in route.methods - {"HEAD", "OPTIONS"}:
                    yield method.lower(), route.path

    app = create_app(bench.service(bench.camera()))
    known = {
        (method, path) for path, methods in app.openapi()["paths"].items() for method in methods
    }
    assert set(walk(app.routes)) == known


async def test_all_ways_to_be_nobody_look_alike(running: Running, store: TokenStore) -> None:
    expired = store.create("gone", ("read:status",), 1e-6)
    revoked = store.create("revoked", ("read:status",), None)
    store.revoke(revoked.id)
    unknown = f"vc_{'0' * 12}_{'0' * 64}"
    given: list[list[tuple[str, str]]] = [
        [],
        [("Authorization", "")],
        [("Authorization", "nonsense")],
        *(
            [("Authorization", f"Bearer {token}")]
            for token in (expired.secret, revoked.secret, unknown)
        ),
        [*bearer(store, "read:status").items()] * 2,
    ]
    answers = set()
    async with running(admission=Admission(tokens=store)) as client:
        for headers in given:
            for path in ("/v1/status", "/v1/nothing"):
                answer = await client.get(path, headers=[*headers, ("X-Request-Id", "same")])
                assert answer.status_code == 401
                assert answer.headers["content-type"] == PROBLEM_MEDIA_TYPE
                assert answer.headers["www-authenticate"] == 'Bearer realm="veilcam"'
                answers.add(answer.text.replace(path, ""))
    assert len(answers) == 1


async def test_nothing_of_a_body_is_read_without_a_token(
    running: Running, store: TokenStore
) -> None:
    read = 0

    async def body() -> Any:
        nonlocal read
        for _ in range(10):
            read += 1
            yield b"x"

    async with running(admission=Admission(tokens=store)) as client:
        answer = await client.put("/v1/rotation", content=body())
    assert answer.status_code == 401
    assert read == 0


async def test_raw_embeddings_want_a_scope_more(
    running: Running, bench: Bench, store: TokenStore
) -> None:
    ordinary = bearer(store, "read:embedding", "classify")
    full = bearer(store, "read:embedding", "read:embedding:raw", "classify")
    classify = bearer(store, "classify")
    wanted = {"include_embedding": True}
    async with running(admission=Admission(tokens=store)) as client:
        for headers, scope in ((ordinary, "read:embedding:raw"), (classify, "read:embedding")):
            refused = [
                await client.post("/v1/captures", headers=headers),
                await client.post("/v1/classifications", headers=headers, json=wanted),
            ]
            for answer in refused:
                assert answer.json()["code"] == "forbidden"
                assert f"the scope {scope}:" in answer.json()["detail"]
        assert bench.sensor.captures == 0
        assert (await client.post("/v1/classifications", headers=classify)).is_success
        assert (await client.post("/v1/captures", headers=full)).is_success
        answer = await client.post("/v1/classifications", headers=full, json=wanted)
        assert answer.json()["embedding"]["form"] == "raw"


async def test_white_embeddings_want_no_more(
    running: Running, fresh_bench: Bench, store: TokenStore
) -> None:
    headers = bearer(store, "read:embedding")
    async with running(admission=Admission(tokens=store), on=fresh_bench) as client:
        answer = await client.post("/v1/captures", headers=headers)
    assert answer.json()["embedding"]["form"] == "white"


async def test_an_idempotency_key_is_a_caller_s_own(
    running: Running, store: TokenStore, bench: Bench
) -> None:
    key = {"Idempotency-Key": "k"}
    scopes: tuple[Scope, ...] = ("read:embedding", "read:embedding:raw")
    first, second = bearer(store, *scopes), bearer(store, *scopes)
    async with running(admission=Admission(tokens=store)) as client:
        answers = [
            await client.post("/v1/captures", headers={**key, **headers})
            for headers in (first, second, first)
        ]
    assert bench.sensor.captures == 2
    assert answers[0].content == answers[2].content != answers[1].content


async def test_who_asks_too_often_waits_and_others_do_not(
    running: Running, store: TokenStore
) -> None:
    now = 0.0
    admission = Admission(tokens=store, rate=RateLimit(0.5, 2, lambda: now))
    hasty, other = bearer(store, "read:status"), bearer(store, "read:status")
    async with running(admission=admission) as client:

        async def ask(headers: dict[str, str]) -> int:
            return (await client.get("/v1/status", headers=headers)).status_code

        assert [await ask(hasty) for _ in range(3)] == [200, 200, 429]
        refused = await client.get("/v1/status", headers=hasty)
        assert refused.json()["code"] == "rate_limited"
        assert refused.headers["retry-after"] == "2"
        assert await ask(other) == 200
        # Who guesses is slowed down, and locks nobody out.
        assert [await ask({}) for _ in range(3)] == [401, 401, 429]
        assert await ask(other) == 200
        now = 2.0
        assert [await ask(hasty) for _ in range(2)] == [200, 429]


async def test_events_end_with_their_token_and_tell_labels_to_who_may_know_them(
    running: Running, store: TokenStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(events, "RECHECK", 0.0)
    heard = {}
    worker = bearer(store, "classify", "read:status")
    scopes: dict[str, tuple[Scope, ...]] = {
        "without": ("read:status",),
        "with": ("read:status", "classify"),
    }
    async with running(admission=Admission(tokens=store)) as client:
        for name, held in scopes.items():
            token = store.create(name, held, None)
            headers = {"Authorization": f"Bearer {token.secret}", "Last-Event-ID": "0-0"}
            listening = asyncio.create_task(client.get("/v1/events", headers=headers))
            assert (await client.post("/v1/classifications", headers=worker)).is_success
            await asyncio.sleep(0.2)
            store.revoke(token.id)
            async with asyncio.timeout(60):
                heard[name] = (await listening).text
    assert "event: capture" in heard["without"]
    assert "event: classification" in heard["with"]
    assert "classification" not in heard["without"]
    assert "label" not in heard["without"]


def test_buckets_of_callers_are_bounded() -> None:
    limit = RateLimit(1.0, 1, lambda: 0.0)
    for number in range(5000):
        limit.take(str(number))
    assert len(limit._buckets) <= 1024


async def test_so_many_requests_at_once(running: Running, store: TokenStore, bench: Bench) -> None:
    import threading

    go_on = threading.Event()
    admission = Admission(tokens=store, concurrency=ConcurrencyLimit(1))
    headers, other = bearer(store, "classify"), bearer(store, "read:status")
    bench.sensor.before = lambda: (go_on.wait(10), None)[1]
    async with running(admission=admission) as client:
        first = asyncio.create_task(client.post("/v1/classifications", headers=headers))
        while (await client.get("/v1/status", headers=other)).json()["queue"]["waiting"] == 0:
            await asyncio.sleep(0.01)
        refused = await client.post("/v1/classifications", headers=headers)
        assert refused.json()["code"] == "too_many_requests"
        assert int(refused.headers["retry-after"]) >= 1
        go_on.set()
        assert (await first).is_success
        assert (await client.post("/v1/classifications", headers=headers)).is_success


async def test_so_many_event_streams(running: Running) -> None:
    async with running(
        admission=Admission(streams=ConcurrencyLimit(0, TooManyStreamsError))
    ) as client:
        refused = await client.get("/v1/events")
    assert refused.json()["code"] == "too_many_streams"
    limit = ConcurrencyLimit(1, TooManyStreamsError)
    with limit.held("all"), pytest.raises(Exception, match="1 event streams are open"):
        limit.held("all").__enter__()
    with limit.held("all"):
        pass


async def test_a_daemon_without_tokens_says_how_to_make_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = Settings(bundle=tmp_path / "a.veilcam", state_dir=tmp_path / "state")
    with open_admission(settings) as admission:
        assert admission.tokens is not None
        admission.tokens.create("first", ("classify",), None)
    assert "veilcamd token create" in capsys.readouterr().out
    with open_admission(settings):
        pass
    assert capsys.readouterr().out == ""
    actions = [entry["action"] for entry in lines(tmp_path / "state" / DONE)]
    assert actions == ["start", "stop", "start", "stop"]


async def test_one_caller_leaves_streams_to_others(running: Running, store: TokenStore) -> None:
    admission = Admission(
        tokens=store,
        streams=ConcurrencyLimit(3, TooManyStreamsError),
        streams_of_one=ConcurrencyLimit(2, TooManyStreamsOfOneError),
    )
    one, other, third = (bearer(store, "read:status") for _ in range(3))
    async with running(admission=admission) as client, asyncio.timeout(30):
        streams: list[asyncio.Task[httpx.Response]] = []
        for number, headers in enumerate((one, one, other), 1):
            streams.append(asyncio.create_task(client.get("/v1/events", headers=headers)))
            while admission.streams._under_way.total() < number:
                await asyncio.sleep(0.001)
            if number == 2:
                refused = await client.get("/v1/events", headers=one)
                assert refused.json()["code"] == "too_many_streams"
                assert "2 of your event streams" in refused.json()["detail"]
        refused = await client.get("/v1/events", headers=third)
        assert "3 event streams are open" in refused.json()["detail"]
        assert not any(stream.done() for stream in streams)
        for stream in streams:
            stream.cancel()


async def test_where_no_tokens_are_wanted_the_caller_is_the_peer() -> None:
    admission = Admission()
    with admission.admitted(Headers(), "127.0.0.2") as caller:
        assert caller.id == "127.0.0.2"
        assert caller.scopes == frozenset(SCOPES)


async def test_limits_are_those_of_the_settings(tmp_path: Path) -> None:
    settings = Settings(
        bundle=tmp_path / "a.veilcam",
        state_dir=tmp_path / "state",
        rate_limit=1e-6,
        rate_burst=2,
        concurrency_limit=3,
        stream_limit=4,
        caller_stream_limit=1,
        upload_limit=3,
        caller_upload_limit=1,
    )
    with open_admission(settings) as admission, ExitStack() as stack:
        admission.rate.take("a")
        admission.rate.take("a")
        with pytest.raises(RateLimitError):
            admission.rate.take("a")
        for _ in range(3):
            stack.enter_context(admission.concurrency.held("a"))
        with pytest.raises(TooManyRequestsError):
            stack.enter_context(admission.concurrency.held("a"))
        for _ in range(4):
            stack.enter_context(admission.streams.held("all"))
        with pytest.raises(TooManyStreamsError):
            stack.enter_context(admission.streams.held("all"))
        stack.enter_context(admission.streams_of_one.held("a"))
        stack.enter_context(admission.streams_of_one.held("b"))
        with pytest.raises(TooManyStreamsOfOneError):
            stack.enter_context(admission.streams_of_one.held("a"))
        for _ in range(3):
            stack.enter_context(admission.uploads.held("all"))
        with pytest.raises(TooManyUploadsError):
            stack.enter_context(admission.uploads.held("all"))
        stack.enter_context(admission.uploads_of_one.held("a"))
        with pytest.raises(TooManyUploadsOfOneError):
            stack.enter_context(admission.uploads_of_one.held("a"))


# The audit log.


@pytest.fixture
def logs(tmp_path: Path) -> Iterator[tuple[AuditLog, AuditLog]]:
    done, refused = AuditLog(tmp_path / DONE), AuditLog(tmp_path / REFUSED)
    yield done, refused
    done.close()
    refused.close()


def lines(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


async def test_the_audit_log_says_who_did_what(
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


def test_an_audit_log_that_cannot_be_written_is_told_once_and_stops_nothing(
    told: Told, capsys: pytest.CaptureFixture[str]
) -> None:
    told.log.write("first")
    with full_disk(told.log):
        for _ in range(3):
            told.log.write("lost")
    told.log.write("last")
    assert told.log.lost == 3
    (fault,) = told.faults
    assert isinstance(fault, AuditError)
    assert "cannot be written (No space left on device): check the state" in str(fault)
    assert capsys.readouterr().out.count("can be written again") == 1
    assert told.actions() == ["first", "last"]
    with full_disk(told.log):
        told.log.write("lost")
    assert len(told.faults) == 2


def test_a_line_that_must_be_durable_is_or_is_refused(
    told: Told, monkeypatch: pytest.MonkeyPatch
) -> None:
    flushed: list[str] = []
    fsync = os.fsync

    def noted(descriptor: int) -> None:
        flushed.append(Path(os.readlink(f"/proc/self/fd/{descriptor}")).name)
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", noted)
    told.log.write("capture")
    assert flushed == [told.path.parent.name]  # once: the file is new
    for _ in range(2):
        told.log.write("change", durable=True)
    assert flushed[1:] == ["a.jsonl", "a.jsonl"]
    with full_disk(told.log), pytest.raises(AuditError, match="No space left"):
        told.log.write("lost", durable=True)

    def fail(descriptor: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(AuditError, match="Input/output error"):
        told.log.write("in doubt", durable=True)
    assert told.log.lost == 2
    assert len(told.faults) == 1


def test_no_change_is_begun_while_nothing_can_be_written(told: Told) -> None:
    told.log.require()
    assert not told.path.exists()
    with full_disk(told.log):
        told.log.write("lost")
        for _ in range(2):
            with pytest.raises(AuditError):
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


def test_what_was_written_of_a_line_on_a_full_disk_does_not_spoil_the_next_one(
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
def test_a_damaged_audit_log_is_read_and_goes_on(
    told: Told, damage: Callable[[Path], None]
) -> None:
    for _ in range(3):
        told.log.write("before")
    told.log.close()
    damage(told.path)
    told.log.write("after")
    assert told.actions()[-1] == "after"
    assert set(told.actions()) <= {"before", "a line that is damaged", "after"}


def test_a_file_that_is_removed_while_it_is_written_is_made_anew(told: Told) -> None:
    told.log.write("before")
    told.path.unlink()
    told.log.write("after")
    assert told.actions() == ["after"]


def test_a_file_that_cannot_be_opened_is_opened_as_soon_as_it_can(told: Told) -> None:
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
                assert (answer.status_code, answer.json()["code"]) == (503, "audit_not_written")
                assert answer.headers["Retry-After"] == "1"
                policy = (await client.get("/v1/rotation")).json()["policy"]
                assert policy == {**put, "reuse": 0}
            assert (await client.post("/v1/rotation/advance")).is_success
            refused = await client.put("/v1/rotation", json={"mode": "never"})
            assert refused.json()["code"] == "audit_not_written"
        assert (await client.put("/v1/rotation", json={**put, "captures": 8})).is_success
        assert (await client.get("/v1/rotation")).json()["policy"]["captures"] == 8
    entries = read_audit(done._path)
    assert [(entry["action"], entry.get("status")) for entry in entries] == [
        ("PUT /v1/rotation", 200),
        ("audit log was out of reach", None),
        ("PUT /v1/rotation", 200),
    ]


async def test_a_change_whose_line_fails_is_not_answered_for(
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
        assert (answer.status_code, answer.json()["code"]) == (503, "audit_not_written")
        assert "secret" not in answer.text
        # It was made, and is told once that can be written down.
        again = await client.post("/v1/tokens", json=asked, headers=once)
        assert again.status_code == 201
        assert len(store.tokens()) == 2
    assert [entry["action"] for entry in read_audit(done._path)] == [
        "audit log was out of reach",
        "POST /v1/tokens",
    ]


async def test_a_change_is_flushed_and_a_capture_is_not(
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
