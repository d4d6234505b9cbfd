"""A daemon without torch: its memory, its start, and whether it reads what torch does.

    python -m benchmarks.deploy.memory device --figures benchmarks/results/deploy.json
    python -m benchmarks.deploy.memory simulate --figures benchmarks/results/deploy.json

``device`` runs :mod:`benchmarks.deploy.device_path` for both bundles of the demonstration, with
NumPy and with torch in turn, and takes the median of its rounds: all on one core. Then it compares,
mask by mask, the labels that both libraries read from simulated measurements.
``simulate`` lets simulated daemons take captures, and says how much memory they had at most, their
start and all that a capture takes meanwhile included. It records that every now and then: a run
that ends early has said how far it came.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from statistics import median
from typing import Annotated

import numpy as np
import torch
import typer
from benchmarks.deploy.device_path import Taken
from benchmarks.figures import FiguresOption, record
from benchmarks.rig import work_folder

from veilcam_client import Camera
from veilcam_client.keys.epoch_key import EpochKey
from veilcam_optics.camera.masks import to_weights
from veilcam_optics.decoding import Precision
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_server.demo.daemon import running
from veilcam_server.demo_data import BUNDLE, FRESH, load_digits
from veilcam_server.devices.simulated.scenes import write_scene
from veilcam_server.masks.fresh import FreshSource
from veilcam_server.masks.pairs import load_pairs
from veilcam_training.bundle import Bundle, classifier_inputs, read_bundle
from veilcam_training.models.network import build_classifier

BEHIND = 100
"""Captures behind one mask, where libraries are compared."""

app = typer.Typer(pretty_exceptions_enable=False)


def path(mode: str, *options: str) -> Taken:
    """The device path in a process of its own."""
    command = [sys.executable, "-m", "benchmarks.deploy.device_path", mode, *options]
    one = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=one)
    return Taken(**json.loads(done.stdout))


def key_of(number: int, bundle: Bundle) -> EpochKey:
    """A key that comes again in every run."""
    return EpochKey(number.to_bytes(32, "big"), device="d7" * 32, bundle=bundle.digest)


class Comparison:
    """What differs between both libraries, over all captures so far."""

    def __init__(self, captures: int) -> None:
        self.captures, self.generator = captures, torch.Generator().manual_seed(0)
        self.scenes = torch.from_numpy(load_digits().images / np.float32(255))
        self.labels, self.count = 0, 0

    def measured(self, transfer: torch.Tensor, shape: tuple[int, int]) -> torch.Tensor:
        """Measurements of digits behind a mask, with noise."""
        some = torch.randint(len(self.scenes), (BEHIND,), generator=self.generator)
        clean = self.scenes[some].flatten(1) @ transfer
        return shot_noise(clean, 40.0, self.generator).reshape(BEHIND, *shape)

    def add(self, labels: list[int], wanted: torch.Tensor) -> None:
        """Count labels that differ."""
        self.labels += sum(one != other for one, other in zip(labels, wanted.tolist(), strict=True))
        self.count += len(labels)

    def fresh(self, bundle: Bundle) -> None:
        """Compare readers of fresh masks."""
        fresh, source = bundle.fresh, FreshSource(bundle)
        assert fresh is not None
        frame = fresh.frame(bundle.camera, bundle.scene, bundle.embedding).in_torch()
        decoding = frame.decoding(precision=Precision.DOUBLE)
        network = build_classifier(fresh.layers, fresh.weights)
        for number in range(self.captures // BEHIND):
            key = key_of(number, bundle)
            mask = source.make(key, frozenset())
            weights = frame.shown(mask.levels)
            decoder = decoding.prepare(weights)
            transfer = decoding.operator(weights.double()).float()
            seen = self.measured(transfer, bundle.embedding.shape)
            labels = [mask.reader.classify(one).label for one in seen.numpy()]
            logits = network(classifier_inputs(decoder, seen).float())
            self.add([bundle.labels.index(label) for label in labels], logits.argmax(1))

    def pairs(self, bundle: Bundle) -> None:
        """Compare readers of stored masks."""
        source = load_pairs(bundle)
        readers = {mask.levels.tobytes(): mask.reader for mask in source._masks}  # noqa: SLF001
        networks = [build_classifier(pair.layers, pair.weights) for pair in bundle.pairs]
        operator = TransferOperator(bundle.camera, bundle.scene, bundle.embedding)
        for number in range(self.captures // BEHIND):
            place = number % len(networks)
            levels = bundle.pairs[place].levels
            weights = torch.from_numpy(to_weights(levels, bundle.camera.panel))
            seen = self.measured(operator(weights), bundle.embedding.shape)
            reader = readers[levels.tobytes()]
            labels = [reader.classify(one).label for one in seen.numpy()]
            logits = networks[place](seen.flatten(1))
            self.add([bundle.labels.index(label) for label in labels], logits.argmax(1))


def ratio_of_preparing(bundle: Bundle, rounds: int) -> float:
    """CPU time in which NumPy prepares a fresh mask, over that of torch; in turn, medians."""
    assert bundle.fresh is not None
    frame = bundle.fresh.frame(bundle.camera, bundle.scene, bundle.embedding)
    in_numpy = frame.decoding(precision=Precision.DOUBLE)
    in_torch = frame.in_torch().decoding(precision=Precision.DOUBLE)
    levels = np.random.default_rng(0).integers(0, 64, (rounds, *bundle.camera.mask_shape), np.uint8)

    taken: list[tuple[float, float]] = []
    for each in levels:
        weights = frame.shown(each)
        tensor = torch.from_numpy(weights)
        begun = time.process_time()
        in_numpy.prepare(weights)
        between = time.process_time()
        in_torch.prepare(tensor)
        taken.append((between - begun, time.process_time() - between))
    ours, theirs = (median(pair[k] for pair in taken) for k in (0, 1))
    print(f"a fresh mask is prepared in {1e3 * ours:.1f} ms, by torch in {1e3 * theirs:.1f} ms")
    return ours / theirs


@app.command()
def device(
    *,
    captures: Annotated[int, typer.Option(min=BEHIND, help="That are compared.")] = 10_000,
    rounds: Annotated[int, typer.Option(min=1, help="Of every process.")] = 5,
    figures: FiguresOption = None,
) -> None:
    """Measure the device path, and compare what it reads with what torch reads."""
    torch.set_num_threads(1)
    values: dict[str, float] = {}
    for mode in ("fresh", "pairs"):
        both = [(path(mode), path(mode, "--with-torch")) for _ in range(rounds)]
        for name, unit in (("rss_mib", "MiB"), ("peak_mib", "MiB"), ("ready_s", "s")):
            ours, theirs = (median(getattr(pair[k], name) for pair in both) for k in (0, 1))
            print(f"{mode}, {name}: {ours:.2f} {unit}, with torch {theirs:.2f} {unit}")
            if name == "rss_mib":
                values |= {f"rss_{mode}_mib": ours, f"rss_{mode}_torch_mib": theirs}
            if name == "ready_s":
                values["ready_cpu_s"] = max(ours, values.get("ready_cpu_s", 0.0))
                values["ready_torch_cpu_s"] = max(theirs, values.get("ready_torch_cpu_s", 0.0))
    fresh, pairs = read_bundle(FRESH), read_bundle(BUNDLE)
    comparison = Comparison(captures)
    with torch.inference_mode():
        values["prepare_numpy_over_torch"] = ratio_of_preparing(fresh, 10 * rounds)
        comparison.fresh(fresh)
        comparison.pairs(pairs)
    print(f"{comparison.labels} labels of {comparison.count} captures differ")
    values["numpy_torch_labels_that_differ"] = comparison.labels
    record(figures, values)


def peak_mb(process: int) -> float:
    """Resident memory of a process when it had most [MB]."""
    status = Path(f"/proc/{process}/status").read_text().splitlines()
    [peak] = [int(line.split()[1]) for line in status if line.startswith("VmHWM")]
    return peak * 1024 / 1e6


@app.command()
def simulate(
    *,
    captures: Annotated[int, typer.Option(min=1, help="Of each mode.")] = 5000,
    figures: FiguresOption = None,
) -> None:
    """Let simulated daemons take captures, and ask for their memory at its peak."""
    peaks: list[float] = []
    for mode, bundle in (("fresh", FRESH), ("pairs", BUNDLE)):
        with work_folder() as folder:
            scene = folder / "scene.npy"
            write_scene(scene, load_digits().images[0])
            prompt = ("--settle", "0", "--exposure", "0")
            with running(bundle, scene, folder, *prompt) as url, Camera(url) as camera:
                process = _child()
                for number in range(1, captures + 1):
                    camera.classify()
                    if number % max(1, captures // 50) == 0 or number == captures:
                        peak = peak_mb(process)
                        print(f"{mode}, {number} captures: at most {peak:.0f} MB", flush=True)
                        values = {f"simulate_{mode}_mb": peak, f"simulate_{mode}_captures": number}
                        record(figures, values)
                peaks.append(peak_mb(process))
    record(figures, {"simulate_rss_mb": max(peaks)})


def _child() -> int:
    """The only process that this one started and that still runs."""
    [child] = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    return int(child)


if __name__ == "__main__":
    app()
