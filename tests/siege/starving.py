"""Rows of those who want everything for themselves: sockets, event streams, uploads, keys."""

from __future__ import annotations

import asyncio
import math
import multiprocessing
import uuid
from collections.abc import Sequence
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from typing import TypeAlias

from tests.siege.attacker import Attack, Losses, attack
from tests.siege.client import (
    ATTACKER,
    NEIGHBOUR,
    PATIENCE,
    EventStream,
    Reply,
    ask,
    head,
    listening,
)
from tests.siege.daemon import Daemon, write_certificate
from tests.siege.ground import Ground, Judgement, make_tokens, write_small_bundle

from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE

SPREAD = tuple(f"127.0.0.{host}" for host in range(3, 35))
"""Addresses of an attacker who has several."""
Asked: TypeAlias = tuple[str, str, object]
"""Method, path and body."""
OTHER_KEYS = 200
"""Idempotency keys between one and its repetition."""
DONE = "done_before_restart"
SPARE = 32
"""Event streams that may be open beyond those of honest clients."""
QUIET = 5.0
"""How long the same is measured without an attack [s]."""


@dataclass
class Service:
    """How others were served meanwhile.

    Attributes:
        neighbour: replies to ``status`` from an address that attacks nobody.
        beside: the same from the attacker's own address.
        captures: replies to captures.
        resident: the most that the daemon held in memory [MB].
    """

    neighbour: list[Reply] = field(default_factory=list)
    beside: list[Reply] = field(default_factory=list)
    captures: list[Reply] = field(default_factory=list)
    resident: float = 0.0

    @property
    def requests(self) -> int:
        """How many there were in all."""
        return len(self.neighbour) + len(self.beside) + len(self.captures)


def p99(replies: Sequence[Reply]) -> float:
    """The time that 99 of 100 were answered in [ms]; what was not answered took ``PATIENCE``."""
    took = sorted(reply.seconds if reply.status == 200 else PATIENCE for reply in replies)
    return 1000 * took[math.ceil(0.99 * len(took)) - 1]


async def measure(daemon: Daemon, tokens: Sequence[str], seconds: float) -> Service:
    """Ask as three honest clients do, with a new connection for every request."""
    service, ends = Service(), asyncio.get_running_loop().time() + seconds

    async def every(
        pause: float, replies: list[Reply], token: str, source: str, what: Asked
    ) -> None:
        method, path, body = what
        while asyncio.get_running_loop().time() < ends:
            address = daemon.address.with_token(token)
            replies.append(await ask(address, method, path, body=body, source=source))
            service.resident = max(service.resident, daemon.resident())
            await asyncio.sleep(pause)

    status: Asked = ("GET", "/v1/status", None)
    capture: Asked = ("POST", "/v1/classifications", {})
    async with asyncio.TaskGroup() as group:
        group.create_task(every(0.05, service.neighbour, tokens[0], NEIGHBOUR, status))
        group.create_task(every(0.05, service.beside, tokens[1], ATTACKER, status))
        group.create_task(every(0.25, service.captures, tokens[2], NEIGHBOUR, capture))
    return service


async def dribbling(
    ground: Ground, judgement: Judgement, *, tls: bool = False, sources: Sequence[str] = (ATTACKER,)
) -> None:
    """Thousands of sockets that begin and never finish."""
    settings = ground.settings("dribbling")
    if tls:
        certificate, key = write_certificate(settings.state_dir.parent)
        settings = settings.model_copy(update={"tls_certificate": certificate, "tls_key": key})
    tokens = make_tokens(settings, ("neighbour", "beside", "captures", "attacker"))
    extent = ground.extent
    with ground.start(settings) as daemon:
        async with ground.advancing(QUIET + extent.seconds + extent.lingering):
            began = daemon.logged()
            quiet = await measure(daemon, tokens, QUIET)
            logged, resident = daemon.logged(), quiet.resident
            line = (logged - began) / quiet.requests
            plan = Attack(
                address=daemon.address,
                sockets=extent.sockets,
                seconds=extent.seconds,
                lingering=extent.lingering,
                sources=sources,
                kinds=("headers", "body", *(("half handshake",) if tls else ()), "silent"),
                tokens=(None, tokens[3]),
            )
            losses = asyncio.create_task(asyncio.to_thread(_attacked, plan))
            under = await measure(daemon, tokens, extent.seconds)
            lost = await losses
        # Requests of honest clients are logged with or without an attack.
        per_second = (daemon.logged() - logged - line * under.requests) / extent.seconds
    _judge_service(judgement, quiet, under)
    judgement.at_most("log", per_second, 1000, " B/s", figure="siege_log_bytes_per_s")
    judgement.at_most("memory", under.resident - resident, 50, " MB", figure="siege_rss_growth_mb")
    judgement.at_most("longest life of an attacker", lost.longest, extent.lingering, " s")
    judgement.at_most(f"left of {lost.opened} sockets", lost.left, 0)


def _judge_service(judgement: Judgement, quiet: Service, under: Service) -> None:
    judgement.at_most(
        "status p99 from another address",
        p99(under.neighbour),
        250,
        " ms",
        beside=f"{p99(quiet.neighbour):.0f} ms without attack",
        figure="siege_status_p99_ms",
    )
    judgement.at_most(
        "from the attacker's",
        p99(under.beside),
        1000,
        " ms",
        beside=f"{p99(quiet.beside):.0f} ms without attack",
    )
    answered = sum(reply.status == 200 for reply in under.captures) / len(under.captures)
    judgement.at_least("captures answered", 100 * answered, 99, " %")


def _attacked(plan: Attack) -> Losses:
    """Run an attack in a process of its own, to its end."""
    context = multiprocessing.get_context("forkserver")
    hear, tell = context.Pipe(duplex=False)
    process = context.Process(target=attack, args=(plan, tell))
    process.start()
    tell.close()
    try:
        losses = hear.recv()
        assert isinstance(losses, Losses)
        return losses
    finally:
        process.kill()
        process.join()
        hear.close()


async def greed(ground: Ground, judgement: Judgement) -> None:
    """One token that opens all event streams it may, beside many clients with theirs."""
    extent = ground.extent
    # All together may have more than it takes: what is tried is what is left of it by one.
    settings = ground.settings("greed", stream_limit=extent.streams + SPARE)
    names = [f"client {number}" for number in range(extent.clients)]
    greedy, *others = make_tokens(settings, ("greedy", *names))
    with ground.start(settings) as daemon:
        async with AsyncExitStack() as stack:

            async def opened(token: str) -> EventStream:
                address = daemon.address.with_token(token)
                return await stack.enter_async_context(listening(address))

            def turns(first: int, last: int) -> list[str]:
                return [others[number % len(others)] for number in range(first, last)]

            half = extent.streams // 2
            streams = [await opened(token) for token in turns(0, half)]
            taken = [await opened(greedy) for _ in range(extent.streams)]
            streams += [await opened(token) for token in turns(half, extent.streams)]
            for stream in streams:
                stream.kinds.clear()
            heard = await asyncio.gather(*(stream.until("mask", 2) for stream in streams))
            ended = sum(stream.ended for stream in streams)
    judgement.at_least("streams of others that hear", sum(heard), extent.streams)
    judgement.at_most("ended", ended, 0)
    judgement.at_most(
        "open for the greedy token",
        sum(stream.status == 200 for stream in taken),
        extent.streams - 1,
    )


async def stalled_upload(ground: Ground, judgement: Judgement) -> None:
    """An upload that stops in the middle, and what others do with bundles meanwhile."""
    settings = ground.settings("stalled-upload")
    stalling, other = make_tokens(settings, ("stalling", "other"))
    content = write_small_bundle(settings.bundle.with_name("second.veilcam"), "second").read_bytes()
    upload = {"Content-Type": BUNDLE_MEDIA_TYPE}
    with ground.start(settings) as daemon:
        address = daemon.address.with_token(other)
        start = head(
            daemon.address.with_token(stalling),
            "POST",
            "/v1/bundles",
            {**upload, "Content-Length": "1000000"},
        )
        reader, writer = await asyncio.open_connection(address.host, address.port)
        writer.write(start + b"PK")
        await asyncio.sleep(0.5)
        installed = await ask(address, "POST", "/v1/bundles", body=content, headers=upload)
        digest = installed.json()["digest"] if installed.status == 201 else "0" * 64
        activated = await ask(address, "POST", f"/v1/bundles/{digest}/activate")
        try:
            async with asyncio.timeout(ground.extent.lingering + 10):
                await reader.read()
        except TimeoutError:
            dropped = False
        except OSError:
            dropped = True
        else:
            dropped = True
        writer.transport.abort()
    judgement.holds(f"another uploads ({installed.status})", true=installed.status == 201)
    judgement.holds(f"and activates ({activated.status})", true=activated.status == 200)
    judgement.holds("the stalled upload is dropped", true=dropped)


async def repeated_keys(ground: Ground, judgement: Judgement) -> None:
    """A key repeated after others of the same and of another caller, and after a restart."""
    settings = ground.settings("repeated-keys")
    one, two = make_tokens(settings, ("one", "two"))
    key = {"Idempotency-Key": str(uuid.uuid4())}
    # Takes milliseconds, where a capture takes a tenth of a second: keys last a minute.
    lamp = {"label": "lamp", "scopes": ["classify"]}
    others: list[int] = []

    async def capture(daemon: Daemon) -> Reply:
        address = daemon.address.with_token(one)
        return await ask(address, "POST", "/v1/classifications", body={}, headers=key)

    with ground.start(settings) as daemon:
        first = await capture(daemon)
        for number in range(OTHER_KEYS):
            ground.advance(number / OTHER_KEYS)
            address, other = daemon.address.with_token((one, two)[number % 2]), str(uuid.uuid4())
            headers = {"Idempotency-Key": other}
            made = await ask(address, "POST", "/v1/tokens", body=lamp, headers=headers)
            others.append(made.status)
        again = await capture(daemon)
    with ground.start(settings) as daemon:
        after = await capture(daemon)
    judgement.at_least("other keys that were used", others.count(201), OTHER_KEYS)
    same = first.status == again.status == 200 and first.json()["id"] == again.json()["id"]
    judgement.holds(f"the same capture after {OTHER_KEYS} other keys", true=same)
    code = after.json().get("code") if after.status == 409 else after.status
    judgement.holds(f"done_before_restart after a restart ({code})", true=code == DONE)
