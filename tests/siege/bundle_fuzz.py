"""Row of mutated bundles: each is refused with a reason or loads as what it says, without harm.

What is done to them is in ``mutations``. Every file is read and, if it is not refused, put to use
in a child process with bounds of memory and time. Some are sent to a daemon besides: the mask and
the bundle in use must stay the same, unless a file was accepted and activated.
"""

from __future__ import annotations

import dataclasses
import math
import os
import random
import resource
import time
from collections import Counter
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TypeAlias

import numpy as np
import torch
from tests.siege.client import Address
from tests.siege.daemon import child
from tests.siege.ground import UNHINDERED, Ground, Judgement, make_tokens
from tests.siege.mutations import kind, mutated
from tests.siege.samples import fresh_bundle, small_bundle, written

from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.wire.rotation import RotationOff
from veilcam_server.bundles.loader import Opener
from veilcam_server.errors import BundleRefusedError, InferenceError
from veilcam_server.masks.fresh import FreshSource
from veilcam_server.masks.pairs import load_pairs
from veilcam_server.masks.source import MaskSource
from veilcam_training.bundle import Bundle, read_bundle

KEY = EpochKey(bytes(32), device="0f" * 32, bundle="0f" * 32)
SLOW = 10.0  # [s]
MEMORY = 768 * 2**20
"""Most memory of one file, beside that of the process [bytes]."""
BATCH = 100


def source_of(bundle: Bundle) -> MaskSource:
    return load_pairs(bundle) if bundle.mode == "pairs" else FreshSource(bundle)


def use(source: MaskSource, bundle: Bundle) -> None:
    mask = source.make(KEY, frozenset())
    if mask.levels.shape != bundle.camera.mask_shape or int(np.max(mask.levels)) > 63:
        raise RuntimeError("a mask that the panel cannot show")
    embedding = np.full(bundle.embedding.shape, 0.1, np.float32)
    try:
        verdict = mask.reader.classify(embedding)
    except InferenceError:
        return  # no label, and told so
    scores = verdict.scores or {}
    if verdict.label not in bundle.labels or not math.isclose(sum(scores.values()), 1):
        raise RuntimeError("a label that is none")


def try_one(path: Path, openers: Sequence[Opener]) -> str:
    for opener in openers:
        try:
            bundle = opener.read(path)
            opener.load(bundle)
        except BundleRefusedError as error:
            reason = str(error)
            if not reason or "\n" in reason or str(path) in reason or len(reason) > 2000:
                raise RuntimeError("a reason that is none") from None
            continue
        use(source_of(bundle), bundle)
        return "accepted"
    return "refused"


Attempt: TypeAlias = Callable[[Path, Sequence[Opener]], str]


def try_some(
    tell: Connection, seeds: Sequence[int], data: Sequence[bytes], work: Path, attempt: Attempt
) -> None:
    torch.set_num_threads(1)
    path, bundles = work / "mutated.veilcam", list[Bundle]()
    for content in data:
        path.write_bytes(content)
        bundles.append(read_bundle(path))
    openers = [Opener(bundle, source_of) for bundle in bundles]
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    allowed = pages * os.sysconf("SC_PAGE_SIZE") + MEMORY
    for seed in seeds:
        path.write_bytes(mutated(seed, data))
        tell.send((seed, None))
        resource.setrlimit(resource.RLIMIT_AS, (allowed, resource.RLIM_INFINITY))
        try:
            result = attempt(path, openers)
        except BaseException as error:
            result = f"crash: {type(error).__name__}: {str(error)[:200]}"
        resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        tell.send((seed, result))
    tell.send(None)


@dataclasses.dataclass
class Outcome:
    """Results of all files, and their failures; the slowest file took so long [s]."""

    results: Counter[str] = dataclasses.field(default_factory=Counter)
    failures: list[str] = dataclasses.field(default_factory=list)
    slowest: float = 0.0

    def hear(self, told: Connection, left: list[int]) -> None:
        begun = 0.0
        while True:
            # Loading what is not mutated is no file's time.
            limit = SLOW if begun else 120.0
            try:
                said = told.recv() if told.poll(limit) else (left[0], f"crash: over {limit} s")
            except EOFError:
                said = (left[0], "crash: the process died")
            if said is None:
                return
            seed, result = said
            if result is None:
                begun = time.monotonic()
                continue
            self.slowest = max(self.slowest, time.monotonic() - begun)
            self.results[result.partition(":")[0]] += 1
            if result.startswith("crash"):
                self.failures.append(f"seed {seed} ({kind(seed).__name__}): {result}")
            left.remove(seed)
            if "process died" in result or "over" in result:
                return


def try_all(
    seeds: Sequence[int], data: Sequence[bytes], work: Path, attempt: Attempt = try_one
) -> Outcome:
    outcome, left = Outcome(), list(seeds)
    while left:
        with child(try_some, left[:BATCH], data, work, attempt) as (_, told):
            outcome.hear(told, left)
    return outcome


async def disturb(address: Address, content: bytes) -> str | None:
    async def in_use() -> tuple[str, str, list[str]]:
        bundles = (await address.get("bundles"))["bundles"]
        [active] = [each for each in bundles if each["active"]]
        epoch = (await address.get("rotation"))["epoch"]
        return active["digest"], epoch, active["bundle"]["labels"]

    before = wanted = await in_use()
    installed = await address.upload(content)
    if await in_use() != before:
        return "what was only sent is in use"
    digest = installed.json().get("digest")
    if installed.status in (200, 201):
        activated = await address.ask("POST", f"/v1/bundles/{digest}/activate")
        wanted = await in_use() if activated.status == 200 else before
        if activated.status == 200 and wanted[0] != digest:
            return "another bundle than the one that was activated is in use"
    taken = await address.ask("POST", "/v1/classifications", {})
    told = taken.json() if taken.status == 200 else {"epoch": wanted[1], "label": wanted[2][0]}
    if await in_use() != wanted or told["epoch"] != wanted[1] or told["label"] not in wanted[2]:
        return "another bundle, mask or label than those in use"
    if wanted[0] != before[0]:
        await address.ask("POST", f"/v1/bundles/{before[0]}/activate")
        await address.ask("DELETE", f"/v1/bundles/{wanted[0]}")
    if any(reply.status >= 500 and reply.status != 503 for reply in (installed, taken)):
        return f"answers {installed.status} and {taken.status}"
    return None if (await in_use())[0] == before[0] else "the bundle before did not come back"


async def fuzzed(ground: Ground, judgement: Judgement) -> None:
    extent, work = ground.extent, ground.folder
    settings = ground.settings("bundle-fuzz", rotation=RotationOff(), **UNHINDERED)
    # The last one stays, for the daemon.
    bundles = (fresh_bundle(), small_bundle())
    data = [written(settings.bundle, bundle).read_bytes() for bundle in bundles]
    failures, seeds = list[str](), range(extent.files)
    outcome = try_all(seeds, data, work)
    [token] = make_tokens(settings, ("owner",))
    with ground.start(settings, token) as daemon:
        for seed in random.Random(0).sample(seeds, extent.live):
            if wrong := await disturb(daemon.address, mutated(seed, data)):
                failures.append(f"seed {seed} ({kind(seed).__name__}), daemon: {wrong}")
    counted = ", ".join(f"{count} {result}" for result, count in outcome.results.most_common())
    failures += outcome.failures
    judgement.none(f"failures of {extent.files} files", failures, "bundle_fuzz_crashes")
    for result in ("refused", "accepted"):
        judgement.at_least(f"of {counted}: {result}", outcome.results[result], 1)
    judgement.at_most("slowest file [s]", outcome.slowest, 2 * SLOW)
