"""The parts of a bundle's file, and how one that is wrong is refused."""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import safetensors.torch
import torch

from veilcam_training.bundle import BundleError, read_bundle


def unpack(path: Path) -> dict[str, bytes]:
    """dict[str, bytes] of a file by name."""
    with zipfile.ZipFile(path) as file:
        return {name: file.read(name) for name in file.namelist()}


def pack(path: Path, parts: dict[str, bytes]) -> None:
    """Write a file of these parts."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, data in parts.items():
            file.writestr(name, data)


def edit_manifest(path: Path, edit: Callable[[dict[str, Any]], None]) -> None:
    """Change what ``bundle.json`` says."""
    parts = unpack(path)
    manifest = json.loads(parts["bundle.json"])
    edit(manifest)
    pack(path, {**parts, "bundle.json": json.dumps(manifest).encode()})


def replace_part(path: Path, name: str, data: bytes) -> None:
    """Put another part in place, with its right digest: only the content is wrong."""
    pack(path, {**unpack(path), name: data})
    edit_manifest(path, lambda m: m["parts"].update({name: hashlib.sha256(data).hexdigest()}))


def edit_tensors(path: Path, part: str, edit: Callable[[dict[str, torch.Tensor]], object]) -> None:
    """Change the tensors of a part."""
    name = f"{part}.safetensors"
    tensors = safetensors.torch.load(unpack(path)[name])
    edit(tensors)
    replace_part(
        path, name, safetensors.torch.save({n: t.contiguous() for n, t in tensors.items()})
    )


def refuse(path: Path, reason: str) -> None:
    """See it refused in one line that names the file and the reason."""
    with pytest.raises(BundleError, match=reason) as caught:
        read_bundle(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
