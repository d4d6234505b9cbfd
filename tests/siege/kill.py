"""Row of the killed daemon: SIGKILL at random moments, and what it had acknowledged before.

Of every four lives one begins with a state directory that was put back from an earlier copy, and
another has a twin beside it on a copy of the same: what they seal must be new all the same.
"""

from __future__ import annotations

import asyncio
import hashlib
import math
import random
import shutil
import time
import uuid
from collections import Counter
from collections.abc import Awaitable, Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from typing import TypeAlias

from tests.siege.client import Address, ask, listening
from tests.siege.ground import (
    Ground,
    Judgement,
    busy,
    make_tokens,
    pair,
    write_small_bundle,
)
from tests.siege.ledger import ADVANCE, KEY, Ledger
from tests.siege.witness import Life, Witness

from veilcam_client.keys.receivers import Receiver, ReceiverKey
from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE
from veilcam_client.wire.captures import Capture
from veilcam_client.wire.rotation import EveryCaptures
from veilcam_server.security.audit import DONE as DONE_LOG
from veilcam_server.settings import Settings

CALIBRATED, REVOKED, LABELLED = 0.25, 0.5, 0.5
"""Share of lives that are calibrated, of tokens that are revoked, of embeddings with a label."""
LONGEST = 0.6
"""A daemon is killed within so long after it listens [s]."""
ROUND, COPIED, RESTORED, CLONED = 4, 0, 1, 2
"""Of so many lives, before which the state is copied, put back from that copy, or cloned."""
GUESTS = 3
"""Receivers that come and go, beside the one that always opens."""

Change: TypeAlias = Callable[[Address, Ledger], Awaitable[None]]
MakeChanges: TypeAlias = Callable[[Settings], Sequence[Change]]


@dataclass
class Lineage:
    """A state directory, and what was acknowledged of it."""

    settings: Settings
    ledger: Ledger

    def copied(self, name: str) -> Lineage:
        """A copy of the state in another folder, and of what is known of it."""
        state = self.settings.state_dir.parent.with_name(name) / self.settings.state_dir.name
        shutil.rmtree(state.parent, ignore_errors=True)
        shutil.copytree(self.settings.state_dir, state)
        settings = self.settings.model_copy(update={"state_dir": state})
        return Lineage(settings, self.ledger.copied())

    def put_back(self, earlier: Lineage) -> None:
        """Have the state of an earlier copy again."""
        shutil.rmtree(self.settings.state_dir)
        shutil.copytree(earlier.settings.state_dir, self.settings.state_dir)
        self.ledger = earlier.ledger.copied()


async def killed(ground: Ground, judgement: Judgement) -> None:
    """Kill a daemon while it changes masks, bundles, tokens, receivers and its policy."""
    # Without noise, what was measured behind one mask tells it from another.
    settings = ground.settings("killed", snr_db=math.inf)
    [token] = make_tokens(settings, ("owner",))
    archive = ReceiverKey.generate()
    with ground.start(settings, token) as daemon:
        digests = await _install(daemon.address, settings)
        await pair(daemon.address, "archive", archive.public)
        policy = (await ask(daemon.address, "GET", "/v1/rotation")).json()["policy"]
    ledger = Ledger([policy], [digests[0]], paired={archive.public.id: True})
    guests = [ReceiverKey.generate().public for _ in range(GUESTS)]
    lineage = earlier = Lineage(settings, ledger)
    witness, kills, copies = Witness(archive), ground.extent.kills, Counter[int]()
    for number in range(kills + 1):
        ground.advance(number / (kills + 1))
        copies[number % ROUND] += 1
        lineages = [lineage]
        if number % ROUND == COPIED:
            earlier = lineage.copied("earlier")
        elif number % ROUND == RESTORED:
            lineage.put_back(earlier)
        elif number % ROUND == CLONED:
            lineages.append(lineage.copied("clone"))
        changes = partial(_changes, digests, guests)
        lives = (_live(ground, token, each, changes, killed=number < kills) for each in lineages)
        for life in await asyncio.gather(*lives):
            witness.see(life)
    judgement.figures["kills"] = kills
    said = f"{kills} kills, {copies[RESTORED]} restored and {copies[CLONED]} cloned"
    _judge(judgement, said, ledger.lost, witness)


def _judge(judgement: Judgement, said: str, lost: list[str], witness: Witness) -> None:
    for what, wrong, figure in (
        (f"acknowledged and lost in {said}", lost, "kills_lost"),
        (f"again of {len(witness.names)} epochs", witness.repeated, "epochs_repeated"),
        (f"mixed of {witness.opened} embeddings opened", witness.mixed, None),
        ("not opened", witness.unopened, None),
    ):
        beside = ", ".join(f"{each} {times} x" for each, times in Counter(wrong).items())
        judgement.at_most(what, len(wrong), 0, beside=beside, figure=figure)
    judgement.at_least("embeddings opened", witness.opened, 1)


async def _install(address: Address, settings: Settings) -> list[str]:
    """Return the digests of the configured bundle, and of another that is installed."""
    content = write_small_bundle(settings.bundle.with_name("second.veilcam"), "second").read_bytes()
    upload = {"Content-Type": BUNDLE_MEDIA_TYPE}
    await ask(address, "POST", "/v1/bundles", body=content, headers=upload)
    bundles = (await ask(address, "GET", "/v1/bundles")).json()["bundles"]
    return [each["digest"] for each in sorted(bundles, key=lambda each: not each["configured"])]


async def _live(
    ground: Ground, token: str, lineage: Lineage, changes: MakeChanges, *, killed: bool
) -> Life:
    """Start a daemon, compare it, and change everything at once until it is killed."""
    settings, ledger, life = lineage.settings, lineage.ledger, Life()
    with ExitStack() as stack:
        # A start takes seconds, in which the questions to a twin go on.
        daemon = await asyncio.to_thread(stack.enter_context, ground.start(settings, token))
        address = daemon.address
        await ledger.compare(address, settings.state_dir / DONE_LOG, life)
        if not killed:
            return life
        async with listening(address) as stream:
            works: list[Change] = [*changes(settings), partial(_capture, life)]
            async with busy(partial(work, address, ledger) for work in works):
                await asyncio.sleep(random.uniform(0.0, LONGEST))
                daemon.kill()
    life.told += stream.masks
    return life


def _changes(
    digests: Sequence[str], guests: Sequence[Receiver], settings: Settings
) -> list[Change]:
    """What is done at once; a calibration now and then."""
    third = write_small_bundle(settings.bundle.with_name("third.veilcam"), "a third").read_bytes()
    return [
        *(_set_policy, partial(_activate, digests), _make_token, _change_mask),
        *(partial(_upload, third), partial(_make_token_by_hand, settings), partial(_pair, guests)),
        *((_calibrate,) if random.random() < CALIBRATED else ()),
    ]


async def _set_policy(address: Address, ledger: Ledger) -> None:
    policy = EveryCaptures(captures=random.randint(1, 1000)).model_dump()
    ledger.policy.append(policy)
    reply = ledger.note(await ask(address, "PUT", "/v1/rotation", body=policy))
    if reply.status == 200:
        ledger.policy = [policy]


async def _activate(digests: Sequence[str], address: Address, ledger: Ledger) -> None:
    digest = random.choice(digests)
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
    if random.random() < REVOKED:
        ledger.valid.remove(name)
        reply = ledger.note(await ask(address, "DELETE", f"/v1/tokens/{name}"))
        if reply.status == 200:
            ledger.revoked.add(name)


async def _make_token_by_hand(settings: Settings, _: Address, ledger: Ledger) -> None:
    """As ``veilcamd token create`` does beside the daemon."""
    making = asyncio.to_thread(make_tokens, settings, ("by hand",), ("classify",))
    task = asyncio.create_task(making)
    try:
        [secret] = await asyncio.shield(task)
    finally:
        # A thread goes on after it was called off, and would write where the next life copies.
        await asyncio.wait([task])
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
    key, asked = str(uuid.uuid4()), time.monotonic()
    if (await ask(address, "POST", ADVANCE, headers={KEY: key})).status == 200:
        ledger.key = key, asked


async def _pair(guests: Sequence[Receiver], address: Address, ledger: Ledger) -> None:
    """Pair a receiver, or remove it."""
    guest = random.choice(guests)
    there = ledger.paired.get(guest.id, False)
    ledger.paired[guest.id] = None
    if there:
        reply = await ask(address, "DELETE", f"/v1/receivers/{guest.id}")
    else:
        reply = await pair(address, "guest", guest)
    if ledger.note(reply).status in (201, 204):
        ledger.paired[guest.id] = not there


async def _capture(life: Life, address: Address, _: Ledger) -> None:
    """By itself, or beside a label."""
    if random.random() < LABELLED:
        question = {"include_embedding": True}
        reply = await ask(address, "POST", "/v1/classifications", body=question)
    else:
        reply = await ask(address, "POST", "/v1/captures")
    if reply.status == 200:
        life.taken.append(Capture.model_validate_json(reply.body))


async def _calibrate(address: Address, _: Ledger) -> None:
    await ask(address, "POST", "/v1/calibration")
