"""Row of the damaged state: every file of the state directory, truncated, emptied or flipped."""

from __future__ import annotations

import asyncio
import random
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TypeAlias

from tests.siege.client import Address, ask
from tests.siege.daemon import Daemon
from tests.siege.ground import (
    Extent,
    Ground,
    Judgement,
    epochs,
    make_tokens,
    pair,
    standing_still,
    tokens_of,
    write_small_bundle,
)

from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.bundles import BUNDLE_MEDIA_TYPE
from veilcam_client.wire.log import RECORDS_AT_ONCE
from veilcam_client.wire.rotation import EverySeconds
from veilcam_server.errors import StartError
from veilcam_server.settings import Settings

CALIBRATION = 300.0
"""Longest wait for a calibration [s]."""
ENDED = ("done", "failed", "cancelled")
COPY = ".copy"
"""What the name of a state file's second copy ends with."""
SET = EverySeconds(seconds=0.3)
"""Set over the API: it is not the one that the daemon is started with."""
BUDGET, MOST = 1, 50
"""Embeddings that may leave raw behind one mask, and that are asked for until all are spent."""
SHOWN, SHOWN_NAME = 3, 24
"""Trials that a verdict names, and letters of a file's name in it."""

Damage: TypeAlias = Callable[[bytes], bytes]


@dataclass(frozen=True, slots=True)
class Trial:
    """What is done to which files, by their paths in the state directory."""

    name: str
    paths: tuple[Path, ...]
    damage: Damage = field(repr=False)


@dataclass(frozen=True, slots=True)
class Facts:
    """What clients knew of a daemon, and may rely on.

    Attributes:
        kept: by name; what differs afterwards was rolled back.
        epochs: names of all epochs that were shown.
    """

    kept: Mapping[str, object]
    epochs: Sequence[str]


@dataclass
class Outcome:
    """What came of all trials; each entry names a trial and what went wrong."""

    refused: list[str] = field(default_factory=list)
    silent: list[str] = field(default_factory=list)
    still: list[str] = field(default_factory=list)
    again: list[str] = field(default_factory=list)
    beyond: list[str] = field(default_factory=list)

    async def compare(self, trial: str, daemon: Daemon, settings: Settings, facts: Facts) -> None:
        """Compare a daemon that was started on damaged state with what clients knew."""
        if (await ask(daemon.address, "GET", "/v1/status")).status == 401:
            # Nobody is let in; the owner makes a token, as at the very first start.
            [token] = make_tokens(settings, ("owner again",))
            daemon.address = daemon.address.with_token(token)
        faults = (await ask(daemon.address, "GET", "/v1/diagnostics")).json()["faults"]
        after = await _kept(daemon.address)
        changed = [name for name, value in facts.kept.items() if after[name] != value]
        if changed and not faults:
            self.silent.append(f"{trial}: {', '.join(changed)}")
        still = await standing_still(daemon.address)
        if still:
            self.still.append(f"{trial}: {', '.join(still)}")
        if (await ask(daemon.address, "POST", "/v1/captures")).status == 200:
            self.beyond.append(trial)
        if set(facts.epochs) & set(await epochs(daemon.address, 1)):
            self.again.append(trial)


async def damaged_state(ground: Ground, judgement: Judgement) -> None:
    """Damage every state file before a start, one way at a time."""
    # Few embeddings may leave, and all of them do: a count that is lost would let out more.
    settings = ground.settings("damaged-state", release="raw", raw_budget=BUDGET)
    state, pristine = settings.state_dir, settings.state_dir.with_name("pristine")
    [token] = make_tokens(settings, ("owner",))
    with ground.start(settings, token) as daemon:
        facts = await _first_life(daemon, settings)
    shutil.copytree(state, pristine)
    trials, outcome = (
        _sample(list(_trials(pristine, ground.extent.flips)), ground.extent),
        Outcome(),
    )
    for number, trial in enumerate(trials):
        ground.advance(number / len(trials))
        shutil.rmtree(state)
        shutil.copytree(pristine, state)
        for path in trial.paths:
            (state / path).write_bytes(trial.damage((state / path).read_bytes()))
        try:
            with ground.start(settings, token) as daemon:
                await outcome.compare(trial.name, daemon, settings, facts)
        except StartError as error:
            reason = str(error).replace(f"{settings.state_dir}/", "")
            outcome.refused.append(f"{trial.name}: {reason}")
    judgement.figures["state_faults_tried"] = len(trials)
    for what, wrong, figure in (
        ("starts refused", outcome.refused, "starts_refused"),
        ("silent roll-backs", outcome.silent, "silent_rollbacks"),
        ("with a task that stands still", outcome.still, None),
        ("epochs shown again", outcome.again, None),
        ("embeddings beyond the budget", outcome.beyond, None),
    ):
        shown = "; ".join(wrong[:SHOWN])
        judgement.at_most(f"{what} of {len(trials)}", len(wrong), 0, beside=shown, figure=figure)


async def _first_life(daemon: Daemon, settings: Settings) -> Facts:
    """Let a daemon have everything that it can remember."""
    address = daemon.address
    content = write_small_bundle(settings.bundle.with_name("second.veilcam"), "second").read_bytes()
    upload = {"Content-Type": BUNDLE_MEDIA_TYPE}
    installed = await ask(address, "POST", "/v1/bundles", body=content, headers=upload)
    digest = installed.json()["digest"]
    await pair(address, "archive", ReceiverKey.generate().public)
    await _spend(address)
    await ask(address, "POST", f"/v1/bundles/{digest}/activate")
    await _spend(address)
    await ask(address, "POST", "/v1/calibration", body={"repeats": 1})
    async with asyncio.timeout(CALIBRATION):
        while (await ask(address, "GET", "/v1/calibration")).json()["run"]["stage"] not in ENDED:
            await asyncio.sleep(0.5)
    await ask(address, "PUT", "/v1/rotation", body=SET.model_dump())
    await ask(address, "POST", "/v1/tokens", body={"label": "lamp", "scopes": ["classify"]})
    await ask(address, "POST", "/v1/classifications", body={})
    shown = await epochs(address, 3)
    return Facts(await _kept(address), shown)


async def _spend(address: Address) -> None:
    """Have all embeddings that may leave behind the masks of the bundle in use."""
    for _ in range(MOST):
        if (await ask(address, "POST", "/v1/captures")).status != 200:
            return


async def _kept(address: Address) -> dict[str, object]:
    """What clients can ask for and rely on, by name."""
    replies = {
        name: (await ask(address, "GET", f"/v1/{name}")).json()
        for name in ("rotation", "bundles", "calibration", "receivers")
    }
    bundles = replies["bundles"]["bundles"]
    records = (await ask(address, "GET", f"/v1/log?limit={RECORDS_AT_ONCE}")).json()["records"]
    return {
        "rotation": replies["rotation"]["policy"],
        "active bundle": [each["digest"] for each in bundles if each["active"]],
        "bundles": sorted(each["digest"] for each in bundles if each["bundle"] is not None),
        "tokens": sorted(await tokens_of(address)),
        "calibration": replies["calibration"]["signed"],
        "receivers": replies["receivers"],
        # Each start and stop adds a record of its own; those of captures stay what they are.
        "log": [each["signature"] for each in records if each["entry"]["kind"] == "capture"],
    }


def _trials(state: Path, flips: int) -> Iterator[Trial]:
    """Every way to damage every file alone, and a file together with its copy."""
    yield Trial("nothing damaged", (), lambda content: content)
    files = [path.relative_to(state) for path in sorted(state.rglob("*")) if path.is_file()]
    for path in files:
        copies = tuple(other for other in files if other == path.with_name(path.name + COPY))
        for paths in {(path,), (path, *copies)}:
            names = " and ".join(str(each)[-SHOWN_NAME:] for each in paths)
            yield Trial(f"{names} truncated", paths, lambda content: content[: len(content) // 2])
            yield Trial(f"{names} emptied", paths, lambda _: b"")
            for number in range(flips):
                flip = partial(_flipped, random.Random(f"{names} {number}"))
                yield Trial(f"{names} flipped", paths, flip)


def _sample(trials: list[Trial], extent: Extent) -> list[Trial]:
    """The first of all trials, which damages nothing, and so many others that there is time for."""
    others = random.Random(0).sample(trials[1:], min(extent.starts, len(trials)) - 1)
    return [trials[0], *others]


def _flipped(chance: random.Random, content: bytes) -> bytes:
    """One bit of one byte is another."""
    if not content:
        return content
    place = chance.randrange(len(content))
    flipped = content[place] ^ (1 << chance.randrange(8))
    return content[:place] + bytes((flipped,)) + content[place + 1 :]
