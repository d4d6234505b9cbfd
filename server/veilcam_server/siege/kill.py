"""Row of the killed daemon: SIGKILL at random moments, and what it had acknowledged before."""

from __future__ import annotations

import asyncio
import hashlib
import random
import uuid
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TypeAlias

from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE
from veilcam_client.wire.rotation import EveryCaptures
from veilcam_server.security.audit import DONE as DONE_LOG
from veilcam_server.security.audit import read_audit
from veilcam_server.settings import Settings
from veilcam_server.siege.client import Address, Reply, ask, listening
from veilcam_server.siege.daemon import Daemon
from veilcam_server.siege.ground import (
    Ground,
    Judgement,
    make_tokens,
    tokens_of,
    write_small_bundle,
)

ADVANCE, KEY, DONE = "/v1/rotation/advance", "Idempotency-Key", "done_before_restart"
CALIBRATED, REVOKED = 0.25, 0.5
"""Share of lives that are calibrated, and of tokens that are revoked."""
LONGEST = 0.6
"""A daemon is killed within so long after it listens [s]."""


@dataclass
class Ledger:
    """What a daemon acknowledged, over all its lives.

    Attributes:
        policy: rotation policies that may hold: the one acknowledged last, and one under way.
        active: digests of the bundles that may be active, in the same way.
        valid: ids of tokens that were made, and whose end was not asked for.
        revoked: ids of those that were ended.
        key: idempotency key of the last work that was acknowledged.
        installed: whether a bundle is there, by its digest; None while nobody can tell.
        noted: ids of requests that changed something, which the audit log must name.
        epochs: how often each name of an epoch was told of.
        lost: what an acknowledgement promised, and the next life did not keep.
    """

    policy: list[object]
    active: list[object]
    valid: set[str] = field(default_factory=set)
    revoked: set[str] = field(default_factory=set)
    key: str | None = None
    installed: dict[str, bool | None] = field(default_factory=dict)
    noted: set[str] = field(default_factory=set)
    epochs: Counter[str] = field(default_factory=Counter)
    lost: list[str] = field(default_factory=list)

    async def compare(self, address: Address, audit: Path) -> None:
        """Compare what was acknowledged with a new life, and with the audit log."""
        rotation = (await ask(address, "GET", "/v1/rotation")).json()
        bundles = (await ask(address, "GET", "/v1/bundles")).json()["bundles"]
        tokens = await tokens_of(address)
        active = [each["digest"] for each in bundles if each["active"]]
        valid = {token for token, is_valid in tokens.items() if is_valid}
        self.epochs[rotation["epoch"]] += 1
        self._keep("policy", rotation["policy"] in self.policy)
        self._keep("bundle", active[0] in self.active)
        there = {each["digest"] for each in bundles if each["bundle"] is not None}
        for digest, known in self.installed.items():
            self._keep("upload", known in (None, digest in there))
            self.installed[digest] = digest in there
        self._keep("token", self.valid <= valid)
        self._keep("revocation", not self.revoked & valid)
        self._keep("audit line", self.noted <= {each.get("request") for each in read_audit(audit)})
        if self.key is not None:
            repeated = await ask(address, "POST", ADVANCE, headers={KEY: self.key})
            known = repeated.status == 409 and repeated.json()["code"] == DONE
            self._keep("idempotency key", known)
        # What was under way when it was killed either holds now, or never will.
        self.policy, self.active = [rotation["policy"]], [active[0]]

    def note(self, reply: Reply) -> Reply:
        """Take down the request of an answer that acknowledges a change."""
        if 200 <= reply.status < 300:
            self.noted.add(reply.headers.get("x-request-id", ""))
        return reply

    def _keep(self, what: str, kept: bool) -> None:
        if not kept:
            self.lost.append(what)


Work: TypeAlias = Callable[[Address, Ledger], Awaitable[None]]


async def killed(ground: Ground, judgement: Judgement) -> None:
    """Kill a daemon while it changes masks, bundles, tokens and its policy."""
    settings = ground.settings("killed")
    [token] = make_tokens(settings, ("owner",))
    kills = ground.extent.kills
    with ground.start(settings, token) as daemon:
        digests = await _install(daemon.address, settings)
        policy = (await ask(daemon.address, "GET", "/v1/rotation")).json()["policy"]
    ledger = Ledger([policy], [digests[0]])
    for life in range(kills + 1):
        ground.advance(life / (kills + 1))
        with ground.start(settings, token) as daemon:
            await ledger.compare(daemon.address, settings.state_dir / DONE_LOG)
            if life < kills:
                await _live(daemon, ledger, settings, digests)
    again = sum(count - 1 for count in ledger.epochs.values())
    judgement.figures["kills"] = kills
    beside = ", ".join(f"{what} {times} x" for what, times in Counter(ledger.lost).items())
    judgement.at_most(
        f"acknowledged and lost in {kills} kills",
        len(ledger.lost),
        0,
        beside=beside,
        figure="kills_lost",
    )
    judgement.at_most(f"again of {len(ledger.epochs)} epochs", again, 0, figure="epochs_repeated")


async def _install(address: Address, settings: Settings) -> list[str]:
    """Return the digests of the configured bundle, and of another that is installed."""
    content = write_small_bundle(settings.bundle.with_name("second.veilcam"), "second").read_bytes()
    upload = {"Content-Type": BUNDLE_MEDIA_TYPE}
    await ask(address, "POST", "/v1/bundles", body=content, headers=upload)
    bundles = (await ask(address, "GET", "/v1/bundles")).json()["bundles"]
    return [each["digest"] for each in sorted(bundles, key=lambda each: not each["configured"])]


async def _live(daemon: Daemon, ledger: Ledger, settings: Settings, digests: list[str]) -> None:
    """Change everything at once until the daemon is killed at a random moment."""
    address = daemon.address
    third = write_small_bundle(settings.bundle.with_name("third.veilcam"), "a third").read_bytes()
    async with listening(address) as stream:
        works = [
            asyncio.create_task(_repeat(work, address, ledger))
            for work in (
                *(_set_policy, partial(_activate, digests), _make_token, _change_mask),
                *(partial(_upload, third), partial(_make_token_by_hand, settings)),
            )
        ]
        if random.random() < CALIBRATED:  # noqa: S311 - no secret
            works.append(asyncio.create_task(_repeat(_calibrate, address, ledger)))
        await asyncio.sleep(random.uniform(0.0, LONGEST))  # noqa: S311
        daemon.kill()
        for work in works:
            work.cancel()
        await asyncio.wait(works)
    ledger.epochs.update(stream.masks)


async def _repeat(work: Work, address: Address, ledger: Ledger) -> None:
    while True:
        await work(address, ledger)
        await asyncio.sleep(0.01)


async def _set_policy(address: Address, ledger: Ledger) -> None:
    policy = EveryCaptures(captures=random.randint(1, 1000)).model_dump()  # noqa: S311
    ledger.policy.append(policy)
    reply = ledger.note(await ask(address, "PUT", "/v1/rotation", body=policy))
    if reply.status == 200:
        ledger.policy = [policy]


async def _activate(digests: list[str], address: Address, ledger: Ledger) -> None:
    digest = random.choice(digests)  # noqa: S311
    ledger.active.append(digest)
    reply = ledger.note(await ask(address, "POST", f"/v1/bundles/{digest}/activate"))
    if reply.status == 200:
        ledger.active = [digest]


async def _make_token(address: Address, ledger: Ledger) -> None:
    question = {"label": "lamp", "scopes": ["classify"]}
    made = ledger.note(await ask(address, "POST", "/v1/tokens", body=question))
    if made.status != 201:
        return
    name = made.json()["id"]
    ledger.valid.add(name)
    if random.random() < REVOKED:  # noqa: S311
        ledger.valid.remove(name)
        reply = ledger.note(await ask(address, "DELETE", f"/v1/tokens/{name}"))
        if reply.status == 200:
            ledger.revoked.add(name)


async def _make_token_by_hand(settings: Settings, _: Address, ledger: Ledger) -> None:
    """As ``veilcamd token create`` does beside the daemon."""
    [secret] = await asyncio.to_thread(make_tokens, settings, ("by hand",), ("classify",))
    ledger.valid.add(secret.split("_")[1])


async def _upload(content: bytes, address: Address, ledger: Ledger) -> None:
    """Install a bundle, or remove it."""
    digest = hashlib.sha256(content).hexdigest()
    there = ledger.installed.get(digest, False)
    ledger.installed[digest] = None
    if there:
        reply = await ask(address, "DELETE", f"/v1/bundles/{digest}")
    else:
        upload = {"Content-Type": BUNDLE_MEDIA_TYPE}
        reply = await ask(address, "POST", "/v1/bundles", body=content, headers=upload)
    if ledger.note(reply).status in (200, 201):
        ledger.installed[digest] = not there


async def _change_mask(address: Address, ledger: Ledger) -> None:
    key = str(uuid.uuid4())
    if (await ask(address, "POST", ADVANCE, headers={KEY: key})).status == 200:
        ledger.key = key


async def _calibrate(address: Address, _: Ledger) -> None:
    await ask(address, "POST", "/v1/calibration")
