"""Mutations of bundles: bits, files, archives, headers, layers and weights, each from its seed."""

from __future__ import annotations

import copy
import hashlib
import json
import math
import random
import struct
import zipfile
from collections.abc import Callable, Iterator, Sequence
from io import BytesIO
from typing import Any

import safetensors.torch
import torch

Parts = dict[str, bytes]
Mutation = Callable[[random.Random, Sequence[bytes]], bytes]


def unpack(data: bytes) -> Parts:
    with zipfile.ZipFile(BytesIO(data)) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def pack(parts: Parts, compression: int = zipfile.ZIP_DEFLATED) -> bytes:
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


def tensors_of(chance: random.Random, data: Sequence[bytes]) -> tuple[Parts, str]:
    parts = unpack(chance.choice(data))
    return parts, chance.choice([part for part in sorted(parts) if part.endswith(".safetensors")])


def with_manifest(parts: Parts, content: object) -> bytes:
    return pack({**parts, "bundle.json": json.dumps(content).encode()})


def flip(chance: random.Random, data: Sequence[bytes]) -> bytes:
    flipped = bytearray(chance.choice(data))
    for _ in range(chance.choice((1, 1, 2, 8, 64))):
        flipped[chance.randrange(len(flipped))] ^= 1 << chance.randrange(8)
    return bytes(flipped)


def cut(chance: random.Random, data: Sequence[bytes]) -> bytes:
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
    yield path
    if isinstance(content, dict):
        for key, value in content.items():
            yield from places(value, (*path, key))
    elif isinstance(content, list):
        for index, value in enumerate(content):
            yield from places(value, (*path, index))


def edit(chance: random.Random, content: Any, value: Any) -> None:
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
        parent[chance.choice(("surprise", "__proto__", f"{path[-1]} "))] = value
    elif action == 1:
        parent.insert(path[-1], value)
    else:
        parent[path[-1]] = value


def manifest(chance: random.Random, data: Sequence[bytes]) -> bytes:
    parts = unpack(chance.choice(data))
    content = json.loads(parts["bundle.json"])
    for _ in range(chance.choice((1, 1, 1, 2, 4))):
        edit(chance, content, chance.choice(NASTY))
        if not content:
            break
    return with_manifest(parts, content)


def manifest_text(chance: random.Random, data: Sequence[bytes]) -> bytes:
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
    parts = unpack(chance.choice(data))
    content = json.loads(parts["bundle.json"])
    holder = chance.choice(content["pairs"]) if content.get("pairs") else content["fresh"]
    size = chance.choice((1, 2, 20, 64, 1024, 4096, 65_536, 2**20))
    small = chance.choice((1, 2, 64))
    side = min(size, 4096)
    flat, gelu = {"kind": "flatten"}, {"kind": "gelu"}
    shaped: dict[str, Any] = {"kind": "reshape", "shape": [1, 4, 5]}
    resize: dict[str, Any] = {"kind": "resize", "rows": side, "columns": 4096}
    made: list[dict[str, Any]] = [
        *(flat, gelu, shaped, resize, {"kind": "max_pool", "kernel": small}),
        {"kind": "linear", "inputs": size, "outputs": chance.choice((1, 10, 65_536))},
        {"kind": "reshape", "shape": [chance.choice((1, 4096)), 4096, size]},
        {"kind": "conv2d", "inputs": 1, "outputs": side, "kernel": small, "padding": 64},
        {"kind": "global_max_pool"},
        *({"kind": "layer_norm", "shape": [side]}, {"kind": "batch_norm", "features": size}),
        {"kind": "affine", "scale": chance.choice((1e300, 0.0, 3e38))},
    ]
    chosen = [chance.choice(made) for _ in range(chance.choice((1, 3, 10, 200)))]
    how = chance.randrange(5)
    if how == 0:
        holder["layers"] = chosen
    elif how == 1:
        holder["layers"] = [gelu] * chance.choice((127, 128, 5000)) + holder["layers"]
    elif how == 2:
        holder["layers"] = [{"kind": "residual", "layers": chosen}, *holder["layers"]]
    elif how == 3:
        # Resized to something large and back: it fits, and only the work is absurd.
        wide, back = [resize, gelu] * chance.choice((1, 20)), {**resize, "rows": 4, "columns": 5}
        holder["layers"] = [shaped, *wide, back, flat, *holder["layers"]]
    else:
        at = chance.randrange(len(holder["layers"]) + 1)
        holder["layers"][at:at] = chosen[:1]
    return with_manifest(parts, content)


def header(chance: random.Random, data: Sequence[bytes]) -> bytes:
    """Another header of a safetensors part: shapes, offsets, types, its own length."""
    parts, name = tensors_of(chance, data)
    part = parts[name]
    (length,) = struct.unpack("<Q", part[:8])
    content, rest = json.loads(part[8 : 8 + length]), part[8 + length :]
    if chance.random() < 0.2:
        lie = chance.choice((0, 1, length - 1, length + 1, len(part), 2**32, 2**63, 2**64 - 1))
        return pack({**parts, name: struct.pack("<Q", lie) + part[8:]})
    odd = ([2**31, 2**31], [2**62, 4], [0], [0, 2**62], "F64", "BF16", "I4")
    edit(chance, content, chance.choice((*NASTY, *odd)))
    text = json.dumps(content).encode()
    return pack({**parts, name: struct.pack("<Q", len(text)) + text + rest})


def numbers(chance: random.Random, data: Sequence[bytes]) -> bytes:
    """Other numbers in arrays: NaN, infinity, huge and tiny ones, another shape or type."""
    parts, name = tensors_of(chance, data)
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
        flat = tensor.flatten()
        tensor = chance.choice((tensor[None], flat, tensor.double(), flat[:0]))
    else:
        tensor = torch.zeros(chance.choice(((0,), (1,), (9, 5), (2**20,), (784, 0), (784, 800))))
    changed = {**tensors, key: tensor.contiguous()}
    if chance.random() < 0.1:
        del changed[chance.choice(sorted(changed))]
    return pack({**parts, name: safetensors.torch.save(changed)})


def mixed(chance: random.Random, data: Sequence[bytes]) -> bytes:
    all_parts = [unpack(one) for one in data]
    names = sorted({name for parts in all_parts for name in parts})
    chosen = {}
    for name in names:
        options = [parts[name] for parts in all_parts if name in parts]
        if chance.random() < 0.9:
            chosen[name] = chance.choice(options)
    return pack(chosen)


MUTATIONS: tuple[Mutation, ...] = (
    *(flip, cut, splice, archive_parts, archive_fields, manifest, manifest_text),
    *(layers, header, numbers, mixed),
)


def kind(seed: int) -> Mutation:
    return MUTATIONS[seed % len(MUTATIONS)]


def mutated(seed: int, data: Sequence[bytes]) -> bytes:
    return kind(seed)(random.Random(seed), data)
