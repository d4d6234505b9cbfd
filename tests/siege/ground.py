"""Ground of every row: how much there is of it, daemons to try, and a judgement."""

from __future__ import annotations

import asyncio
import math
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from tests.siege.client import Address, Reply, ask, listening
from tests.siege.daemon import DISK, Circumstances, Daemon, Launcher

from veilcam_client.keys.receivers import Receiver
from veilcam_client.wire.rotation import EverySeconds
from veilcam_client.wire.tokens import SCOPES, Scope
from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Window
from veilcam_server.demo_data import load_digits
from veilcam_server.devices.simulated.scenes import write_scene
from veilcam_server.security.tokens import TokenStore
from veilcam_server.settings import GivenSettings, Settings
from veilcam_training.bundle import Bundle, Pair, write_bundle
from veilcam_training.bundle.layers import Linear

ROTATION = EverySeconds(seconds=0.5)
"""Fast: that rotation goes on is seen at once."""
LABELS = tuple("0123456789")
PAIRS = 3


@dataclass(frozen=True, slots=True)
class Extent:
    """How much of each attack there is."""

    sockets: int = 2000
    seconds: float = 60.0
    """Of an attack [s]."""
    lingering: float = 30.0
    """In which everything that dribbles must be dropped [s]."""
    streams: int = 200
    clients: int = 64
    flips: int = 20
    """Bytes flipped in each state file, one at a time."""
    starts: int = 300
    """Most starts on damaged state: a sample of all ways to damage it."""
    kills: int = 200
    gone: float = 60.0
    """How long camera and panel are unplugged [s]."""


SHORT = Extent(
    sockets=300, seconds=6.0, streams=80, clients=20, flips=1, starts=6, kills=4, gone=3.0
)
"""Shows that an attack is met; the bars are those of the long one."""


@dataclass
class Judgement:
    """What a row found, held against its bars.

    Attributes:
        found: one part of a sentence each.
        missed: those of them that missed a bar.
        figures: by name.
        untried: why the row, or the rest of it, could not be tried on this machine.
    """

    found: list[str] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)
    figures: dict[str, float] = field(default_factory=dict)
    untried: str | None = None

    @property
    def outcome(self) -> Literal["passed", "failed", "untried"]:
        """Whether a bar was missed, or none could be."""
        if self.missed:
            return "failed"
        return "passed" if self.untried is None else "untried"

    def at_most(
        self,
        what: str,
        value: float,
        bar: float,
        unit: str = "",
        *,
        beside: str = "",
        figure: str | None = None,
    ) -> None:
        """Hold a value against the most that it may be.

        Args:
            what: the value is.
            value: as it was measured.
            bar: in the same unit.
            unit: with a space in front.
            beside: what the value is compared with.
            figure: name that the value is recorded by.
        """
        bars = "; ".join((beside, f"at most {bar:g}") if beside else (f"at most {bar:g}",))
        self._say(f"{what} {value:.4g}{unit} ({bars})", value <= bar)
        if figure is not None:
            self.figures[figure] = value

    def at_least(self, what: str, value: float, bar: float, unit: str = "") -> None:
        """Hold a value against the least that it may be."""
        self._say(f"{what} {value:.4g}{unit} (at least {bar:g})", value >= bar)

    def holds(self, what: str, *, true: bool) -> None:
        """Something that must be so."""
        self._say(what if true else f"not so: {what}", true)

    def _say(self, text: str, good: bool) -> None:
        self.found.append(text)
        if not good:
            self.missed.append(text)


@dataclass(frozen=True, slots=True)
class Ground:
    """For all rows of one siege."""

    launcher: Launcher
    extent: Extent
    advance: Callable[[float], None] = lambda _: None
    """Told which share of the row is done."""

    def settings(self, name: str, **more: Any) -> Settings:
        """Settings of a simulated daemon in a new folder of this name, with tokens."""
        folder = self.launcher.fresh(name)
        (folder / DISK).mkdir()
        scene = folder / "scene.npy"
        write_scene(scene, load_digits().images[0])
        given: dict[str, Any] = {
            "device": "simulated",
            "auth": "tokens",
            "bundle": write_small_bundle(folder / "bundle.veilcam", "siege"),
            "scenes": (str(scene),),
            "port": 0,
            "state_dir": folder / DISK / "state",
            "settle": 0.01,
            "exposure": 0.001,
            "rotation": ROTATION,
            "heartbeat": 1.0,
        }
        return GivenSettings(**{**given, **more})

    @contextmanager
    def start(
        self,
        settings: Settings,
        token: str | None = None,
        around: Circumstances | None = None,
    ) -> Iterator[Daemon]:
        """Yield a daemon that listens, addressed with ``token``; raises :class:`StartError`."""
        around = around or Circumstances()
        with self.launcher.running(settings, around) as daemon:
            daemon.address = daemon.address.with_token(token)
            yield daemon

    @asynccontextmanager
    async def advancing(self, seconds: float) -> AsyncIterator[None]:
        """Tell how the time goes, while something takes ``seconds``."""

        async def tick() -> None:
            for step in range(int(seconds)):
                await asyncio.sleep(1)
                self.advance((step + 1) / seconds)

        task = asyncio.create_task(tick())
        try:
            yield
        finally:
            task.cancel()


Run: TypeAlias = Callable[[Ground, Judgement], Awaitable[None]]
Work: TypeAlias = Callable[[], Awaitable[None]]
"""What a client does again and again."""


@asynccontextmanager
async def busy(works: Iterable[Work]) -> AsyncIterator[None]:
    """Do all of it at once, again and again, as long as the context."""

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
    """Make tokens in a state directory; return their secrets."""
    store = TokenStore(settings.state_dir)
    return [store.create(label, scopes, None).secret for label in labels]


async def tokens_of(address: Address) -> dict[str, bool]:
    """Return the ids of all tokens, and whether each of them was not revoked."""
    found: dict[str, bool] = {}
    page: dict[str, Any] = {"next": ""}
    while page["next"] is not None:
        after = f"?after={page['next']}" if page["next"] else ""
        page = (await ask(address, "GET", f"/v1/tokens{after}")).json()
        found |= {each["id"]: each["revoked_at"] is None for each in page["tokens"]}
    return found


async def pair(address: Address, label: str, receiver: Receiver) -> Reply:
    """Pair a daemon with a receiver; return its reply."""
    question = {"label": label, "key": str(receiver)}
    return await ask(address, "POST", "/v1/receivers", body=question)


async def standing_still(address: Address) -> list[str]:
    """Return the tasks of a daemon that do not go on, which it is asked about with all scopes."""
    still = []
    async with listening(address) as stream:
        if not await stream.until("mask", 2, 15.0):
            still.append("rotation")
        taken = await ask(address, "POST", "/v1/classifications", body={})
        if taken.status != 200:
            still.append(f"captures ({taken.status})")
        elif not await stream.until("capture", 1):
            still.append("events")
    return still


async def epochs(address: Address, count: int) -> list[str]:
    """Return the names of the next epochs."""
    async with listening(address) as stream:
        await stream.until("mask", count)
    return stream.masks


async def is_ready(address: Address, patience: float) -> bool:
    """Whether a daemon becomes ready within ``patience`` [s], by itself."""
    for _ in range(math.ceil(patience / 0.2)):
        reply = await ask(address, "GET", "/v1/status")
        if reply.status == 200 and reply.json()["state"] == "ready":
            return True
        await asyncio.sleep(0.2)
    return False


def write_small_bundle(path: Path, task: str) -> Path:
    """Write a bundle of a small window: its light is simulated in milliseconds.

    Masks and classifiers are drawn at random; of one task they are always the same.
    """
    chance = np.random.default_rng(len(task))
    camera, embedding = Camera(window=Window(rows=9, columns=5)), Embedding(4, 5)
    pairs = tuple(_pair(chance, camera, embedding) for _ in range(PAIRS))
    write_bundle(
        path,
        Bundle(
            task=task,
            labels=LABELS,
            camera=camera,
            scene=Scene(),
            embedding=embedding,
            mode="pairs",
            pairs=pairs,
        ),
    )
    return path


def _pair(chance: np.random.Generator, camera: Camera, embedding: Embedding) -> Pair:
    levels = chance.integers(0, camera.panel.levels, camera.mask_shape, np.uint8)
    return Pair(
        levels=levels,
        layers=(Linear(inputs=embedding.size, outputs=len(LABELS)),),
        weights={
            "0.weight": chance.standard_normal((len(LABELS), embedding.size), np.float32),
            "0.bias": np.zeros(len(LABELS), np.float32),
        },
    )
