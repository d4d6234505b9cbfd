"""Rows of callers who want everything for themselves: sockets, streams, uploads, keys."""

from __future__ import annotations

import asyncio
import math
import uuid
from collections.abc import Sequence
from contextlib import AsyncExitStack, ExitStack
from dataclasses import dataclass, field
from urllib.parse import urlsplit

from tests.siege.attacker import Attack, Losses, attack, head
from tests.siege.client import ATTACKER, NEIGHBOUR, PATIENCE, EventStream, Reply, listening
from tests.siege.daemon import Daemon, child, write_certificate
from tests.siege.ground import Ground, Judgement, make_tokens, second_bundle

from veilcam_client.wire.base import RUN_HEADER
from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE

SPREAD = tuple(f"127.0.0.{host}" for host in range(3, 35))
OTHER_KEYS = 200
QUIET = 5.0  # [s]


@dataclass
class Service:
    neighbour: list[Reply] = field(default_factory=list)
    beside: list[Reply] = field(default_factory=list)
    captures: list[Reply] = field(default_factory=list)
    resident: float = 0.0

    @property
    def requests(self) -> int:
        return len(self.neighbour) + len(self.beside) + len(self.captures)


def p99(replies: Sequence[Reply]) -> float:
    """Return the time of 99 of 100 answers [ms]; a request without one took ``PATIENCE``."""
    took = sorted(reply.seconds if reply.status == 200 else PATIENCE for reply in replies)
    return 1000 * took[math.ceil(0.99 * len(took)) - 1]


async def measure(daemon: Daemon, tokens: Sequence[str], seconds: float) -> Service:
    service, ends = Service(), asyncio.get_running_loop().time() + seconds

    async def client(token: str, source: str, replies: list[Reply], *, capture: bool) -> None:
        address = daemon.address.with_token(token)
        method, path = ("POST", "/v1/classifications") if capture else ("GET", "/v1/status")
        body: object = {} if capture else None
        while asyncio.get_running_loop().time() < ends:
            replies.append(await address.ask(method, path, body, source=source))
            service.resident = max(service.resident, daemon.resident())
            await asyncio.sleep(0.25 if capture else 0.05)

    async with asyncio.TaskGroup() as group:
        group.create_task(client(tokens[0], NEIGHBOUR, service.neighbour, capture=False))
        group.create_task(client(tokens[1], ATTACKER, service.beside, capture=False))
        group.create_task(client(tokens[2], NEIGHBOUR, service.captures, capture=True))
    return service


async def dribbling(
    ground: Ground, judgement: Judgement, *, tls: bool = False, sources: Sequence[str] = (ATTACKER,)
) -> None:
    extent = ground.extent
    with ExitStack() as stack:
        if tls:
            settings = ground.settings("tls")
            certificate = write_certificate(settings.state_dir.parent)
            settings = settings.model_copy(update=certificate)
            daemon = stack.enter_context(ground.start(settings))
            spoken = daemon.address.url.startswith("https://")
            judgement.holds("it speaks TLS", true=spoken)
        else:
            settings, daemon = ground.shared
        tokens = make_tokens(settings, ("neighbour", "beside", "captures", "attacker"))

        def logged() -> int:
            return daemon.log.stat().st_size

        began = logged()
        quiet = await measure(daemon, tokens, min(QUIET, extent.seconds))
        before = logged()
        plan = Attack(
            address=daemon.address,
            sockets=extent.sockets,
            seconds=extent.seconds,
            lingering=extent.lingering,
            sources=sources,
            kinds=("headers", "body", *(("half handshake",) if tls else ()), "silent"),
            tokens=(None, tokens[3]),
        )
        attacked = asyncio.create_task(asyncio.to_thread(_attacked, plan))
        under = await measure(daemon, tokens, extent.seconds)
        lost = await attacked
        # Requests of honest clients are logged with or without an attack.
        honest = under.requests * (before - began) / quiet.requests
        per_second = (logged() - before - honest) / extent.seconds
    for where, bar, one, other, figure in (
        ("another address", 250, under.neighbour, quiet.neighbour, "siege_status_p99_ms"),
        ("the attacker's", 1000, under.beside, quiet.beside, ""),
    ):
        beside, what = f"{p99(other):.0f} without attack", f"status p99 from {where} [ms]"
        judgement.at_most(what, p99(one), bar, beside=beside, figure=figure)
    answered = sum(reply.status == 200 for reply in under.captures) / len(under.captures)
    grown = under.resident - quiet.resident
    judgement.at_least("captures answered [%]", 100 * answered, 99)
    judgement.at_most("log [B/s]", per_second, 1000, figure="siege_log_bytes_per_s")
    judgement.at_most("memory [MB]", grown, 50, figure="siege_rss_growth_mb")
    judgement.at_most("longest life of an attacker [s]", lost.longest, extent.lingering)
    judgement.at_most(f"left of {lost.opened} sockets", lost.left, 0)


def _attacked(plan: Attack) -> Losses:
    with child(attack, plan) as (_, hear):
        losses: Losses = hear.recv()
        return losses


async def greed(ground: Ground, judgement: Judgement) -> None:
    extent, (settings, daemon) = ground.extent, ground.shared
    names = [f"client {number}" for number in range(extent.clients)]
    greedy, *others = make_tokens(settings, ("greedy", *names))
    async with AsyncExitStack() as stack:

        async def opened(token: str) -> EventStream:
            return await stack.enter_async_context(listening(daemon.address.with_token(token)))

        turns = [others[number % len(others)] for number in range(extent.streams)]
        half = extent.streams // 2
        streams = [await opened(token) for token in turns[:half]]
        taken = [await opened(greedy) for _ in range(extent.streams)]
        streams += [await opened(token) for token in turns[half:]]
        for stream in streams:
            stream.kinds.clear()
        heard = await asyncio.gather(*(stream.until("mask", 2) for stream in streams))
        ended = sum(stream.ended for stream in streams)
    most = sum(stream.status == 200 for stream in taken)
    judgement.at_least("streams of others that hear", sum(heard), extent.streams)
    judgement.at_most("ended", ended, 0)
    judgement.at_most("open for the greedy token", most, extent.streams - 1)


async def stalled_upload(ground: Ground, judgement: Judgement) -> None:
    settings, daemon = ground.shared
    stalling, other = make_tokens(settings, ("stalling", "other"))
    address, place = daemon.address.with_token(other), urlsplit(daemon.address.url)
    reader, writer = await asyncio.open_connection(place.hostname, place.port)
    claims = {"Content_Type": BUNDLE_MEDIA_TYPE, "Content_Length": 1_000_000}
    start = head(address.with_token(stalling), "POST", "/v1/bundles", **claims)
    writer.write(start + b"PK")
    await asyncio.sleep(0.5)
    patience = ground.extent.lingering
    installed = await address.upload(second_bundle(settings), patience)
    digest = installed.json()["digest"] if installed.status == 201 else "0" * 64
    path = f"/v1/bundles/{digest}/activate"
    activated = await address.ask("POST", path, patience=patience)
    dropped = True
    try:
        async with asyncio.timeout(patience + 10):
            await reader.read()
    except OSError as error:
        dropped = not isinstance(error, TimeoutError)
    writer.transport.abort()
    judgement.holds(f"another uploads ({installed.status})", true=installed.status == 201)
    judgement.holds(f"and activates ({activated.status})", true=activated.status == 200)
    judgement.holds("the stalled upload is dropped", true=dropped)


async def repeated_keys(ground: Ground, judgement: Judgement) -> None:
    settings = ground.settings("keys")
    one, two = make_tokens(settings, ("one", "two"))
    key = {"Idempotency-Key": str(uuid.uuid4())}
    # Takes milliseconds, where a capture takes a tenth of a second: answers are kept for a minute.
    lamp = {"label": "lamp", "scopes": ["classify"]}
    others: list[int] = []

    async def capture(daemon: Daemon) -> Reply:
        return await daemon.address.ask("POST", "/v1/classifications", {}, key)

    with ground.start(settings, one) as daemon:
        first = await capture(daemon)
        for number in range(OTHER_KEYS):
            address = daemon.address.with_token((one, two)[number % 2])
            other = {"Idempotency-Key": str(uuid.uuid4())}
            others.append((await address.ask("POST", "/v1/tokens", lamp, other)).status)
        key[RUN_HEADER] = first.headers.get(RUN_HEADER, "unknown")
        again = await capture(daemon)
    with ground.start(settings, one) as daemon:
        after = await capture(daemon)
        taken = (await daemon.address.get("status"))["captures"]
    judgement.at_least("other keys that were used", others.count(201), OTHER_KEYS)
    same = first.status == again.status == 200 and first.json()["id"] == again.json()["id"]
    judgement.holds(f"the same capture after {OTHER_KEYS} other keys", true=same)
    code = after.json().get("code") if after.status == 409 else after.status
    known = code == "answer_lost"
    judgement.holds(f"answer_lost after a restart ({code})", true=known)
    judgement.at_most("captures after a restart", taken, 0)
