"""Row of the greedy: callers who race for more embeddings behind one mask than may leave."""

from __future__ import annotations

import asyncio
import math
import random
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from tests.siege.client import Address, Reply, ask
from tests.siege.ground import (
    PAIRS,
    Ground,
    Judgement,
    busy,
    make_tokens,
    write_small_bundle,
)

from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE
from veilcam_client.wire.captures import Capture
from veilcam_client.wire.rotation import EveryCaptures, EverySeconds
from veilcam_server.demo_data import FRESH
from veilcam_server.settings import Settings

WHITE, RAW = 1, 4
"""Budgets: embeddings that may leave behind one mask."""
RACERS = 4
"""Callers who capture, and as many who classify."""
EACH, LIFE, MOST_LIVES = 6, 3.0, 30
"""A daemon lives until so many embeddings left at most, and no longer than that [s]; stored masks
are spent after so many lives."""
CAPTURE, CLASSIFY, SPENT = "/v1/captures", "/v1/classifications", "masks_spent"
# What is tried here in a second, nobody tries in an hour.
UNHINDERED = {"rate_limit": 1e6, "rate_burst": 1_000_000, "queue_limit": 64}


@dataclass
class Loot:
    """Embeddings that left, over all lives.

    Attributes:
        epochs: how many were taken in each.
        masks: how many there are of each embedding: without noise, all of one scene behind one
            mask are the same, whatever its epoch is called.
        spent: refusals because all masks are spent.
    """

    epochs: Counter[str] = field(default_factory=Counter)
    masks: Counter[bytes] = field(default_factory=Counter)
    spent: int = 0

    def take(self, reply: Reply) -> None:
        """Keep the embedding of an answer, if there is one, with a label or without."""
        self.spent += reply.status == 409 and reply.json().get("code") == SPENT
        if reply.status == 200:
            taken = Capture.model_validate_json(reply.body)
            self.epochs[taken.epoch] += 1
            self.masks[np.asarray(taken).tobytes()] += 1

    async def grows(self, more: int) -> None:
        """Wait until it has grown by so many, or for ``LIFE``."""
        wanted = self.epochs.total() + more
        with suppress(TimeoutError):
            async with asyncio.timeout(LIFE):
                while self.epochs.total() < wanted:
                    await asyncio.sleep(0.005)

    @property
    def most(self) -> int:
        """Behind one mask."""
        return max((*self.masks.values(), *self.epochs.values()), default=0)


async def greedy(ground: Ground, judgement: Judgement) -> None:
    """Race for white embeddings of fresh masks, then for raw ones of stored masks."""
    lives = max(3, int(ground.extent.seconds / 6))
    white = _settings(ground, "greedy-white", bundle=FRESH, release="white")
    raw = _settings(ground, "greedy-raw", release="raw", raw_budget=RAW)
    loot = await _race(ground, white, WHITE, [], lives)
    _judge(judgement, "white", loot, WHITE)
    second = write_small_bundle(raw.bundle.with_name("second.veilcam"), "second").read_bytes()
    loot = await _race(ground, raw, RAW, [second], MOST_LIVES)
    _judge(judgement, "raw", loot, RAW)
    judgement.at_most("masks seen raw", len(loot.masks), 2 * PAIRS)
    judgement.at_least("refused, as all masks are spent", loot.spent, 1)


def _settings(ground: Ground, name: str, **more: Any) -> Settings:
    return ground.settings(name, snr_db=math.inf, **UNHINDERED, **more)


def _judge(judgement: Judgement, form: str, loot: Loot, budget: int) -> None:
    beside = f"{loot.epochs.total()} in all, behind {len(loot.masks)} masks"
    judgement.at_most(f"{form} embeddings behind one mask", loot.most, budget, beside=beside)
    judgement.at_least(f"{form} embeddings", loot.epochs.total(), 2)
    figures = judgement.figures
    beyond = max(0, loot.most - budget)
    figures["beyond_budget"] = figures.get("beyond_budget", 0.0) + beyond


async def _race(
    ground: Ground, settings: Settings, budget: int, others: Sequence[bytes], lives: int
) -> Loot:
    """Race in one life after the other, until nothing more leaves, or too much did."""
    [token], loot = make_tokens(settings, ("greedy",)), Loot()
    for life in range(lives):
        ground.advance(life / lives)
        with ground.start(settings, token) as daemon:
            address = daemon.address
            for content in others:
                headers = {"Content-Type": BUNDLE_MEDIA_TYPE}
                await ask(address, "POST", "/v1/bundles", body=content, headers=headers)
            bundles = (await ask(address, "GET", "/v1/bundles")).json()["bundles"]
            digests = [each["digest"] for each in bundles]
            if await _spent(address, digests, loot) or loot.most > budget:
                break
            works = [
                *(partial(work, loot, address) for work in RACERS * (_capture, _classify)),
                *(partial(work, address) for work in (_change_mask, _set_policy)),
                partial(_activate, digests, address),
            ]
            async with busy(works):
                await loot.grows(random.randint(1, EACH))
                if life % 2:
                    daemon.kill()
    return loot


async def _spent(address: Address, digests: Sequence[str], loot: Loot) -> bool:
    """Whether no bundle lets out any more."""
    replies = []
    for digest in digests:
        await ask(address, "POST", f"/v1/bundles/{digest}/activate")
        replies.append(await ask(address, "POST", CAPTURE))
        loot.take(replies[-1])
    return all(reply.status == 409 for reply in replies)


async def _capture(loot: Loot, address: Address) -> None:
    loot.take(await ask(address, "POST", CAPTURE))


async def _classify(loot: Loot, address: Address) -> None:
    question = {"include_embedding": True}
    loot.take(await ask(address, "POST", CLASSIFY, body=question))


async def _change_mask(address: Address) -> None:
    await ask(address, "POST", "/v1/rotation/advance")


async def _set_policy(address: Address) -> None:
    policies = (EveryCaptures(captures=random.randint(1, 100)), EverySeconds(seconds=0.1))
    body = random.choice(policies).model_dump()
    await ask(address, "PUT", "/v1/rotation", body=body)


async def _activate(digests: Sequence[str], address: Address) -> None:
    digest = random.choice(digests)
    await ask(address, "POST", f"/v1/bundles/{digest}/activate")
