"""Row of the damaged state: every file of the state directory, truncated, emptied or flipped."""

from __future__ import annotations

import asyncio
import random
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TypeAlias

from tests.siege.client import Address
from tests.siege.ground import (
    Extent,
    Ground,
    Judgement,
    epochs,
    make_tokens,
    pair,
    second_bundle,
    standing_still,
    tokens_of,
)

from veilcam_client.keys.receivers import ReceiverKey
from veilcam_client.wire.log import RECORDS_AT_ONCE
from veilcam_client.wire.rotation import EverySeconds
from veilcam_server.errors import StartError
from veilcam_server.settings import Settings

CALIBRATION = 300.0  # [s]
COPY = ".copy"
SET = EverySeconds(seconds=0.3)
"""Policy that is set over the API: not the one that the daemon is started with."""
BUDGET, MOST = 1, 50
"""Embeddings that may leave raw behind one mask, and requests until all are spent."""

Trial: TypeAlias = tuple[str, tuple[Path, ...], Callable[[bytes], bytes]]
"""Name, paths in the state directory, and damage to their content."""

BARS = {
    "starts refused": "starts_refused",
    "silent roll-backs": "silent_rollbacks",
    "with a task that stands still": "",
    "epochs shown again": "",
    "embeddings beyond the budget": "",
}
"""Faults of trials, none of which may be, each with its figure."""
REFUSED, SILENT, STILL, AGAIN, BEYOND = BARS


async def damaged_state(ground: Ground, judgement: Judgement) -> None:
    # Few embeddings may leave, and all of them do: a count that is lost would let out more.
    settings = ground.settings("damaged-state", release="raw", raw_budget=BUDGET)
    state, pristine = settings.state_dir, settings.state_dir.with_name("pristine")
    [token] = make_tokens(settings, ("owner",))
    with ground.start(settings, token) as daemon:
        kept, shown = await _first_life(daemon.address, settings)
    shutil.copytree(state, pristine)
    trials = sample(list(all_trials(pristine, ground.extent.flips)), ground.extent)
    wrong: dict[str, list[str]] = {bar: [] for bar in BARS}
    for name, paths, damage in trials:
        shutil.rmtree(state)
        shutil.copytree(pristine, state)
        for path in paths:
            (state / path).write_bytes(damage((state / path).read_bytes()))
        try:
            with ground.start(settings, token) as daemon:
                faults = await _faults(daemon.address, settings, kept, shown)
        except StartError as error:
            faults = {REFUSED: str(error).replace(f"{state}/", "")}
        for bar, fault in faults.items():
            wrong[bar].append(f"{name}: {fault}")
    judgement.figures["state_faults_tried"] = len(trials)
    for bar, figure in BARS.items():
        judgement.none(f"{bar} of {len(trials)}", wrong[bar], figure)


async def _faults(
    address: Address, settings: Settings, kept: Mapping[str, object], shown: Sequence[str]
) -> dict[str, str]:
    if (await address.ask("GET", "/v1/status")).status == 401:
        # Nobody is let in; the owner makes a token, as at the very first start.
        [token] = make_tokens(settings, ("owner again",))
        address = address.with_token(token)
    told, after = (await address.get("diagnostics"))["faults"], await _kept(address)
    changed = [name for name, value in kept.items() if after[name] != value]
    beyond = (await address.ask("POST", "/v1/captures")).status == 200
    found = {
        SILENT: [] if told else changed,
        STILL: await standing_still(address),
        AGAIN: set(shown) & set(await epochs(address, 1)),
        BEYOND: ["one"] if beyond else [],
    }
    return {bar: ", ".join(fault) for bar, fault in found.items() if fault}


async def _first_life(address: Address, settings: Settings) -> tuple[dict[str, object], list[str]]:
    digest = (await address.upload(second_bundle(settings))).json()["digest"]
    await pair(address, "archive", ReceiverKey.generate().public)
    await _spend(address)
    await address.ask("POST", f"/v1/bundles/{digest}/activate")
    await _spend(address)
    await address.ask("POST", "/v1/calibration", {"repeats": 1})
    async with asyncio.timeout(CALIBRATION):
        ended = ("done", "failed", "cancelled")
        while (await address.get("calibration"))["run"]["stage"] not in ended:
            await asyncio.sleep(0.5)
    await address.ask("PUT", "/v1/rotation", SET.model_dump())
    await address.ask("POST", "/v1/tokens", {"label": "lamp", "scopes": ["classify"]})
    await address.ask("POST", "/v1/classifications", {})
    shown = await epochs(address, 3)
    return await _kept(address), shown


async def _spend(address: Address) -> None:
    for _ in range(MOST):
        if (await address.ask("POST", "/v1/captures")).status != 200:
            return


async def _kept(address: Address) -> dict[str, object]:
    bundles = (await address.get("bundles"))["bundles"]
    records = (await address.get(f"log?limit={RECORDS_AT_ONCE}"))["records"]
    return {
        "rotation": (await address.get("rotation"))["policy"],
        "active bundle": [each["digest"] for each in bundles if each["active"]],
        "bundles": sorted(each["digest"] for each in bundles if each["bundle"] is not None),
        "tokens": sorted(await tokens_of(address)),
        "calibration": (await address.get("calibration"))["signed"],
        "receivers": await address.get("receivers"),
        # Each start and stop adds a record of its own; those of captures stay what they are.
        "log": [each["signature"] for each in records if each["kind"] == "capture"],
    }


def all_trials(state: Path, flips: int) -> Iterator[Trial]:
    yield "nothing damaged", (), lambda content: content
    files = [path.relative_to(state) for path in sorted(state.rglob("*")) if path.is_file()]
    for path in files:
        copies = tuple(other for other in files if other == path.with_name(path.name + COPY))
        for paths in {(path,), (path, *copies)}:
            names = " and ".join(str(each)[-24:] for each in paths)
            yield f"{names} truncated", paths, lambda content: content[: len(content) // 2]
            yield f"{names} emptied", paths, lambda _: b""
            for number in range(flips):
                yield f"{names} flipped", paths, partial(flipped, f"{names} {number}")


def sample(trials: list[Trial], extent: Extent) -> list[Trial]:
    others = random.Random(0).sample(trials[1:], min(extent.starts, len(trials)) - 1)
    return [trials[0], *others]


def flipped(seed: str, content: bytes) -> bytes:
    changed, chance = bytearray(content), random.Random(seed)
    if changed:
        changed[chance.randrange(len(changed))] ^= 1 << chance.randrange(8)
    return bytes(changed)
