"""Pairing over the API: offers, claims, who may make them, and what stands in the log."""

from __future__ import annotations

import threading
from collections.abc import Awaitable, Callable, Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import anyio
import httpx
import pytest
from tests.unit.server.api.conftest import bearer
from tests.unit.server.logs import events, open_log
from tests.unit.server.security.conftest import Clock

from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.base import UNAUTHORIZED_HINT, Problem
from veilcam_client.wire.pairing import OFFER_SECONDS, PairingLine, PairingOffer
from veilcam_client.wire.tokens import ROLES
from veilcam_server.sealing.receivers import Pairing
from veilcam_server.security.admission import Admission
from veilcam_server.security.limits import RateLimit
from veilcam_server.security.pairing import PairingOffers
from veilcam_server.security.site import Site
from veilcam_server.security.tokens import TokenStore
from veilcam_server.system.state_file import StateStore

if TYPE_CHECKING:
    from tests.unit.server.conftest import Bench, Running

pytestmark = pytest.mark.anyio

OFFER, CLAIM = "/v1/pairing", "/v1/pairing/claim"
WRONG = "00" * 16


class Door:
    """A daemon's offers, with a clock that a test sets, and the requests of its callers."""

    def __init__(self, bench: Bench, tmp_path: Path) -> None:
        self.now = Clock()
        self.store: TokenStore | None = TokenStore(tmp_path / "state", monotonic=self.now)
        self.owner = bearer(self.store, *ROLES["owner"])
        self.bench, self.state = bench, tmp_path / "state"
        self.log = open_log(bench.state_dir)

    def admission(self, certificate: bytes | None = None, **other: Any) -> Admission:
        offers = PairingOffers(self.state, self.store, certificate, now=self.now)
        return Admission(tokens=self.store, log=self.log, offers=offers, **other)

    async def offer(self, client: httpx.AsyncClient, role: str = "operator") -> str:
        """Make an offer as its owner, and return its secret."""
        answer = await client.post(OFFER, json={"role": role}, headers=self.owner)
        assert answer.status_code == 201, answer.text
        return PairingLine.parse(answer.json()["line"]).secret.hex()


async def claim(
    client: httpx.AsyncClient, secret: str, key: ReceiverKey | None = None
) -> httpx.Response:
    public = str((key or ReceiverKey.generate()).public)
    return await client.post(CLAIM, json={"label": "laptop", "key": public, "secret": secret})


def code(answer: httpx.Response) -> tuple[int, str]:
    return answer.status_code, answer.json()["code"]


def told(answer: httpx.Response) -> dict[str, Any]:
    """An answer's problem, without what differs from one request to the next."""
    return {key: each for key, each in answer.json().items() if key != "request_id"}


@pytest.fixture
def door(bench: Bench, tmp_path: Path) -> Iterator[Door]:
    made = Door(bench, tmp_path)
    yield made
    made.log.close()


async def test_claim_pairs_a_receiver_and_gives_a_token_of_the_role(
    running: Running, door: Door
) -> None:
    key = ReceiverKey.generate()
    async with running(admission=door.admission()) as client:
        answer = await client.post(OFFER, json={"role": "viewer"}, headers=door.owner)
        offer = PairingOffer.model_validate_json(answer.content)
        line = PairingLine.parse(offer.line)
        assert (line.place, line.certificate, offer.role) == ("localhost:80", None, "viewer")
        assert 0 < (offer.expires_at - datetime.now(UTC)).total_seconds() <= OFFER_SECONDS
        assert {len(row) for row in offer.code} == {len(offer.code)}
        answer = await claim(client, line.secret.hex(), key)
        assert answer.status_code == 201
        paired = answer.json()
        assert (paired["device"], paired["role"]) == (door.bench.key.public, "viewer")
        assert door.bench.receivers.keys == (key.public,)
        headers = {"Authorization": f"Bearer {paired['token']}"}
        session = (await client.get("/v1/session", headers=headers)).json()
        assert (session["label"], set(session["scopes"])) == ("laptop", set(ROLES["viewer"]))
    made, claimed = events(door.bench.state_dir, "request")
    assert (made["action"], made["role"]) == ("POST /v1/pairing", "viewer")
    assert (claimed["receiver"], claimed["named"]) == (key.public.id, "laptop")
    assert claimed["token"] in paired["token"]
    written = b"".join(path.read_bytes() for path in door.state.rglob("*") if path.is_file())
    for secret in (line.secret.hex(), str(line).partition("#")[2], paired["token"][16:]):
        assert secret.encode() not in written


async def _used(door: Door, client: httpx.AsyncClient) -> str:
    secret = await door.offer(client)
    assert (await claim(client, secret)).status_code == 201
    return secret


async def _expired(door: Door, client: httpx.AsyncClient) -> str:
    secret = await door.offer(client)
    door.now.now += OFFER_SECONDS
    return secret


async def _replaced(door: Door, client: httpx.AsyncClient) -> str:
    secret = await door.offer(client)
    PairingOffers(door.state).make("localhost:80", "viewer")  # by 'veilcamd pair'
    return secret


async def _guessed(door: Door, client: httpx.AsyncClient) -> str:
    secret = await door.offer(client)
    for _ in range(3):
        assert code(await claim(client, WRONG)) == (401, "unauthorized")
    return secret


async def _revoked(door: Door, client: httpx.AsyncClient) -> str:
    secret = await door.offer(client)
    assert door.store is not None
    (owner,) = door.store.tokens()
    door.store.revoke(owner.id)
    return secret


@pytest.mark.parametrize("end", [_used, _expired, _replaced, _guessed, _revoked])
async def test_offer_that_ended_pairs_nobody_and_is_answered_as_none(
    end: Callable[[Door, httpx.AsyncClient], Awaitable[str]], running: Running, door: Door
) -> None:
    async with running(admission=door.admission()) as client:
        none = await claim(client, WRONG)
        secret = await end(door, client)
        paired = len(door.bench.receivers.keys)
        answer = await claim(client, secret)
        assert code(answer) == (401, "unauthorized")
        assert told(answer) == told(none)
        # A claim goes without a token: nobody is advised to give one.
        assert UNAUTHORIZED_HINT not in str(Problem.model_validate_json(answer.content).error())
        assert answer.headers.keys() == none.headers.keys()
        assert len(door.bench.receivers.keys) == paired
    ended = [each.get("offer") for each in events(door.bench.state_dir, "refused")]
    assert ended.count("ended") == (end is _guessed)
    assert len(ended) == 5 if end is _guessed else 2


async def test_offer_ends_with_the_daemon(running: Running, door: Door) -> None:
    async with running(admission=door.admission()) as client:
        secret = await door.offer(client)
    async with running(admission=door.admission()) as client:
        assert code(await claim(client, secret)) == (401, "unauthorized")


async def test_two_claims_at_once_pair_one(
    running: Running, door: Door, monkeypatch: pytest.MonkeyPatch
) -> None:
    both, pair = threading.Barrier(2), Pairing.pair
    claimed = PairingOffers.claimed

    def together(*given: Any) -> Any:
        both.wait(10)
        return claimed(*given)

    def slowly(*given: Any) -> Any:
        made = pair(*given)
        threading.Event().wait(0.05)
        return made

    monkeypatch.setattr(PairingOffers, "claimed", together)
    monkeypatch.setattr(Pairing, "pair", slowly)
    async with running(admission=door.admission()) as client:
        secret = await door.offer(client)
        answers: list[int] = []

        async def one() -> None:
            answers.append((await claim(client, secret)).status_code)

        async with anyio.create_task_group() as group:
            group.start_soon(one)
            group.start_soon(one)
    assert sorted(answers) == [201, 401]
    assert len(door.bench.receivers.keys) == 1


async def test_offer_stays_open_where_its_claim_cannot_be_done(
    running: Running, door: Door, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert door.store is not None
    key = ReceiverKey.generate()
    door.bench.receivers.add("before", key.public)
    async with running(admission=door.admission()) as client:
        secret = await door.offer(client)
        assert code(await claim(client, secret, key)) == (409, "conflict")
        with monkeypatch.context() as patch:
            room, write = iter(["receivers.json.lock"]), StateStore[Any]._write_beside

            def full(store: StateStore[Any], content: bytes) -> None:
                # There is room for one more record, and none to take it back.
                if store._lock.name != next(room, None):
                    raise OSError(28, "No space left on device")
                write(store, content)

            patch.setattr(StateStore, "_write_beside", full)
            assert code(await claim(client, secret)) == (503, "storage_failed")
        assert door.bench.receivers.keys == (key.public,)
        assert (await claim(client, secret)).status_code == 201


async def test_offer_gives_no_more_than_its_maker_has(running: Running, door: Door) -> None:
    assert door.store is not None
    operator = bearer(door.store, *ROLES["operator"])
    admin = bearer(door.store, "admin:receivers", "read:status", "classify")
    short = door.store.create("short", ROLES["owner"], 600.0)
    async with running(admission=door.admission()) as client:
        # Who makes no tokens makes none by pairing, either.
        asked = ((operator, "viewer"), (admin, "viewer"), (admin, "operator"), (admin, "owner"))
        for who, role in asked:
            refused = await client.post(OFFER, json={"role": role}, headers=who)
            assert code(refused) == (403, "forbidden")
        assert "ask for one of the role owner" in refused.json()["detail"]
        door.owner = {"Authorization": f"Bearer {short.secret}"}
        await claim(client, await door.offer(client))
    made = door.store.tokens()[-1]
    assert (made.role, made.expires_at) == ("operator", short.expires_at)


async def test_claims_count_against_their_address_before_they_are_looked_at(
    running: Running, door: Door
) -> None:
    async with running(admission=door.admission(rate=RateLimit(0.01, 4))) as client:
        secret = await door.offer(client)
        answers = [await claim(client, each) for each in (WRONG, WRONG, "11" * 16, WRONG, secret)]
        assert [each.status_code for each in answers] == [401, 401, 401, 401, 429]
    assert len(events(door.bench.state_dir, "refused")) == 4


@pytest.mark.parametrize(
    ("certificate", "url"),
    [
        (None, "http://localhost:8787"),
        (None, "http://[::1]:8787"),
        (bytes(range(32)), "https://127.0.0.1:8443"),
    ],
)
async def test_line_leads_to_where_the_request_came(
    certificate: bytes | None, url: str, running: Running, door: Door
) -> None:
    async with running(admission=door.admission(certificate)) as client:
        answer = await client.post(f"{url}{OFFER}", json={}, headers=door.owner)
        line = PairingLine.parse(answer.json()["line"])
        assert (line.url, line.certificate) == (url, certificate)


async def test_no_line_leads_over_plain_http_to_another_machine(
    running: Running, door: Door
) -> None:
    admission = door.admission(site=Site(hosts=("camera.example",)))
    async with running(admission=admission) as client:
        for url, headers in (
            ("http://camera.example", {}),
            ("https://camera.example", {}),
            ("http://localhost", {"Origin": "https://camera.example"}),
        ):
            answer = await client.post(f"{url}{OFFER}", json={}, headers={**door.owner, **headers})
            assert code(answer) == (409, "conflict")
            assert "use 'veilcam receiver add'" in answer.json()["detail"]


async def test_pairing_needs_no_token_where_none_is_wanted(running: Running, door: Door) -> None:
    door.store, door.owner = None, {}
    async with running(admission=door.admission()) as client:
        paired = (await claim(client, await door.offer(client))).json()
    assert (paired["role"], paired["token"]) == ("operator", None)


async def test_camera_that_releases_nothing_pairs_nobody(running: Running, door: Door) -> None:
    async with running(admission=Admission(tokens=door.store)) as client:
        offered = await client.post(OFFER, json={}, headers=door.owner)
        for answer in (offered, await claim(client, WRONG)):
            assert code(answer) == (409, "not_enabled")


async def test_claim_that_cannot_be_read_tells_of_no_offer(running: Running, door: Door) -> None:
    wrong = {"label": "laptop", "key": "veilcam-receiver:AAAA", "secret": WRONG}
    async with running(admission=door.admission()) as client:
        before = [code(await client.post(CLAIM, json=each)) for each in (wrong, {})]
        await door.offer(client)
        after = [code(await client.post(CLAIM, json=each)) for each in (wrong, {})]
    assert before == after == [(422, "invalid_request")] * 2
