"""Ground of every row: extents, daemons, clients that go on, and judgements."""

from __future__ import annotations

import asyncio
import math
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, asynccontextmanager, contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeAlias

from tests.siege.client import Address, Reply, listening
from tests.siege.daemon import Circumstances, Daemon, started
from tests.siege.samples import small_bundle, written

from veilcam_client.keys.receivers import Receiver
from veilcam_client.wire.rotation import EverySeconds
from veilcam_client.wire.tokens import SCOPES, Scope
from veilcam_server.demo_data import load_digits
from veilcam_server.devices.simulated.scenes import write_scene
from veilcam_server.security.tokens import TokenStore
from veilcam_server.settings import GivenSettings, Settings

SERVE = "veilcam_server.daemon:serve"
UNHINDERED = {"callers": 1024}
"""Settings of a daemon that meets in a second what no caller sends in an hour."""
SHOWN = 20


@dataclass(frozen=True, slots=True)
class Extent:
    sockets: int = 2000
    seconds: float = 60.0  # [s]
    lingering: float = 30.0
    """Time in which every socket that dribbles must be dropped [s]."""
    streams: int = 200
    clients: int = 64
    flips: int = 20
    starts: int = 300
    kills: int = 200
    gone: float = 60.0  # [s]
    examples: int = 6
    """Made-up requests of each kind, operation and caller."""
    more: int = 5
    """Requests of the caller with every scope, for one of another."""
    whole: bool = True
    """Whether callers of each scope send them, to daemons of each form of release, with the demo's
    bundles and with a sensor that sees nothing."""
    files: int = 10_000
    live: int = 1000
    pictures: int = 2000
    captures: int = 20_000


QUICK = Extent(
    *(300, 5.0, 30.0, 80, 20, 1, 6, 4, 3.0),
    examples=1,
    more=2,
    whole=False,
    files=150,
    live=15,
    pictures=50,
    captures=60,
)


@dataclass
class Judgement:
    """Findings of a row and its bars; ``untried`` says why this machine could not try it all."""

    found: list[str] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)
    figures: dict[str, float] = field(default_factory=dict)
    untried: str | None = None

    @property
    def outcome(self) -> Literal["passed", "failed", "untried"]:
        if self.missed:
            return "failed"
        return "passed" if self.untried is None else "untried"

    def at_most(
        self, what: str, value: float, bar: float, *, beside: str = "", figure: str = ""
    ) -> None:
        bars = f"{beside}; at most {bar:g}" if beside else f"at most {bar:g}"
        self._say(f"{what} {value:.4g} ({bars})", value <= bar)
        if figure:
            self.figures[figure] = value

    def at_least(self, what: str, value: float, bar: float) -> None:
        self._say(f"{what} {value:.4g} (at least {bar:g})", value >= bar)

    def none(self, what: str, wrong: Sequence[str], figure: str = "") -> None:
        counted = list(Counter(wrong).items())[:SHOWN]
        beside = "; ".join(f"{name} ({times} x)" if times > 1 else name for name, times in counted)
        self.at_most(what, len(wrong), 0, beside=beside, figure=figure)

    def holds(self, what: str, *, true: bool) -> None:
        self._say(what if true else f"not so: {what}", true)

    def _say(self, text: str, good: bool) -> None:
        self.found.append(text)
        if not good:
            self.missed.append(text)


@dataclass
class Ground:
    """Daemons of one siege; ``stack`` is its end, until which the shared daemon runs."""

    serve: str
    folder: Path
    extent: Extent
    stack: ExitStack

    def settings(self, name: str, **more: Any) -> Settings:
        folder = self.folder / name
        # The state and the log have a folder of their own, which a disk can be mounted on.
        (folder / "disk").mkdir(parents=True)
        scene = folder / "scene.npy"
        write_scene(scene, load_digits().images[0])
        given: dict[str, Any] = {
            "device": "simulated",
            "auth": "tokens",
            "bundle": written(folder / "bundle.veilcam", small_bundle("siege")),
            "scenes": (str(scene),),
            "port": 0,
            "state_dir": folder / "disk" / "state",
            "settle": 0.01,
            "exposure": 0.001,
            # Fast: that rotation goes on is seen at once.
            "rotation": EverySeconds(seconds=0.5),
        }
        return GivenSettings(**{**given, **more})

    @contextmanager
    def start(
        self,
        settings: Settings,
        token: str | None = None,
        around: Circumstances | None = None,
        serve: str | None = None,
    ) -> Iterator[Daemon]:
        with started(serve or self.serve, settings, around or Circumstances()) as daemon:
            daemon.address = daemon.address.with_token(token)
            yield daemon

    @cached_property
    def shared(self) -> tuple[Settings, Daemon]:
        settings = self.settings("shared")
        return settings, self.stack.enter_context(self.start(settings))


Run: TypeAlias = Callable[[Ground, Judgement], Awaitable[None]]
Work: TypeAlias = Callable[[], Awaitable[None]]


@asynccontextmanager
async def busy(works: Iterable[Work]) -> AsyncIterator[None]:
    async def repeat(work: Work) -> None:
        while True:
            await work()
            await asyncio.sleep(0.01)

    tasks = [asyncio.create_task(repeat(work)) for work in works]
    try:
        yield
    finally:
        for task in tasks:
            task.cancel()
        ended = await asyncio.gather(*tasks, return_exceptions=True)
    for error in ended:
        if isinstance(error, Exception):
            raise error


def make_tokens(
    settings: Settings, labels: Sequence[str], scopes: tuple[Scope, ...] = SCOPES
) -> list[str]:
    store = TokenStore(settings.state_dir)
    return [store.create(label, scopes, None).secret for label in labels]


def second_bundle(settings: Settings, task: str = "second") -> bytes:
    return written(settings.bundle.with_name("other.veilcam"), small_bundle(task)).read_bytes()


async def tokens_of(address: Address) -> dict[str, bool]:
    found: dict[str, bool] = {}
    page: dict[str, Any] = {"next": ""}
    while page["next"] is not None:
        page = await address.get(f"tokens?after={page['next']}" if page["next"] else "tokens")
        found |= {each["id"]: each["revoked_at"] is None for each in page["tokens"]}
    return found


async def pair(address: Address, label: str, receiver: Receiver) -> Reply:
    return await address.ask("POST", "/v1/receivers", {"label": label, "key": str(receiver)})


async def standing_still(address: Address) -> list[str]:
    still = []
    async with listening(address) as stream:
        if not await stream.until("mask", 2, 15.0):
            still.append("rotation")
        taken = await address.ask("POST", "/v1/classifications", {})
        if taken.status != 200:
            still.append(f"captures ({taken.status})")
        elif not await stream.until("capture", 1):
            still.append("events")
    return still


async def goes_on(judgement: Judgement, address: Address, when: str = "") -> None:
    still = await standing_still(address)
    judgement.holds(f"{when}every task goes on {still or ''}", true=not still)


async def epochs(address: Address, count: int) -> list[str]:
    async with listening(address) as stream:
        await stream.until("mask", count)
    return stream.masks


async def is_ready(address: Address, patience: float) -> bool:
    for _ in range(math.ceil(patience / 0.2)):
        reply = await address.ask("GET", "/v1/status")
        if reply.status == 200 and reply.json()["state"] == "ready":
            return True
        await asyncio.sleep(0.2)
    return False
