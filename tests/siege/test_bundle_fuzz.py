"""The fuzzing of bundles, made short; and that it would notice a failure."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from tests.siege import bundle_fuzz as fuzz
from tests.siege.mutations import MUTATIONS, mutated
from tests.siege.samples import make_bundles

from veilcam_training.bundle import write_bundle

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    path = tmp_path_factory.mktemp("bundles") / "a.veilcam"
    made = []
    with torch.random.fork_rng():
        bundles = make_bundles()
    for bundle in bundles:
        write_bundle(path, bundle)
        made.append(path.read_bytes())
    return made


@pytest.mark.slow
def test_mutated_bundles_do_no_harm(tmp_path: Path) -> None:
    figures = tmp_path / "figures.json"
    result = subprocess.run(
        [
            *(sys.executable, "-m", "tests.siege.bundle_fuzz", "--files", "200", "--live", "20"),
            *("--figures", str(figures)),
        ],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    assert json.loads(figures.read_text())["bundle_fuzz_crashes"]["value"] == 0
    counted = result.stdout.partition("200 files: ")[2].partition(";")[0].split(", ")
    counts = {name: int(count) for count, name in (part.split() for part in counted)}
    assert counts["refused"] > 100
    assert counts["same"] > 0


def test_every_seed_gives_the_same_file_again(data: list[bytes]) -> None:
    for seed in range(len(MUTATIONS)):
        assert mutated(seed, data) == mutated(seed, data)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("harm", "word"),
    [
        ("raise ValueError('secret')", "ValueError"),
        ("import os; os._exit(11)", "the process died"),
        ("import time; time.sleep(60)", "over"),
        ("bytearray(2**33)", "MemoryError"),
    ],
)
def test_harm_is_noticed(
    *,
    data: list[bytes],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    harm: str,
    word: str,
) -> None:
    def do_harm(*_: object) -> str:
        exec(harm)
        return "refused"

    monkeypatch.setattr(fuzz, "try_one", do_harm)
    monkeypatch.setattr(fuzz, "SLOW", 2.0)
    outcome = fuzz.try_all([3], data, tmp_path)
    assert outcome.results == {"crash": 1}
    assert word in outcome.failures[0]
