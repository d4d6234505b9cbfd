"""Mutated bundles: each is refused with a reason or loads as what it says, and never does harm.

    python tests/stress/bundle_fuzz.py --figures benchmarks/results/daemon.json

Bits are flipped, files cut and spliced; archives lie about sizes, names and compression; headers,
layers and weights are changed and digests put right, so that the checks behind them are reached.
Every file is read and, if it is not refused, put to use in a child process that may take a limited
amount of memory and of time. Some are sent to a running service besides: whatever they are,
the mask and the keyring in use must stay the same, unless a file was accepted and activated.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import asyncio
import copy
import dataclasses
import hashlib
import json
import math
import multiprocessing
import random
import resource
import struct
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from io import BytesIO
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import safetensors.torch
import structlog
import torch
import typer

from veilcam_optics.camera.geometry import Camera, Embedding, Scene, Window
from veilcam_optics.decoding import ReadingNoise, fit_statistics
from veilcam_optics.keys.masks import MaskDistribution, Secret
from veilcam_server.bundles.loader import Opener
from veilcam_server.daemon import build_service
from veilcam_server.demo_data import load_digits
from veilcam_server.devices.simulated.scenes import write_scene
from veilcam_server.errors import (
    InferenceError,
    KeyringInvalidError,
    KeyringUnfitError,
    ProblemError,
)
from veilcam_server.masks.fresh import FreshSource
from veilcam_server.masks.pairs import load_pairs
from veilcam_server.masks.source import MaskSource
from veilcam_server.service.service import Service
from veilcam_server.settings import Settings
from veilcam_training.bundle import Bundle, Fresh, Pair, build_untrained, read_bundle, write_bundle
from veilcam_training.bundle.layers import (
    GELU,
    Affine,
    AveragePool,
    BatchNorm,
    Conv2d,
    Dropout,
    Flatten,
    LayerNorm,
    LayerRecord,
    Linear,
    MaxPool,
    ReLU,
    Reshape,
    Residual,
    Resize,
)
from veilcam_training.experiments.records import record_figures

CAMERA, SCENE, EMBEDDING = Camera(window=Window(rows=9, columns=5)), Scene(), Embedding(4, 5)
LABELS = tuple("0123456789")
SECRET = Secret(bytes(32))
SLOW = 10.0
"""A file that takes longer is a hang [s]."""
MEMORY = 768 * 2**20
"""What one file may take besides what is there before it [bytes]."""
BATCH = 100

Parts = dict[str, bytes]
Mutation = Callable[[random.Random, Sequence[bytes]], bytes]


def make_bundles() -> list[Bundle]:
    """Two that fit one camera, with every kind of layer between them: stored masks and fresh."""
    torch.manual_seed(0)
    flat: tuple[LayerRecord, ...] = (
        LayerNorm(shape=(20,)),
        Affine(scale=2.0, offset=0.1),
        Linear(inputs=20, outputs=16),
        BatchNorm(features=16),
        GELU(),
        Dropout(),
        Linear(inputs=16, outputs=10),
    )
    deep: tuple[LayerRecord, ...] = (
        Reshape(shape=(1, 4, 5)),
        Resize(rows=8, columns=8),
        Conv2d(inputs=1, outputs=4),
        Residual(layers=(Conv2d(inputs=4, outputs=4), BatchNorm(features=4, dimensions=2), ReLU())),
        MaxPool(),
        AveragePool(rows=2, columns=2),
        Flatten(),
        Linear(inputs=16, outputs=10),
    )
    fresh: tuple[LayerRecord, ...] = (
        Reshape(shape=(2, *SCENE.shape)),
        AveragePool(rows=4, columns=4),
        Flatten(),
        Linear(inputs=32, outputs=10),
    )

    def pair(layers: tuple[LayerRecord, ...]) -> Pair:
        levels = torch.randint(0, 64, CAMERA.mask_shape, dtype=torch.uint8).numpy()
        return Pair(levels, layers, build_untrained(layers).state_dict())

    digits = torch.from_numpy(load_digits().images[:100] / np.float32(255))
    pairs = Bundle(
        task="mnist",
        labels=LABELS,
        camera=CAMERA,
        scene=SCENE,
        embedding=EMBEDDING,
        mode="pairs",
        pairs=(pair(flat), pair(deep)),
        provenance={"seed": 1, "recipe": {"epochs": 2, "rates": [0.1, None]}},
    )
    keyed = Fresh(
        device="fuzz",
        distribution=MaskDistribution.uniform(CAMERA),
        statistics=fit_statistics([digits], 8),
        noise=ReadingNoise(40.0),
        layers=fresh,
        weights=build_untrained(fresh).state_dict(),
    )
    return [pairs, dataclasses.replace(pairs, mode="fresh", pairs=(), fresh=keyed)]


def unpack(data: bytes) -> Parts:
    """The parts of an archive."""
    with zipfile.ZipFile(BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def pack(parts: Parts, compression: int = zipfile.ZIP_DEFLATED) -> bytes:
    """An archive with these parts, and their right digests where there is a place for them."""
    try:
        manifest = json.loads(parts["bundle.json"])
        for name in manifest["parts"]:
            if name in parts:
                manifest["parts"][name] = hashlib.sha256(parts[name]).hexdigest()
        parts = {**parts, "bundle.json": json.dumps(manifest).encode()}
    except (ValueError, KeyError, TypeError, RecursionError):
        pass  # a manifest that is broken on purpose
    buffer = BytesIO()
    with zipfile.ZipFile(buffer, "w", compression) as archive:
        for name, data in parts.items():
            archive.writestr(zipfile.ZipInfo(name), data, compression)
    return buffer.getvalue()


def flip(chance: random.Random, data: Sequence[bytes]) -> bytes:
    """Some bits the other way round."""
    flipped = bytearray(chance.choice(data))
    for _ in range(chance.choice((1, 1, 2, 8, 64))):
        flipped[chance.randrange(len(flipped))] ^= 1 << chance.randrange(8)
    return bytes(flipped)


def cut(chance: random.Random, data: Sequence[bytes]) -> bytes:
    """A part of the file, or more than the file."""
    whole = chance.choice(data)
    start, end = sorted(chance.randrange(len(whole) + 1) for _ in range(2))
    return chance.choice(
        (whole[:end], whole[start:], whole[start:end], whole[:start] + whole[end:], whole + whole)
    )


def splice(chance: random.Random, data: Sequence[bytes]) -> bytes:
    """Bytes from elsewhere, or random ones, in the place of others."""
    whole, other = chance.choice(data), chance.choice(data)
    size = chance.randrange(1, 200)
    start, source = chance.randrange(len(whole)), chance.randrange(len(other))
    piece = chance.choice((other[source : source + size], chance.randbytes(size), bytes(size)))
    return whole[:start] + piece + whole[start + size :]


def archive_parts(chance: random.Random, data: Sequence[bytes]) -> bytes:
    """An archive with odd parts: too many, too few, too large, of another's content."""
    parts = unpack(chance.choice(data))
    name = chance.choice(sorted(parts))
    trick = chance.randrange(4)
    if trick == 0:
        parts[chance.choice(("../evil", "/etc/x", "", "line\nbreak", "x" * 60_000))] = b"x"
    elif trick == 1:
        del parts[name]
    elif trick == 2:  # much from little
        parts[name] = bytes(chance.choice((2**20, 2**24, 2**26, 2**27)))
    else:
        parts[name] = chance.choice(list(parts.values()))
    methods = (zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)
    return pack(parts, chance.choice(methods))


def archive_fields(chance: random.Random, data: Sequence[bytes]) -> bytes:
    """Sizes, flags, methods, offsets: in local headers, in the directory, and at its end."""
    changed = bytearray(chance.choice(data))
    mark = chance.choice((b"PK\3\4", b"PK\1\2", b"PK\5\6"))
    starts = [at for at in range(len(changed)) if changed.startswith(mark, at)]
    at = chance.choice(starts) + chance.randrange(4, 46)
    value = chance.choice((0, 1, 0x7FFFFFFF, 0xFFFFFFFF, chance.getrandbits(32)))
    changed[at : at + 4] = struct.pack("<I", value)
    before = chance.randbytes(chance.choice((0, 0, 1, 1000)))
    return before + changed + chance.randbytes(chance.choice((0, 0, 1, 1000)))


NASTY: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, 2, 3, 64, 255, 256, 4096, 65536, 2**20, 2**31, 2**63, 10**30),
    *(0.0, -0.0, 1e-300, 1e-9, 0.5, 1e9, 1e300, -1.5, "", "x", "nan", "\0", "\ud800", "é" * 300),
    *("x" * 100_000, [], {}, [[]], [1] * 5000, {"": None}, {"kind": "linear"}),
)


def places(content: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Every place in a JSON document."""
    yield path
    if isinstance(content, dict):
        for key, value in content.items():
            yield from places(value, (*path, key))
    elif isinstance(content, list):
        for index, value in enumerate(content):
            yield from places(value, (*path, index))


def edit(chance: random.Random, content: Any, value: Any) -> None:
    """Put ``value`` somewhere into a JSON document, or take something away."""
    # A copy: what is changed here again must not change for other files.
    value = copy.deepcopy(value)
    path = chance.choice(list(places(content))[1:])
    parent = content
    for step in path[:-1]:
        parent = parent[step]
    action = chance.randrange(6)
    if action == 0:
        del parent[path[-1]]
    elif action == 1 and isinstance(parent, dict):
        parent[chance.choice(("surprise", "__proto__", path[-1] + " "))] = value
    elif action == 1:
        parent.insert(path[-1], value)
    else:
        parent[path[-1]] = value


def manifest(chance: random.Random, data: Sequence[bytes]) -> bytes:
    """Other values in ``bundle.json``."""
    parts = unpack(chance.choice(data))
    content = json.loads(parts["bundle.json"])
    for _ in range(chance.choice((1, 1, 1, 2, 4))):
        edit(chance, content, chance.choice(NASTY))
        if not content:
            break
    return pack({**parts, "bundle.json": json.dumps(content).encode()})


def manifest_text(chance: random.Random, data: Sequence[bytes]) -> bytes:
    """A ``bundle.json`` that is hardly JSON."""
    parts = unpack(chance.choice(data))
    text = parts["bundle.json"].decode()
    depth = chance.choice((10, 1000, 100_000, 1_000_000))
    nested = chance.choice(("[" * depth + "]" * depth, '{"a":' * depth + "1" + "}" * depth))
    at = chance.randrange(len(text))
    text = chance.choice(
        (
            text.replace('"recipe": {', f'"deep": {nested}, "recipe": {{'),
            text[:at] + nested + text[at:],
            text[:at] + chance.choice(("NaN", "Infinity", "-1e999", "9" * 10_000)) + text[at:],
            text.replace('"task"', '"task": "twice", "task"', 1),
            text[:at],
            "\ufeff" + text,
            text.encode("utf-16").decode("latin-1"),
        )
    )
    return pack({**parts, "bundle.json": text.encode("utf-8", "surrogatepass")})


def layers(chance: random.Random, data: Sequence[bytes]) -> bytes:
    """Other layers: absurd ones, too many, too large."""
    parts = unpack(chance.choice(data))
    content = json.loads(parts["bundle.json"])
    holder = chance.choice(content["pairs"]) if content.get("pairs") else content["fresh"]
    size = chance.choice((1, 2, 20, 64, 1024, 4096, 65_536, 2**20))
    small = chance.choice((1, 2, 64))
    made: list[dict[str, Any]] = [
        {"kind": "linear", "inputs": size, "outputs": chance.choice((1, 10, 65_536))},
        {"kind": "reshape", "shape": [1, 4, 5]},
        {"kind": "reshape", "shape": [chance.choice((1, 4096)), 4096, size]},
        {"kind": "resize", "rows": min(size, 4096), "columns": 4096},
        {"kind": "conv2d", "inputs": 1, "outputs": min(size, 4096), "kernel": small, "padding": 64},
        {"kind": "average_pool", "rows": min(size, 4096), "columns": min(size, 4096)},
        {"kind": "max_pool", "kernel": small},
        {"kind": "layer_norm", "shape": [min(size, 4096)]},
        {"kind": "batch_norm", "features": size},
        {"kind": "gelu"},
        {"kind": "flatten"},
        {"kind": "affine", "scale": chance.choice((1e300, 0.0, 3e38))},
    ]
    chosen = [chance.choice(made) for _ in range(chance.choice((1, 3, 10, 200)))]
    how = chance.randrange(5)
    if how == 0:
        holder["layers"] = chosen
    elif how == 1:
        holder["layers"] = [{"kind": "gelu"}] * chance.choice((127, 128, 5000)) + holder["layers"]
    elif how == 2:
        holder["layers"] = [{"kind": "residual", "layers": chosen}, *holder["layers"]]
    elif how == 3:
        # Resized to something large and back: it fits, and only the work is absurd.
        wide = [{"kind": "resize", "rows": min(size, 4096), "columns": 4096}, {"kind": "gelu"}]
        holder["layers"] = [
            {"kind": "reshape", "shape": [1, 4, 5]},
            *(wide * chance.choice((1, 20))),
            {"kind": "resize", "rows": 4, "columns": 5},
            {"kind": "flatten"},
            *holder["layers"],
        ]
    else:
        at = chance.randrange(len(holder["layers"]) + 1)
        holder["layers"][at:at] = chosen[:1]
    return pack({**parts, "bundle.json": json.dumps(content).encode()})


def header(chance: random.Random, data: Sequence[bytes]) -> bytes:
    """Another header of a safetensors part: shapes, offsets, types, its own length."""
    parts = unpack(chance.choice(data))
    name = chance.choice([part for part in sorted(parts) if part.endswith(".safetensors")])
    part = parts[name]
    (length,) = struct.unpack("<Q", part[:8])
    content, rest = json.loads(part[8 : 8 + length]), part[8 + length :]
    if chance.random() < 0.2:
        lie = chance.choice((0, 1, length - 1, length + 1, len(part), 2**32, 2**63, 2**64 - 1))
        return pack({**parts, name: struct.pack("<Q", lie) + part[8:]})
    value = chance.choice(
        (*NASTY, [2**31, 2**31], [2**62, 4], [0], [0, 2**62], "F64", "BF16", "I4")
    )
    edit(chance, content, value)
    text = json.dumps(content).encode()
    return pack({**parts, name: struct.pack("<Q", len(text)) + text + rest})


def numbers(chance: random.Random, data: Sequence[bytes]) -> bytes:
    """Other numbers in arrays: NaN, infinity, huge and tiny ones, another shape or type."""
    parts = unpack(chance.choice(data))
    name = chance.choice([part for part in sorted(parts) if part.endswith(".safetensors")])
    tensors = safetensors.torch.load(parts[name])
    key = chance.choice(sorted(tensors))
    tensor = tensors[key].clone()
    how = chance.randrange(5)
    if how == 0 and tensor.is_floating_point() and tensor.numel():
        value = chance.choice((math.nan, math.inf, -math.inf, 3e38, -1.0, 1e-45, 1e30))
        tensor.view(-1)[chance.randrange(tensor.numel())] = value
    elif how == 1 and tensor.is_floating_point():
        tensor = torch.full_like(tensor, chance.choice((3e38, -3e38, 1e25, 0.0, -0.0)))
    elif how == 2 and tensor.dtype == torch.uint8:
        tensor = torch.full_like(tensor, chance.choice((0, 63, 64, 255)))
    elif how == 3:
        tensor = chance.choice(
            (tensor[None], tensor.flatten(), tensor.double(), tensor.flatten()[:0])
        )
    else:
        tensor = torch.zeros(chance.choice(((0,), (1,), (9, 5), (2**20,), (784, 0), (784, 800))))
    changed = {**tensors, key: tensor.contiguous()}
    if chance.random() < 0.1:
        del changed[chance.choice(sorted(changed))]
    return pack({**parts, name: safetensors.torch.save(changed)})


def mixed(chance: random.Random, data: Sequence[bytes]) -> bytes:
    """Parts of both modes in one archive."""
    all_parts = [unpack(one) for one in data]
    names = sorted({name for parts in all_parts for name in parts})
    chosen = {}
    for name in names:
        options = [parts[name] for parts in all_parts if name in parts]
        if chance.random() < 0.9:
            chosen[name] = chance.choice(options)
    return pack(chosen)


MUTATIONS: tuple[Mutation, ...] = (
    *(
        flip,
        cut,
        splice,
        archive_parts,
        archive_fields,
        manifest,
        manifest_text,
        layers,
        header,
        numbers,
        mixed,
    ),
)


def kind(seed: int) -> Mutation:
    """How the file of this seed comes about."""
    return MUTATIONS[seed % len(MUTATIONS)]


def mutated(seed: int, data: Sequence[bytes]) -> bytes:
    """The file of this seed."""
    return kind(seed)(random.Random(seed), data)


def contents(bundle: Bundle) -> bytes:
    """A digest of all that a bundle holds, whatever file it was in."""
    found = hashlib.sha256(repr(dataclasses.replace(bundle, digest="")).encode())
    arrays = [pair.levels.tobytes() for pair in bundle.pairs]
    weights = [pair.weights for pair in bundle.pairs]
    if bundle.fresh is not None:
        fresh = bundle.fresh
        arrays += [getattr(fresh.distribution, name).tobytes() for name in ("lowest", "highest")]
        arrays += [getattr(fresh.statistics, name).numpy().tobytes() for name in ("mean", "basis")]
        weights.append(fresh.weights)
    for array in arrays:
        found.update(array)
    for one in weights:
        for name in sorted(one):
            found.update(name.encode() + one[name].numpy().tobytes())
    return found.digest()


def source_of(bundle: Bundle) -> MaskSource:
    """What the daemon would draw masks from."""
    if bundle.mode == "pairs":
        return load_pairs(bundle)
    return FreshSource(bundle, SECRET, form="white")


def use(source: MaskSource, bundle: Bundle) -> None:
    """Take a mask and read an embedding behind it, as the daemon does."""
    mask = source.make(1, "")
    if mask.levels.shape != bundle.camera.mask_shape or int(mask.levels.max()) > 63:
        raise RuntimeError("a mask that the panel cannot show")
    embedding = np.full(bundle.embedding.shape, 0.1, np.float32)
    try:
        verdict = mask.reader.classify(embedding)
    except InferenceError:
        return  # no label, and told so
    if verdict.label not in bundle.labels or not math.isclose(sum(verdict.scores.values()), 1):
        raise RuntimeError("a label that is none")


def try_one(path: Path, openers: Sequence[Opener], originals: Sequence[bytes]) -> str:
    """Read the file, and use it if it is not refused; tell what came of it."""
    for opener in openers:
        try:
            bundle = opener.read(path)
            opener.load(bundle)
        except (KeyringInvalidError, KeyringUnfitError) as error:
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
        keyring = await service.keyrings.install(chunks())
        assert keyring.bundle is not None
        if service.status().bundle != before or service.rotation().epoch != epoch:
            return "what was only sent is in use"
        await service.activate_keyring(keyring.digest)
        wanted, epoch = keyring.bundle, service.rotation().epoch
    except ProblemError:
        pass
    if service.status().bundle != wanted or service.rotation().epoch != epoch:
        return "another keyring or mask is in use"
    try:
        result = await service.classify(include_embedding=False)
    except InferenceError:
        result = None
    if result is not None and (result.label not in wanted.labels or result.epoch != epoch):
        return "another mask or label than those in use"
    if wanted != before:
        await service.activate_keyring(before.digest)
        await service.keyrings.remove(wanted.digest)
    return None if service.status().bundle == before else "the keyring before did not come back"


def serve_child(connection: Connection, seeds: Sequence[int], data: Sequence[bytes]) -> None:
    """:func:`try_service` in a process of its own."""
    torch.set_num_threads(1)
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(50))
    with tempfile.TemporaryDirectory(prefix="veilcam-") as work:
        connection.send(asyncio.run(try_service(seeds, data, Path(work))))


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
    figures: Annotated[Path | None, typer.Option(help="Record to write figures into.")] = None,
) -> None:
    """Look for files that crash, hang, fill the memory, or change what runs."""
    torch.set_num_threads(1)
    seeds = range(seed, seed + files)
    with tempfile.TemporaryDirectory(prefix="veilcam-") as temporary:
        work = Path(temporary)
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
    if figures is not None:
        record_figures(figures, {"bundle_fuzz_crashes": len(failures)})
    if failures:
        raise SystemExit(1)


if __name__ == "__main__":
    typer.run(main)
