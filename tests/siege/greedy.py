"""Row of the greedy: callers who race for more embeddings behind one mask than may leave."""

from __future__ import annotations

import asyncio
import math
import random
from collections import Counter
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np
from tests.siege.client import Address, Reply
from tests.siege.ground import UNHINDERED, Ground, Judgement, busy, make_tokens, second_bundle
from tests.siege.samples import PAIRS, fresh_bundle, written

from veilcam_client.wire.captures import Capture
from veilcam_client.wire.rotation import EveryCaptures, EverySeconds
from veilcam_server.settings import Settings

RAW = 4
RACERS = 4
EACH, LIFE, MOST_LIVES = 6, 3.0, 30
"""Most embeddings of a daemon's life, its longest time [s], and lives until all masks are spent."""


@dataclass
class Loot:
    epochs: Counter[str] = field(default_factory=Counter)
    masks: Counter[bytes] = field(default_factory=Counter)
    spent: int = 0

    def take(self, reply: Reply) -> None:
        self.spent += reply.status == 409 and reply.json().get("code") == "masks_spent"
        if reply.status == 200:
            taken = Capture.model_validate_json(reply.body)
            self.epochs[taken.epoch] += 1
            self.masks[np.asarray(taken).tobytes()] += 1

    async def grows(self, more: int) -> None:
        wanted = self.epochs.total() + more
        with suppress(TimeoutError):
            async with asyncio.timeout(LIFE):
                while self.epochs.total() < wanted:
                    await asyncio.sleep(0.005)

    @property
    def most(self) -> int:
        return max((*self.masks.values(), *self.epochs.values()), default=0)


async def greedy(ground: Ground, judgement: Judgement) -> None:
    lives = max(3, int(ground.extent.seconds / 6))
    given = {"snr_db": math.inf, **UNHINDERED}
    fresh = written(ground.folder / "greedy.veilcam", fresh_bundle())
    drawn = ground.settings("greedy-drawn", bundle=fresh, release="raw", raw_budget=1, **given)
    stored = ground.settings("greedy-stored", release="raw", raw_budget=RAW, **given)
    judgement.figures["beyond_budget"] = 0.0
    for masks, settings, budget, others, most_lives in (
        ("drawn", drawn, 1, [], lives),
        ("stored", stored, RAW, [second_bundle(stored)], MOST_LIVES),
    ):
        loot = await _race(ground, settings, budget, others, most_lives)
        beside = f"{loot.epochs.total()} in all, behind {len(loot.masks)} {masks} masks"
        judgement.at_most(f"embeddings behind one {masks} mask", loot.most, budget, beside=beside)
        judgement.at_least(f"embeddings behind {masks} masks", loot.epochs.total(), 2)
        judgement.figures["beyond_budget"] += max(0, loot.most - budget)
    judgement.at_most("masks seen raw", len(loot.masks), 2 * PAIRS)
    judgement.at_least("refused, as all masks are spent", loot.spent, 1)


async def _race(
    ground: Ground, settings: Settings, budget: int, others: Sequence[bytes], lives: int
) -> Loot:
    [token], loot = make_tokens(settings, ("greedy",)), Loot()
    for life in range(lives):
        with ground.start(settings, token) as daemon:
            address = daemon.address
            for content in others:
                await address.upload(content)
            digests = [each["digest"] for each in (await address.get("bundles"))["bundles"]]
            if await _spent(address, digests, loot) or loot.most > budget:
                break
            async with busy(_works(address, digests, loot)):
                await loot.grows(random.randint(1, EACH))
                if life % 2:
                    daemon.kill()
    return loot


async def _spent(address: Address, digests: Sequence[str], loot: Loot) -> bool:
    replies = []
    for digest in digests:
        await address.ask("POST", f"/v1/bundles/{digest}/activate")
        replies.append(await address.ask("POST", "/v1/captures"))
        loot.take(replies[-1])
    return all(reply.status == 409 for reply in replies)


def _works(
    address: Address, digests: Sequence[str], loot: Loot
) -> list[Callable[[], Awaitable[None]]]:
    async def capture() -> None:
        loot.take(await address.ask("POST", "/v1/captures"))

    async def classify() -> None:
        question = {"include_embedding": True}
        loot.take(await address.ask("POST", "/v1/classifications", question))

    async def change_mask() -> None:
        await address.ask("POST", "/v1/rotation/advance")

    async def set_policy() -> None:
        policies = (EveryCaptures(captures=random.randint(1, 100)), EverySeconds(seconds=0.1))
        await address.ask("PUT", "/v1/rotation", random.choice(policies).model_dump())

    async def activate() -> None:
        await address.ask("POST", f"/v1/bundles/{random.choice(digests)}/activate")

    return [*RACERS * (capture, classify), change_mask, set_policy, activate]
