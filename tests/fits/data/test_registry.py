"""A data set is a file and one line in the registry: all commands know it then."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pytest
import torch
from tests.fits.conftest import Call

from veilcam_optics.camera.geometry import Scene
from veilcam_training.bundle import read_bundle
from veilcam_training.data import Images, Source, registry
from veilcam_training.data.base import digest, find


@dataclass(frozen=True)
class StripesSource:
    """Upright and lying stripes in one raw file: a label byte and 64 bytes of pixels each."""

    folder: Path
    name: str = "stripes"
    labels: tuple[str, ...] = ("upright", "lying")
    scene: Scene = field(default_factory=lambda: Scene(8, 8))
    colour: bool = False

    @property
    def path(self) -> Path:
        return find(self.folder / "stripes.bin")

    def training(self) -> Images:
        return self._read(slice(0, 40))

    def test(self) -> Images:
        return self._read(slice(40, 60))

    def digests(self) -> Mapping[str, str]:
        return {self.path.name: digest(self.path)}

    def _read(self, part: slice) -> Images:
        records = torch.frombuffer(bytearray(self.path.read_bytes()), dtype=torch.uint8)
        records = records.reshape(-1, 65)[part]
        return Images(records[:, 1:].reshape(-1, 8, 8), records[:, 0].long())


def write_stripes(folder: Path) -> None:
    stripes = torch.tensor([255, 0]).repeat(4).expand(8, 8)
    records = [
        torch.cat([torch.tensor([label]), (stripes.T if label else stripes).flatten()])
        for label in (0, 1) * 30
    ]
    (folder / "stripes.bin").write_bytes(torch.stack(records).to(torch.uint8).numpy().tobytes())


def test_new_data_set_is_used(call: Call, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(registry, "SOURCES", {**registry.SOURCES, "stripes": StripesSource})
    write_stripes(tmp_path)
    command = f"fit --data {tmp_path} --dataset stripes --embedding 6x8 --seed 0"
    options = f"--epochs 20 --batch 12 --device cpu --out {tmp_path / 'run'}"
    call(*f"{command} {options}".split())
    bundle = read_bundle(tmp_path / "run" / "model.veilcam")
    source: Source = StripesSource(tmp_path)
    assert (bundle.labels, bundle.scene) == (source.labels, source.scene)
    assert bundle.provenance["data_sha256"] == source.digests()
    assert bundle.accuracy is not None
    assert bundle.accuracy.samples == 20
    # Who guesses is right on 18 of 20 with a probability of 2e-4.
    assert bundle.accuracy.value >= 0.9
