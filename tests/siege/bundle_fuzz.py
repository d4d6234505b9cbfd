"""Mutated bundles: each is refused with a reason or loads as what it says, and never does harm.

    python -m tests.siege.bundle_fuzz --figures benchmarks/results/daemon.json

What is done to them is in ``mutations``. Every file is read and, if it is not refused, put to use
in a child process that may take a limited amount of memory and of time. Some are sent to a running
service besides: whatever they are, the mask and the bundle in use must stay the same, unless a
file was accepted and activated.
"""

from __future__ import annotations

import asyncio
import dataclasses
import hashlib
import math
import multiprocessing
import os
import random
import resource
import time
from collections import Counter
from collections.abc import AsyncIterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Annotated

import numpy as np
import structlog
import torch
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.rig import work_folder
from tests.siege.mutations import kind, mutated
from tests.siege.samples import make_bundles

from veilcam_client.keys.epoch_key import EpochKey
from veilcam_client.wire.rotation import RotationOff
from veilcam_server.bundles.loader import Opener
from veilcam_server.daemon import build_service
from veilcam_server.demo_data import load_digits
from veilcam_server.devices.simulated.scenes import write_scene
from veilcam_server.errors import (
    BundleInvalidError,
    BundleUnfitError,
    InferenceError,
    ProblemError,
)
from veilcam_server.masks.fresh import FreshSource
from veilcam_server.masks.pairs import load_pairs
from veilcam_server.masks.source import MaskSource
from veilcam_server.service.service import Service
from veilcam_server.settings import Settings
from veilcam_training.bundle import Bundle, read_bundle, write_bundle

KEY = EpochKey(bytes(32), device="0f" * 32, bundle="0f" * 32)
SLOW = 10.0
"""A file that takes longer is a hang [s]."""
MEMORY = 768 * 2**20
"""What one file may take besides what is there before it [bytes]."""
BATCH = 100


def contents(bundle: Bundle) -> bytes:
    """A digest of all that a bundle holds, whatever file it was in."""
    found = hashlib.sha256(repr(dataclasses.replace(bundle, digest="")).encode())
    arrays = [pair.levels.tobytes() for pair in bundle.pairs]
    weights = [pair.weights for pair in bundle.pairs]
    if bundle.fresh is not None:
        fresh = bundle.fresh
        arrays += [getattr(fresh.distribution, name).tobytes() for name in ("lowest", "highest")]
        arrays += [getattr(fresh.statistics, name).tobytes() for name in ("mean", "basis")]
        weights.append(fresh.weights)
    for array in arrays:
        found.update(array)
    for one in weights:
        for name in sorted(one):
            found.update(name.encode() + one[name].tobytes())
    return found.digest()


def source_of(bundle: Bundle) -> MaskSource:
    """What the daemon would draw masks from."""
    if bundle.mode == "pairs":
        return load_pairs(bundle)
    return FreshSource(bundle)


def use(source: MaskSource, bundle: Bundle) -> None:
    """Take a mask and read an embedding behind it, as the daemon does."""
    mask = source.make(KEY, "white" if bundle.fresh is not None else "sealed", frozenset())
    if mask.levels.shape != bundle.camera.mask_shape or int(np.max(mask.levels)) > 63:
        raise RuntimeError("a mask that the panel cannot show")
    embedding = np.full(bundle.embedding.shape, 0.1, np.float32)
    try:
        verdict = mask.reader.classify(embedding)
        if bundle.fresh is not None:
            white = mask.reader.whiten(embedding)
            if not math.isclose(float(np.linalg.norm(white)), 1.0, rel_tol=1e-5):
                raise RuntimeError("a white embedding that is no direction")
    except InferenceError:
        return  # no label, and told so
    scores = verdict.scores or {}
    if verdict.label not in bundle.labels or not math.isclose(sum(scores.values()), 1):
        raise RuntimeError("a label that is none")


def try_one(path: Path, openers: Sequence[Opener], originals: Sequence[bytes]) -> str:
    """Read the file, and use it if it is not refused; tell what came of it."""
    for opener in openers:
        try:
            bundle = opener.read(path)
            opener.load(bundle)
        except (BundleInvalidError, BundleUnfitError) as error:
            reason = str(error)
            if not reason or "\n" in reason or str(path) in reason or len(reason) > 2000:
                raise RuntimeError("a reason that is none") from None
            continue
        use(source_of(bundle), bundle)
        return "same" if contents(bundle) in originals else "another"
    return "refused"


def child(connection: Connection, seeds: Sequence[int], data: Sequence[bytes], work: Path) -> None:
    """Try files, one after the other, in bounded memory."""
    torch.set_num_threads(1)
    bundles = read_all(data, work)
    openers = [Opener(bundle, source_of) for bundle in bundles]
    originals = [contents(bundle) for bundle in bundles]
    path = work / "mutated.veilcam"
    allowed = address_space() + MEMORY
    for seed in seeds:
        path.write_bytes(mutated(seed, data))
        connection.send((seed, None))
        resource.setrlimit(resource.RLIMIT_AS, (allowed, resource.RLIM_INFINITY))
        try:
            result = try_one(path, openers, originals)
        except BaseException as error:
            result = f"crash: {type(error).__name__}: {str(error)[:200]}"
        resource.setrlimit(resource.RLIMIT_AS, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        connection.send((seed, result))
    connection.send(None)


def read_all(data: Sequence[bytes], work: Path) -> list[Bundle]:
    """The bundles that were not mutated."""
    found = []
    for number, content in enumerate(data):
        path = work / f"original-{number}.veilcam"
        path.write_bytes(content)
        found.append(read_bundle(path))
    return found


def address_space() -> int:
    """Of this process [bytes]."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    return pages * os.sysconf("SC_PAGE_SIZE")


@dataclasses.dataclass
class Outcome:
    """What became of the files."""

    results: Counter[str] = dataclasses.field(default_factory=Counter)
    kinds: Counter[str] = dataclasses.field(default_factory=Counter)
    """How often each kind of mutation was not refused."""
    failures: list[str] = dataclasses.field(default_factory=list)
    slowest: float = 0.0
    """[s]"""

    def note(self, seed: int, result: str) -> None:
        """Count one file."""
        name = kind(seed).__name__
        self.results[result.partition(":")[0]] += 1
        if result.startswith("crash"):
            self.failures.append(f"seed {seed} ({name}): {result}")
        elif result != "refused":
            self.kinds[name] += 1


def try_all(seeds: Sequence[int], data: Sequence[bytes], work: Path) -> Outcome:
    """Try all files; a child that dies or hangs is replaced, and its file counted as a crash."""
    outcome, left = Outcome(), list(seeds)
    fork = multiprocessing.get_context("fork")
    while left:
        batch = left[:BATCH]
        ours, theirs = fork.Pipe(duplex=False)
        process = fork.Process(target=child, args=(theirs, batch, data, work))
        process.start()
        theirs.close()
        try:
            _watch(ours, outcome, left)
        finally:
            process.kill()
            process.join()
            ours.close()
    return outcome


def _watch(ours: Connection, outcome: Outcome, left: list[int]) -> None:
    """Note what one child says, and take what it has done off the list."""
    begun = 0.0
    while True:
        # Loading what is not mutated is no file's time.
        limit = SLOW if begun else 120.0
        try:
            said = ours.recv() if ours.poll(limit) else (left[0], f"crash: over {limit} s")
        except EOFError:
            said = (left[0], "crash: the process died")
        if said is None:
            return
        seed, result = said
        if result is None:
            begun = time.monotonic()
            continue
        outcome.slowest = max(outcome.slowest, time.monotonic() - begun)
        outcome.note(seed, result)
        left.remove(seed)
        if "process died" in result or "over" in result:
            return


async def try_service(seeds: Sequence[int], data: Sequence[bytes], work: Path) -> list[str]:
    """Send files to a running service; tell whatever changed what runs."""
    configured, scene = work / "configured.veilcam", work / "scene.npy"
    configured.write_bytes(data[0])
    write_scene(scene, load_digits().images[0])
    settings = Settings(
        bundle=configured,
        device="simulated",
        scenes=(str(scene),),
        state_dir=work / "state",
        settle=0.0,
        exposure=0.0,
        rotation=RotationOff(),  # whatever changes the mask, time does not
    )
    service = await asyncio.to_thread(build_service, settings)
    failures = []
    async with service.open():
        for seed in seeds:
            try:
                changed = await disturb(service, mutated(seed, data))
            except Exception as error:
                changed = f"{type(error).__name__}: {str(error)[:200]}"
            if changed is not None:
                failures.append(f"seed {seed} ({kind(seed).__name__}), service: {changed}")
    return failures


async def disturb(service: Service, content: bytes) -> str | None:
    """Send one file; return what is wrong afterwards, or None."""

    async def chunks() -> AsyncIterator[bytes]:
        for start in range(0, len(content), 2**16):
            yield content[start : start + 2**16]

    before, epoch = service.status().bundle, service.rotation().epoch
    wanted = before
    try:
        installed = await service.bundles.install(chunks())
        assert installed.bundle is not None
        if service.status().bundle != before or service.rotation().epoch != epoch:
            return "what was only sent is in use"
        await service.activate_bundle(installed.digest)
        wanted, epoch = installed.bundle, service.rotation().epoch
    except ProblemError:
        pass
    if service.status().bundle != wanted or service.rotation().epoch != epoch:
        return "another bundle or mask is in use"
    try:
        result = await service.classify(include_embedding=False, scores="all")
    except InferenceError:
        result = None
    if result is not None and (result.label not in wanted.labels or result.epoch != epoch):
        return "another mask or label than those in use"
    if wanted != before:
        await service.activate_bundle(before.digest)
        await service.bundles.remove(wanted.digest)
    return None if service.status().bundle == before else "the bundle before did not come back"


def serve_child(connection: Connection, seeds: Sequence[int], data: Sequence[bytes]) -> None:
    """:func:`try_service` in a process of its own."""
    torch.set_num_threads(1)
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(50))
    with work_folder() as work:
        connection.send(asyncio.run(try_service(seeds, data, work)))


def try_live(seeds: Sequence[int], data: Sequence[bytes]) -> list[str]:
    """What changed in a running service that should not have."""
    fork = multiprocessing.get_context("fork")
    ours, theirs = fork.Pipe(duplex=False)
    process = fork.Process(target=serve_child, args=(theirs, seeds, data))
    process.start()
    theirs.close()
    try:
        patience = 120.0 + SLOW * len(seeds)
        failures: list[str] = ours.recv() if ours.poll(patience) else ["the service hangs"]
    except EOFError:
        failures = ["the service died"]
    finally:
        process.kill()
        process.join()
        ours.close()
    return failures


def main(
    *,
    files: Annotated[int, typer.Option(min=1, help="To make and try.")] = 10_000,
    live: Annotated[int, typer.Option(min=0, help="Of them also sent to a service.")] = 1000,
    seed: Annotated[int, typer.Option(min=0, help="Of the first file.")] = 0,
    figures: FiguresOption = None,
) -> None:
    """Look for files that crash, hang, fill the memory, or change what runs."""
    torch.set_num_threads(1)
    seeds = range(seed, seed + files)
    with work_folder() as work:
        data = []
        for number, bundle in enumerate(make_bundles()):
            write_bundle(work / f"{number}.veilcam", bundle)
            data.append((work / f"{number}.veilcam").read_bytes())
        failures = try_live(random.Random(seed).sample(seeds, min(live, files)), data)
        outcome = try_all(seeds, data, work)
    failures += outcome.failures
    for failure in failures[:20]:
        print(failure)
    counted = ", ".join(f"{count} {result}" for result, count in outcome.results.most_common())
    print(f"{files} files: {counted}; slowest {outcome.slowest:.1f} s")
    print("not refused:", ", ".join(f"{kind} {n}" for kind, n in outcome.kinds.most_common()))
    print(f"{min(live, files)} of them sent to a service; {len(failures)} failures in all")
    record(figures, {"bundle_fuzz_crashes": len(failures)})
    if failures:
        raise SystemExit(1)


if __name__ == "__main__":
    typer.run(main)
