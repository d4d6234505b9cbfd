"""Tokens: made, listed, revoked, expired, and what a daemon makes of them meanwhile."""

from __future__ import annotations

import json
import stat
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.unit.server.damage import DAMAGES
from tests.unit.server.logs import events, records
from typer.testing import CliRunner

from veilcam_client.wire.tokens import SCOPES, NewToken, Scope, Tokens
from veilcam_server.cli.main import app
from veilcam_server.errors import (
    ProblemError,
    StartError,
    StorageError,
    UnauthorizedError,
)
from veilcam_server.security.admission import Admission
from veilcam_server.security.log import FOLDER
from veilcam_server.security.tokens import Caller, TokenStore

if TYPE_CHECKING:
    import httpx
    from tests.unit.server.conftest import Running

runner = CliRunner()
DAY = 86_400.0


class Clock:
    """A wall clock that can be set, and a monotonic one that cannot."""

    def __init__(self) -> None:
        self.wall, self.elapsed = 1.8e9, 5.0

    def sleep(self, seconds: float) -> None:
        self.wall += seconds
        self.elapsed += seconds


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def store(tmp_path: Path, clock: Clock) -> TokenStore:
    return reopened(tmp_path, clock)


def reopened(tmp_path: Path, clock: Clock) -> TokenStore:
    """As after a restart, or in another process."""
    return TokenStore(tmp_path / "state", lambda: clock.wall, lambda: clock.elapsed)


def record(directory: Path) -> dict[str, Any]:
    """What stands on the disk, without the checksum."""
    found: dict[str, Any] = json.loads((directory / "tokens.json").read_text().splitlines()[1])
    return found


def make(store: TokenStore, *scopes: Scope, lifetime: float | None = None) -> NewToken:
    return store.create("for a test", scopes or ("classify",), lifetime)


def who(store: TokenStore, token: str) -> Caller:
    return store.caller(f"Bearer {token}")


def turn_away(store: TokenStore, token: str) -> None:
    with pytest.raises(UnauthorizedError):
        who(store, token)


def test_scopes_of_an_earlier_version_are_refused(tmp_path: Path) -> None:
    store = TokenStore(tmp_path)
    scopes: Any = ("admin:keyring", "read:status")
    store.create("of another version", scopes, None)
    with pytest.raises(StartError, match=r"with the scopes admin:keyring: move it away"):
        TokenStore(tmp_path)


def test_token_is_its_label_and_scopes(store: TokenStore) -> None:
    made = make(store, "mask:rotate", "classify", "classify")
    caller = who(store, made.secret)
    assert (caller.id, caller.label) == (made.id, "for a test")
    assert caller.scopes == {"classify", "mask:rotate"}
    assert made.scopes == ("classify", "mask:rotate")
    assert made.secret.startswith(f"vc_{made.id}_")
    assert len(made.secret.rpartition("_")[2]) == 64  # 256 bits
    assert made.secret not in repr(made)


def test_secrets_are_neither_on_the_disk_nor_readable_by_others(
    store: TokenStore, tmp_path: Path
) -> None:
    made = make(store)
    who(store, made.secret)
    secret = made.secret.rpartition("_")[2]
    assert stat.S_IMODE((tmp_path / "state").stat().st_mode) == 0o700
    for path in (tmp_path / "state").iterdir():
        content = path.read_bytes()
        assert secret.encode() not in content
        assert bytes.fromhex(secret) not in content
        assert stat.S_IMODE(path.stat().st_mode) == 0o600, path


@pytest.mark.parametrize(
    "spoil",
    [
        lambda header: "",
        lambda header: header.removeprefix("Bearer "),
        lambda header: header.replace("Bearer", "Basic"),
        lambda header: header.replace("Bearer ", "Bearer  "),
        lambda header: header.replace("Bearer ", "bearer"),
        lambda header: header.replace("Bearer", "Bearers"),
        lambda header: header + " ",
        lambda header: header[:-1],
        lambda header: header[:-1] + ("0" if header[-1] != "0" else "1"),
        lambda header: header.upper(),
        lambda header: header.replace("vc_", "vc_ffffffffffff"),
        lambda header: "Bearer vc_" + 12 * "0" + "_" + 64 * "0",
        lambda header: header + "\n",
        lambda header: "Bearer vc_" + 12 * "٣" + "_" + 64 * "٣",
    ],
)
def test_secret_that_is_not_quite_a_token_is_refused(store: TokenStore, spoil: Any) -> None:
    secret = make(store).secret
    header = f"Bearer {secret}"
    for scheme in ("Bearer", "bearer", "BEARER", "bEaReR"):
        store.caller(f"{scheme} {secret}")
    with pytest.raises(UnauthorizedError):
        store.caller(spoil(header))


def test_revoked_token_is_refused_and_stays_on_the_list(store: TokenStore) -> None:
    first, second = make(store), make(store)
    turn_away(store, f"vc_{first.id}_{second.secret.rpartition('_')[2]}")
    revoked = store.revoke(first.id)
    assert revoked.revoked_at is not None
    assert store.revoke(first.id) == revoked
    turn_away(store, first.secret)
    who(store, second.secret)
    assert {token.id for token in store.tokens()} == {first.id, second.id}
    with pytest.raises(ProblemError):
        store.revoke("0" * 12)


def test_token_ends_and_a_clock_set_back_does_not_bring_it_back(
    store: TokenStore, clock: Clock, tmp_path: Path
) -> None:
    made = make(store, lifetime=60.0)
    clock.sleep(59)
    who(store, made.secret)
    clock.sleep(1)
    turn_away(store, made.secret)
    clock.wall -= 1e6
    turn_away(store, made.secret)
    lasting = make(store, lifetime=60.0)
    assert lasting.expires_at is not None
    who(store, lasting.secret)
    # After a restart, a clock that starts in the past goes on from what was written last.
    clock.wall = 0.0
    again = reopened(tmp_path, clock)
    turn_away(again, made.secret)
    who(again, lasting.secret)
    clock.elapsed += 61
    turn_away(again, lasting.secret)


def test_clock_set_forward_ends_tokens(store: TokenStore, clock: Clock) -> None:
    ending, endless = make(store, lifetime=60.0), make(store)
    clock.wall += 3600
    turn_away(store, ending.secret)
    who(store, endless.secret)


def test_change_of_another_process_holds_from_the_next_request_on(
    store: TokenStore, tmp_path: Path
) -> None:
    other = TokenStore(tmp_path / "state")
    made = make(other)
    who(store, made.secret)
    other.revoke(made.id)
    turn_away(store, made.secret)


def test_request_writes_nothing_but_once_a_day(store: TokenStore, clock: Clock) -> None:
    made = make(store)
    versions = [store._file.version]
    for _ in range(3):
        for _ in range(50):
            who(store, made.secret)
            if store._file.version != versions[-1]:
                versions.append(store._file.version)
        clock.sleep(DAY)
    assert len(versions) == 4
    who(store, made.secret)
    assert store.tokens()[0].last_used_on == "2027-01-18"


def test_disk_that_takes_nothing_refuses_no_request(
    store: TokenStore, tmp_path: Path, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = make(store)
    before = (tmp_path / "state" / "tokens.json").read_bytes()
    tried: list[object] = []

    def fail(update: object) -> None:
        tried.append(update)
        raise StorageError("written (No space left on device): check the disk")

    with monkeypatch.context() as patch:
        patch.setattr(store._file, "stage", fail)
        for _ in range(3):
            who(store, made.secret)
        assert len(tried) == 1
        # What is not on the disk is not told.
        assert store.tokens()[0].last_used_on is None
        for change in (make, lambda store: store.revoke(made.id)):
            with pytest.raises(StorageError, match=r"written \(No space left .*: check the"):
                change(store)
    assert (tmp_path / "state" / "tokens.json").read_bytes() == before
    clock.sleep(59.5)
    who(store, made.secret)
    assert store.tokens()[0].last_used_on is None
    clock.sleep(0.5)
    who(store, made.secret)
    assert store.tokens()[0].last_used_on == "2027-01-15"


def test_path_that_is_no_directory_is_a_reason_not_to_start(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(StartError, match=r"file cannot be used .* --state-dir"):
        TokenStore(tmp_path / "file")


@pytest.mark.parametrize("running", [True, False], ids=["while it runs", "at the start"])
@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_lost_tokens_let_nobody_in(
    tmp_path: Path, damage: Callable[[Path], None], running: bool
) -> None:
    faults: list[ProblemError] = []
    store = TokenStore(tmp_path, report=faults.append)
    made = make(store)
    who(store, made.secret)
    for name in ("tokens.json", "tokens.json.copy"):
        damage(tmp_path / name)
    if not running:
        store = TokenStore(tmp_path, report=faults.append)
    for _ in range(3):
        turn_away(store, made.secret)
    (fault,) = faults
    assert fault.code == "state_lost"
    assert "nobody is let in until 'veilcamd token first' makes a token" in str(fault)
    other = make(TokenStore(tmp_path))
    assert who(store, other.secret).id == other.id
    turn_away(store, made.secret)
    assert len(faults) == 1


def test_tokens_that_cannot_be_read_let_nobody_in_until_they_can(
    store: TokenStore, tmp_path: Path
) -> None:
    made, path = make(store), tmp_path / "state" / "tokens.json"
    kept = path.rename(tmp_path / "kept.json")
    path.mkdir()
    with pytest.raises(StorageError, match=r"cannot be read \(.*\): 'veilcamd doctor'"):
        who(store, made.secret)
    with pytest.raises(StorageError, match=r"cannot be written \(Is a directory\)"):
        make(store)
    path.rmdir()
    kept.rename(path)
    assert who(store, made.secret).id == made.id


def test_tokens_are_forgotten_90_days_after_they_ended(
    store: TokenStore, clock: Clock, tmp_path: Path
) -> None:
    def held() -> set[str]:
        return {row["id"] for row in record(tmp_path / "state")["tokens"]}

    endless, revoked, ending = make(store), make(store), make(store, lifetime=3 * DAY)
    store.revoke(revoked.id)
    both = make(store, lifetime=500 * DAY)
    clock.sleep(DAY)
    store.revoke(both.id)
    clock.sleep(89 * DAY - 1)
    assert held() == {endless.id, revoked.id, ending.id, both.id}
    last = make(store)
    assert held() == {endless.id, revoked.id, ending.id, both.id, last.id}
    clock.sleep(1)
    store.revoke(last.id)
    assert held() == {endless.id, ending.id, both.id, last.id}
    with pytest.raises(ProblemError):
        store.revoke(revoked.id)
    clock.sleep(3 * DAY)
    # Asking forgets nothing: a clock that is wrong for a second must not cost a token.
    who(store, endless.secret)
    assert held() == {endless.id, ending.id, both.id, last.id}
    with pytest.raises(ProblemError):
        store.revoke(ending.id)
    make(store)
    assert {endless.id, last.id} < held()
    assert not {ending.id, both.id} & held()


def test_list_tells_all_but_the_secret(store: TokenStore, clock: Clock) -> None:
    endless, ending = make(store, "metrics"), make(store, lifetime=60.0)
    store.revoke(endless.id)
    first, second = store.tokens()
    made_at = datetime.fromtimestamp(clock.wall, UTC)
    assert (first.id, first.label, first.scopes) == (endless.id, "for a test", ("metrics",))
    assert (first.created_at, first.expires_at, first.revoked_at) == (made_at, None, made_at)
    assert (second.id, second.scopes) == (ending.id, ("classify",))
    assert (second.expires_at, second.revoked_at) == (made_at + timedelta(seconds=60), None)
    assert first.last_used_on is second.last_used_on is None
    assert endless.created_at == made_at
    assert len(endless.id) == 12  # 48 bits: a name, not a secret


def test_caller_is_told_how_long_it_may_still_come(store: TokenStore, clock: Clock) -> None:
    caller = who(store, make(store, lifetime=60.0).secret)
    assert caller.expires == clock.wall + 60.0
    clock.sleep(45)
    assert store.lifetime(caller) == 15.0
    clock.sleep(14.5)
    assert store.lifetime(caller) == 0.5
    clock.sleep(1)
    assert store.lifetime(caller) == 0.0
    assert store.lifetime(who(store, make(store).secret)) is None


def test_clock_that_stands_still_does_not_keep_a_token(store: TokenStore, clock: Clock) -> None:
    made = make(store, lifetime=60.0)
    for _ in range(6):
        who(store, made.secret)
        clock.elapsed += 10
    turn_away(store, made.secret)


def test_two_stores_that_write_at_once_lose_nothing(store: TokenStore, tmp_path: Path) -> None:
    other = TokenStore(tmp_path / "state")
    with ThreadPoolExecutor(2) as threads:
        made = list(threads.map(make, [store, other] * 8))
    assert {token.id for token in store.tokens()} == {token.id for token in made}
    assert store.tokens() == other.tokens()


# Over HTTP.


def bearer(token: NewToken) -> dict[str, str]:
    return {"Authorization": f"Bearer {token.secret}"}


@pytest.mark.anyio
async def test_tokens_over_http(running: Running, store: TokenStore) -> None:
    admin = make(store, "admin:tokens", "read:status")
    async with running(admission=Admission(tokens=store)) as client:
        client.headers.update(bearer(admin))
        asked = {"label": "a lamp", "scopes": ["read:status"], "seconds": 60}
        answer = await client.post("/v1/tokens", json=asked, headers={"Idempotency-Key": "k"})
        again = await client.post("/v1/tokens", json=asked, headers={"Idempotency-Key": "k"})
        assert answer.status_code == 201
        made = NewToken.model_validate_json(answer.content)
        assert again.content == answer.content
        assert made.expires_at is not None
        assert (await client.get("/v1/status", headers=bearer(made))).is_success

        listed = await client.get("/v1/tokens")
        tokens = Tokens.model_validate_json(listed.content).tokens
        assert [token.id for token in tokens] == [admin.id, made.id]
        assert made.secret not in listed.text

        revoked = await client.delete(f"/v1/tokens/{made.id}")
        assert revoked.is_success
        assert (await client.get("/v1/status", headers=bearer(made))).status_code == 401
        assert (await client.delete("/v1/tokens/000000000000")).json()["code"] == "not_found"
        assert (await client.delete("/v1/tokens/x")).status_code == 422


@pytest.mark.anyio
async def test_token_allows_no_more_and_lasts_no_longer_than_its_maker_s(
    running: Running, store: TokenStore
) -> None:
    admin = make(store, "admin:tokens", "read:status", lifetime=100.0)
    async with running(admission=Admission(tokens=store)) as client:
        client.headers.update(bearer(admin))

        async def ask(seconds: int | None, *scopes: str) -> httpx.Response:
            body = {"label": "more", "scopes": scopes, "seconds": seconds}
            return await client.post("/v1/tokens", json=body)

        refused = await ask(50, "read:status", "classify")
        assert refused.status_code == 403
        assert "the scope classify" in refused.json()["detail"]
        for seconds in (None, 101):
            assert (await ask(seconds, "read:status")).json()["code"] == "forbidden"
        assert (await ask(50, "read:status", "admin:tokens")).status_code == 201
        for scopes in ((), ("everything",)):
            assert (await ask(50, *scopes)).status_code == 422
        assert len(store.tokens()) == 2


@pytest.mark.anyio
async def test_tokens_are_not_made_where_none_are_wanted(running: Running) -> None:
    async with running() as client:
        for answer in (
            await client.get("/v1/tokens"),
            await client.post("/v1/tokens", json={"label": "x", "scopes": list(SCOPES)}),
            await client.delete("/v1/tokens/000000000000"),
        ):
            assert answer.json()["code"] == "not_enabled"


# From a terminal.


def run(*arguments: str | Path) -> str:
    result = runner.invoke(app, ["token", *map(str, arguments)])
    assert result.exit_code == 0, result.output
    return result.stdout


def test_tokens_from_a_terminal(tmp_path: Path) -> None:
    where = ("--state-dir", tmp_path / "state")
    assert "no tokens" in run("list", *where)
    secret = run(
        "create", "--label", "lamp", "--scope", "classify", "--scope", "metrics", *where
    ).strip()
    run("create", "--label", "guest", "--scope", "read:status", "--days", "0.5", *where)
    store = TokenStore(tmp_path / "state")
    caller = who(store, secret)
    assert caller.label == "lamp"
    assert caller.scopes == {"classify", "metrics"}
    listed = run("list", *where)
    assert "lamp" in listed
    assert "classify metrics" in listed
    assert "never used" in listed
    assert secret not in listed
    assert len(Tokens.model_validate_json(run("list", "--json", *where)).tokens) == 2
    assert run("revoke", caller.id, *where) == f"revoked {caller.id}\n"
    turn_away(store, secret)
    assert "revoked " in run("list", *where)
    noted = [each["action"] for each in events(tmp_path / "state", "command")]
    assert noted == ["token create", "token create", "token revoke"]
    assert secret not in str(records(tmp_path / "state"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["create", "--label", "x", "--scope", "everything"],
            "--scope 'everything': there is no such scope: use read:status, ",
        ),
        (["create", "--label", "", "--scope", "classify"], "--label: "),
        (["create", "--label", "x", "--scope", "classify", "--days", "0"], "--days: "),
        (["revoke", "nothing"], "there is no token of this id"),
    ],
)
def test_mistake_ends_with_one_line(tmp_path: Path, arguments: list[str], message: str) -> None:
    result = runner.invoke(app, ["token", *arguments, "--state-dir", str(tmp_path)])
    assert result.exit_code == (1 if arguments[0] == "revoke" else 2)
    assert message in result.stderr
    assert result.stderr.count("\n") == 1


def test_damage_is_told_in_the_terminal_beside_the_answer(tmp_path: Path) -> None:
    where = ("--state-dir", str(tmp_path))
    made = make(TokenStore(tmp_path))
    (tmp_path / "tokens.json").write_bytes(b"")
    result = runner.invoke(app, ["token", "list", "--json", *where])
    assert [token.id for token in Tokens.model_validate_json(result.stdout).tokens] == [made.id]
    assert result.stderr == (
        "tokens.json is damaged: its other copy is used, and it was put right\n"
    )


def test_token_whose_entry_cannot_be_written_is_not_given(tmp_path: Path) -> None:
    (tmp_path / FOLDER).touch()
    options = ("--label", "x", "--scope", "classify", "--state-dir", str(tmp_path))
    result = runner.invoke(app, ["token", "create", *options])
    assert result.exit_code == 1
    assert "log cannot be read (Not a directory): move it away" in result.stderr
    assert "vc_" not in result.output
