"""The camera for oneself, for a while."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.unit.server.logs import events, open_log
from tests.unit.server.security.conftest import Clock, bearer

from veilcam_client.wire.lease import Lease as LeaseAnswer
from veilcam_client.wire.lease import NewLease
from veilcam_client.wire.tokens import Scope
from veilcam_server.errors import ProblemError
from veilcam_server.security.admission import Admission
from veilcam_server.security.limits import Lease
from veilcam_server.security.tokens import TokenStore

if TYPE_CHECKING:
    import httpx
    from tests.unit.server.conftest import Bench, Running

ALL = (
    ("POST", "/v1/captures", None),
    ("POST", "/v1/classifications", None),
    ("POST", "/v1/rotation/advance", None),
    ("PUT", "/v1/rotation", {"mode": "off"}),
)


def test_lease_ends_by_itself_and_can_be_renewed() -> None:
    clock = Clock()
    lease = Lease(clock)
    assert lease.left is None
    lease.take("a", "Ann", 10.0)
    clock.now += 9.5
    assert lease.left == pytest.approx(0.5)
    for act in (lease.require, lease.release, lambda name: lease.take(name, "Bob", 1.0)):
        with pytest.raises(ProblemError, match="'Ann' for another 1 s"):
            act("b")
    lease.take("a", "Ann", 10.0)
    clock.now += 9.5
    assert lease.held_by("a")
    assert not lease.held_by("b")
    clock.now += 0.5
    assert not lease.held_by("a")
    lease.require("b")
    lease.take("b", "Bob", 10.0)
    lease.release("b")
    lease.take("a", "Ann", 1.0)


async def ask(client: httpx.AsyncClient, headers: dict[str, str]) -> list[int]:
    answers = [
        await client.request(method, path, headers=headers, json=body) for method, path, body in ALL
    ]
    return [answer.status_code for answer in answers]


@pytest.mark.anyio
async def test_with_tokens_the_token_is_the_holder(
    running: Running, store: TokenStore, bench: Bench
) -> None:
    clock = Clock()
    scopes: tuple[Scope, ...] = ("read:status", "read:embedding", "read:embedding:raw", "classify")
    first, second = (bearer(store, *scopes, "mask:rotate") for _ in "12")
    wanted = {"owner": "an experiment", "seconds": 60}
    async with running(admission=Admission(tokens=store, lease=Lease(clock))) as client:
        assert await ask(client, second) == [200] * 4
        taken = await client.post("/v1/lease", headers=first, json=wanted)
        made = NewLease.model_validate_json(taken.content)
        assert (made.held, made.mine, made.secret) == (True, True, None)
        captures = bench.sensor.captures
        assert await ask(client, second) == [423] * 4
        assert bench.sensor.captures == captures
        assert await ask(client, first) == [200] * 4
        refused = await client.post("/v1/lease", headers=second, json=wanted)
        assert refused.json()["code"] == "leased"
        assert refused.headers["retry-after"] == "60"
        assert (await client.delete("/v1/lease", headers=second)).status_code == 423
        seen = LeaseAnswer.model_validate_json(
            (await client.get("/v1/lease", headers=second)).content
        )
        assert (seen.held, seen.owner, seen.mine) == (True, "an experiment", False)
        clock.now += 60
        assert await ask(client, second) == [200] * 4
        assert (await client.post("/v1/lease", headers=second, json=wanted)).is_success
        assert not (await client.delete("/v1/lease", headers=second)).json()["held"]
        assert await ask(client, first) == [200] * 4


@pytest.mark.anyio
async def test_administrator_ends_the_lease_of_another(
    running: Running, store: TokenStore, tmp_path: Path
) -> None:
    rotating: tuple[Scope, ...] = ("mask:rotate",)
    first, second, admin = (
        {"Authorization": "Bearer " + store.create(label, scopes, None).secret}
        for label, scopes in (
            ("first", rotating),
            ("second", rotating),
            ("admin", (*rotating, "admin:tokens")),
        )
    )
    wanted = {"owner": "an experiment", "seconds": 60}
    log = open_log(tmp_path)
    async with running(admission=Admission(tokens=store, log=log)) as client:

        async def broken(who: dict[str, str], force: str = "true") -> int:
            answer = await client.delete("/v1/lease", headers=who, params={"force": force})
            return answer.status_code

        await client.post("/v1/lease", headers=first, json=wanted)
        assert await broken(second) == 403
        assert await broken(admin, "false") == 423
        assert await broken(admin, "perhaps") == 422
        assert (await client.post("/v1/lease", headers=second, json=wanted)).status_code == 423
        assert await broken(admin) == 200
        assert await broken(admin) == 200
        assert (await client.post("/v1/lease", headers=second, json=wanted)).is_success
    log.close()
    noted = [(entry["label"], entry.get("broke")) for entry in events(tmp_path)]
    assert noted.count(("admin", "an experiment")) == 1
    assert [broke for _, broke in noted].count(None) == len(noted) - 1


@pytest.mark.anyio
async def test_without_tokens_a_secret_is_the_holder(running: Running) -> None:
    wanted = {"owner": "me", "seconds": 60}
    async with running() as client:
        made = NewLease.model_validate_json((await client.post("/v1/lease", json=wanted)).content)
        assert made.secret is not None
        mine = {"Veilcam-Lease": made.secret}
        for headers in ({}, {"Veilcam-Lease": "x"}, {"Veilcam-Lease": ""}):
            assert await ask(client, headers) == [423] * 4
            assert (await client.post("/v1/lease", json=wanted, headers=headers)).is_error
        assert await ask(client, mine) == [200] * 4
        renewed = (await client.post("/v1/lease", json=wanted, headers=mine)).json()
        assert renewed["secret"] == made.secret
        assert made.secret not in (await client.get("/v1/lease", headers=mine)).text
        assert (await client.delete("/v1/lease", headers=mine)).is_success
        assert await ask(client, {}) == [200] * 4


@pytest.mark.anyio
@pytest.mark.parametrize(
    "body",
    [
        *({"owner": "me", "seconds": wrong} for wrong in (0, 3601, "5")),
        *({"owner": wrong, "seconds": 5} for wrong in ("", "a\nb")),
        {"seconds": 5},
    ],
)
async def test_bad_lease_is_refused(running: Running, body: dict[str, object]) -> None:
    async with running() as client:
        assert (await client.post("/v1/lease", json=body)).status_code == 422
        assert not (await client.get("/v1/lease")).json()["held"]
