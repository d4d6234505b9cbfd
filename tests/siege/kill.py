"""Row of the killed daemon: SIGKILL at random moments, and acknowledgements from before.

Of every four lives one begins with a state directory that was put back from an earlier copy, and
another has a twin beside it on a copy of the same: what they seal must be new all the same.
"""

from __future__ import annotations

import asyncio
import hashlib
import math
import random
import shutil
import uuid
from collections import Counter
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass

from tests.siege.client import Address, Reply, listening
from tests.siege.ground import Ground, Judgement, busy, make_tokens, pair, second_bundle
from tests.siege.ledger import ADVANCE, Ledger
from tests.siege.witness import Life, Witness

from veilcam_client.keys.receivers import Receiver, ReceiverKey
from veilcam_client.wire.base import RUN_HEADER
from veilcam_client.wire.captures import Capture
from veilcam_client.wire.rotation import EveryCaptures
from veilcam_server.settings import Settings

CALIBRATED, REVOKED, LABELLED = 0.25, 0.5, 0.5
"""Shares of lives with a calibration, of tokens that are revoked, of embeddings with a label."""
LONGEST = 0.6  # [s]
ROUND, COPIED, RESTORED, CLONED = 4, 0, 1, 2
"""Length of a round of lives, and the lives whose state is copied, put back, or cloned."""
GUESTS = 3


@dataclass
class Lineage:
    settings: Settings
    ledger: Ledger

    def copied(self, name: str) -> Lineage:
        state = self.settings.state_dir.parent.with_name(name) / self.settings.state_dir.name
        shutil.rmtree(state.parent, ignore_errors=True)
        shutil.copytree(self.settings.state_dir, state)
        settings = self.settings.model_copy(update={"state_dir": state})
        return Lineage(settings, self.ledger.copied())

    def put_back(self, earlier: Lineage) -> None:
        shutil.rmtree(self.settings.state_dir)
        shutil.copytree(earlier.settings.state_dir, self.settings.state_dir)
        self.ledger = earlier.ledger.copied()


@dataclass(frozen=True)
class Changes:
    """Changes to one daemon; ``third`` is a bundle that comes and goes, as ``guests`` do."""

    digests: Sequence[str]
    third: bytes
    guests: Sequence[Receiver]
    address: Address
    lineage: Lineage
    life: Life

    @property
    def ledger(self) -> Ledger:
        return self.lineage.ledger

    async def ask(self, method: str, path: str, body: object = None) -> Reply:
        return self.ledger.note(await self.address.ask(method, path, body))

    async def set_policy(self) -> None:
        policy = EveryCaptures(captures=random.randint(1, 1000)).model_dump()
        self.ledger.policy.append(policy)
        if (await self.ask("PUT", "/v1/rotation", policy)).status == 200:
            self.ledger.policy = [policy]

    async def activate(self) -> None:
        digest = random.choice(self.digests)
        self.ledger.active.append(digest)
        if (await self.ask("POST", f"/v1/bundles/{digest}/activate")).status == 200:
            self.ledger.active = [digest]

    async def make_token(self) -> None:
        question = {"label": "lamp", "scopes": ["classify"]}
        made = await self.ask("POST", "/v1/tokens", question)
        if made.status != 201:
            return
        name = made.json()["id"]
        self.ledger.valid.add(name)
        if random.random() < REVOKED:
            self.ledger.valid.remove(name)
            if (await self.ask("DELETE", f"/v1/tokens/{name}")).status == 200:
                self.ledger.revoked.add(name)

    async def make_token_by_hand(self) -> None:
        settings = self.lineage.settings
        making = asyncio.to_thread(make_tokens, settings, ("by hand",), ("classify",))
        task = asyncio.create_task(making)
        try:
            [secret] = await asyncio.shield(task)
        finally:
            # A thread goes on after it was called off, and would write where the next life copies.
            await asyncio.wait([task])
        self.ledger.valid.add(secret.split("_")[1])

    async def upload(self) -> None:
        digest = hashlib.sha256(self.third).hexdigest()
        there = self.ledger.installed.get(digest, False)
        self.ledger.installed[digest] = None
        if there:
            reply = await self.ask("DELETE", f"/v1/bundles/{digest}")
        else:
            reply = self.ledger.note(await self.address.upload(self.third))
        if reply.status in (200, 201):
            self.ledger.installed[digest] = not there

    async def pair(self) -> None:
        guest = random.choice(self.guests)
        there = self.ledger.paired.get(guest.id, False)
        self.ledger.paired[guest.id] = None
        if there:
            reply = await self.ask("DELETE", f"/v1/receivers/{guest.id}")
        else:
            reply = self.ledger.note(await pair(self.address, "guest", guest))
        if reply.status in (201, 204):
            self.ledger.paired[guest.id] = not there

    async def change_mask(self) -> None:
        key = {"Idempotency-Key": str(uuid.uuid4())}
        reply = await self.address.ask("POST", ADVANCE, headers=key)
        if reply.status == 200:
            self.ledger.key = {**key, RUN_HEADER: reply.headers.get(RUN_HEADER, "unknown")}

    async def capture(self) -> None:
        if random.random() < LABELLED:
            question = {"include_embedding": True}
            reply = await self.address.ask("POST", "/v1/classifications", question)
        else:
            reply = await self.address.ask("POST", "/v1/captures")
        if reply.status == 200:
            self.life.taken.append(Capture.model_validate_json(reply.body))

    async def calibrate(self) -> None:
        await self.address.ask("POST", "/v1/calibration")


async def killed(ground: Ground, judgement: Judgement) -> None:
    # Without noise, what was measured behind one mask tells it from another.
    settings = ground.settings("killed", snr_db=math.inf)
    [token] = make_tokens(settings, ("owner",))
    archive = ReceiverKey.generate()
    with ground.start(settings, token) as daemon:
        await daemon.address.upload(second_bundle(settings))
        bundles = (await daemon.address.get("bundles"))["bundles"]
        await pair(daemon.address, "archive", archive.public)
        policy = (await daemon.address.get("rotation"))["policy"]
    [configured] = [each["digest"] for each in bundles if each["configured"]]
    digests, third = [each["digest"] for each in bundles], second_bundle(settings, "a third")
    guests = [ReceiverKey.generate().public for _ in range(GUESTS)]
    ledger = Ledger([policy], [configured], paired={archive.public.id: True})
    lineage = earlier = Lineage(settings, ledger)
    witness, kills, copies = Witness(archive), ground.extent.kills, Counter[int]()

    async def live(lineage: Lineage, *, last: bool) -> Life:
        life, settings = Life(), lineage.settings
        with ExitStack() as stack:
            # A start takes seconds, in which the questions to a twin go on.
            daemon = await asyncio.to_thread(stack.enter_context, ground.start(settings, token))
            await lineage.ledger.compare(daemon.address, settings.state_dir, life)
            if last:
                return life
            async with listening(daemon.address) as stream:
                does = Changes(digests, third, guests, daemon.address, lineage, life)
                works = [does.set_policy, does.activate, does.make_token, does.make_token_by_hand]
                works += [does.upload, does.pair, does.change_mask, does.capture]
                works += [does.calibrate] if random.random() < CALIBRATED else []
                async with busy(works):
                    await asyncio.sleep(random.uniform(0.0, LONGEST))
                    daemon.kill()
        life.told += stream.masks
        return life

    for number in range(kills + 1):
        copies[number % ROUND] += 1
        lineages = [lineage]
        if number % ROUND == COPIED:
            earlier = lineage.copied("earlier")
        elif number % ROUND == RESTORED:
            lineage.put_back(earlier)
        elif number % ROUND == CLONED:
            lineages.append(lineage.copied("clone"))
        for life in await asyncio.gather(*(live(each, last=number == kills) for each in lineages)):
            witness.see(life)
    judgement.figures["kills"] = kills
    said = f"{kills} kills, {copies[RESTORED]} restored and {copies[CLONED]} cloned"
    judgement.none(f"acknowledged and lost in {said}", ledger.lost, "kills_lost")
    judgement.none(f"again of {len(witness.names)} epochs", witness.repeated, "epochs_repeated")
    judgement.none(f"mixed of {witness.opened} embeddings opened", witness.mixed)
    judgement.none("not opened", witness.unopened)
    judgement.at_least("embeddings opened", witness.opened, 1)
