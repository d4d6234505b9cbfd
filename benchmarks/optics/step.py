"""What the transfer operator saves against waveprop, and what a learned mask costs.

One run measures, with one thread and the contestants taking turns:

- the transfer matrix of a mask (784 scene pixels to 24 x 32), against waveprop's PSF and FFT
  convolution of a *single* scene, with both errors against converged references;
- a training step of FC-800 behind a learned mask (batch 64), against the same step with waveprop
  as the encoder, differentiated through to the mask;
- the step with a learned mask against one with a fixed mask, whose measurements were all computed
  beforehand, at batch 512;
- the same ratio of their dense products of matrices alone, which no way of writing a step that
  computes these gradients goes below: a learned mask encodes each batch (scenes times transfer) and
  asks for the transfer's gradient (scenes times gradients), and both grow with the batch;
- the peak memory of the learned-mask training step, in a process of its own.

waveprop must be installed (docs/accuracy.md says how); without it its figures are left out.

Scenes are MNIST's digits: the operator leaves out pixels that are black in a whole batch.

    python -m benchmarks.optics.step --data data/mnist --figures benchmarks/results/optics.json
"""

from __future__ import annotations

import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated

import torch
import typer
from benchmarks.figures import FiguresOption, record
from torch import Tensor, nn
from torch.nn.functional import cross_entropy

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.accuracy.measure import example_mask, relative_error
from benchmarks.accuracy.reference import reference_transfer
from benchmarks.peers.waveprop_peer import WavepropCamera

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.camera.masks import quantise, random_mask
from veilcam_optics.sensor.noise import shot_noise
from veilcam_optics.transfer.kernels import Approximation
from veilcam_optics.transfer.operator import TransferOperator
from veilcam_training.data import open_source

SNR_DB = 40.0
IMAGES = 1024

Encode = Callable[[Tensor, Tensor], Tensor]
"""From images, in whatever form, and mask weights to noiseless embeddings (batch, 768)."""


class Trainer:
    """FC-800 behind a camera, ready to take real training steps.

    Args:
        images: what ``encode`` takes; the first axis is the image.
        encode: the camera.
        learned: whether the mask gets gradients.
    """

    def __init__(self, images: Tensor, encode: Encode, *, learned: bool) -> None:
        torch.manual_seed(0)
        self.images, self.encode, self.panel = images, encode, Camera().panel
        self.labels = torch.randint(0, 10, (len(images),))
        self.weights = random_mask(Camera(), torch.Generator().manual_seed(0))
        self.weights.requires_grad_(learned)
        self.head = nn.Sequential(
            nn.BatchNorm1d(768),
            nn.Linear(768, 800, bias=False),
            nn.BatchNorm1d(800),
            nn.ReLU(),
            nn.Linear(800, 10),
        )
        parameters = [*self.head.parameters(), *([self.weights] if learned else [])]
        self.optimiser = torch.optim.Adam(parameters, lr=1e-3, fused=True)

    def step(self, batch: int) -> None:
        """Gather, show the mask at the panel's levels, encode, noise, classify, backward, Adam."""
        chosen = torch.randperm(len(self.images))[:batch]
        embeddings = self.encode(self.images[chosen], quantise(self.weights, self.panel))
        logits = self.head(shot_noise(embeddings, SNR_DB))
        self.optimiser.zero_grad()
        cross_entropy(logits, self.labels[chosen]).backward()  # type: ignore[no-untyped-call]
        self.optimiser.step()
        with torch.no_grad():
            self.weights.clamp_(0, 1)


def some_images(data: Path) -> Tensor:
    """The first digits of MNIST."""
    return open_source("mnist", data).training().scenes(slice(0, IMAGES))


def by_transfer() -> Encode:
    """Our camera."""
    operator = TransferOperator(Camera(), Scene(), Embedding())
    return lambda scenes, weights: operator.embed(scenes, weights).flatten(1)


def take_turns(
    runs: Mapping[str, tuple[Callable[[], object], int]], rounds: int
) -> dict[str, float]:
    """Median time [s] of each run, every round timing each of them as often as it says.

    Whatever else the machine does meets all of them alike.
    """
    for run, _ in runs.values():
        run()
        run()
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(rounds):
        for name, (run, repeats) in runs.items():
            for _ in range(repeats):
                start = time.perf_counter()
                run()
                times[name].append(time.perf_counter() - start)
    return {name: statistics.median(values) for name, values in times.items()}


def transfer_error(weights: Tensor) -> float:
    """Error of the default operator against the converged reference."""
    camera, scene, embedding = Camera(), Scene(), Embedding()
    truth = reference_transfer(camera, scene, embedding, weights.double())
    return relative_error(
        TransferOperator(camera, scene, embedding, approximation=Approximation(axial=True))(
            weights
        ),
        truth,
    )


def registered_peer(weights: Tensor) -> tuple[WavepropCamera, float]:
    """The peer, aligned with its reference as well as can be, and the error that is left."""
    peer = WavepropCamera(Camera(), Scene(), Embedding())
    truth = reference_transfer(
        peer.own_camera, peer.scene, peer.embedding, weights.double(), oversampling=20
    )
    scenes = torch.rand(4, *peer.scene.shape, generator=torch.Generator().manual_seed(0))
    planes = peer.object_planes(scenes)
    with torch.no_grad():
        wanted = scenes.flatten(1).double() @ truth
        peer.register(weights, lambda psf: peer.embed(planes, psf), wanted)
        return peer, relative_error(peer.transfer(weights), truth, free_factor=True)


def compare_transfer(peer: WavepropCamera, weights: Tensor, rounds: int) -> float:
    """Time of waveprop for one scene over ours for the whole matrix."""
    operator = TransferOperator(peer.camera, peer.scene, peer.embedding)
    plane = peer.object_planes(torch.rand(1, *peer.scene.shape))
    with torch.no_grad():
        medians = take_turns(
            {
                "transfer operator": (lambda: operator(weights), 20),
                "waveprop": (lambda: peer.embed(plane, peer.psf(weights)), 1),
            },
            rounds,
        )
    return _ratio(medians, "waveprop", "transfer operator")


def compare_steps(peer: WavepropCamera, images: Tensor, rounds: int) -> float:
    """Learned-mask step of waveprop over ours, batch 64.

    The object planes of waveprop are computed beforehand and held: not part of its step.
    """
    ours = Trainer(images, by_transfer(), learned=True)
    planes = peer.object_planes(images[:128])
    theirs = Trainer(
        planes, lambda some, weights: peer.embed(some, peer.psf(weights)), learned=True
    )
    medians = take_turns(
        {
            "learned mask, batch 64": (lambda: ours.step(64), 10),
            "learned mask through waveprop, batch 64": (lambda: theirs.step(64), 1),
        },
        rounds,
    )
    return _ratio(medians, "learned mask through waveprop, batch 64", "learned mask, batch 64")


def compare_masks(images: Tensor, rounds: int) -> float:
    """A learned-mask step over a fixed-mask step, batch 512.

    The noiseless measurements of a fixed mask are computed once for all epochs: its step encodes
    nothing.
    """
    learned = Trainer(images, by_transfer(), learned=True)
    with torch.no_grad():
        transfer = TransferOperator(Camera(), Scene(), Embedding())(learned.weights)
        measurements = images.flatten(1) @ transfer
    fixed = Trainer(measurements, lambda some, _: some, learned=False)
    medians = take_turns(
        {
            "learned mask, batch 512": (lambda: learned.step(512), 1),
            "fixed mask, batch 512": (lambda: fixed.step(512), 1),
        },
        10 * rounds,
    )
    return _ratio(medians, "learned mask, batch 512", "fixed mask, batch 512")


def compare_products(images: Tensor, rounds: int, batch: int = 512) -> float:
    """As :func:`compare_masks`, of nothing but the products of matrices that both steps need.

    Of the scenes count the pixels that are lit in the batch, of the mask the one product that
    gathers the pairs along y, forward and backward. The first layer's inputs are normalised with
    factors that are learned, so that a fixed mask's step needs their gradient, too.
    """
    camera, scene, embedding = Camera(), Scene(), Embedding()
    lit = int(images[:batch].any(0).sum())
    rows, offsets_y = camera.window.rows, scene.rows * embedding.rows
    offsets_x, pixels = scene.columns * embedding.columns, embedding.size
    hidden = 800
    fixed = [(batch, pixels, hidden), (pixels, batch, hidden), (batch, hidden, pixels)]
    learned = [(batch, lit, pixels), (lit, batch, pixels)]
    learned += [(offsets_y, rows, offsets_x), (rows, offsets_y, offsets_x)]
    medians = take_turns(
        {
            "products, learned mask, batch 512": (_products(fixed + learned), 1),
            "products, fixed mask, batch 512": (_products(fixed), 1),
        },
        10 * rounds,
    )
    return _ratio(medians, "products, learned mask, batch 512", "products, fixed mask, batch 512")


def _products(shapes: Sequence[tuple[int, int, int]]) -> Callable[[], object]:
    """What multiplies matrices (a, b) and (b, c), all of them."""
    factors = [(torch.rand(a, b), torch.rand(b, c), torch.empty(a, c)) for a, b, c in shapes]
    return lambda: [torch.mm(one, other, out=product) for one, other, product in factors]


def _ratio(medians: dict[str, float], over: str, under: str) -> float:
    for name, seconds in medians.items():
        print(f"{name:42s} {1e3 * seconds:10.2f} ms")
    return medians[over] / medians[under]


def peak_memory(data: Path) -> float:
    """Peak resident memory [MB] of a fresh process that trains with a learned mask."""
    found = subprocess.run(
        [sys.executable, __file__, "--data", str(data), "--only-train"],
        check=True,
        capture_output=True,
        text=True,
    )
    return float(found.stdout)


def train_and_tell_peak(data: Path) -> None:
    """Take learned-mask steps at batch 64 and print this process's peak memory [MB]."""
    trainer = Trainer(some_images(data), by_transfer(), learned=True)
    for _ in range(30):
        trainer.step(64)
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3)


def main(
    *,
    data: Annotated[Path, typer.Option(help="Folder with MNIST's four idx files.")],
    rounds: Annotated[int, typer.Option(min=1, help="Turns that everyone takes.")] = 9,
    figures: FiguresOption = None,
    only_train: Annotated[bool, typer.Option("--only-train", hidden=True)] = False,
) -> None:
    """Print every figure; record them."""
    torch.set_num_threads(1)
    if only_train:
        train_and_tell_peak(data)
        return
    # First of all: a child's peak counts from that of the process it was forked from.
    values = {"step_peak_rss_mb": peak_memory(data)}
    images = some_images(data)
    weights = example_mask(Camera()).float()
    values["transfer_error"] = transfer_error(weights)
    try:
        peer, values["transfer_error_waveprop"] = registered_peer(weights)
    except ImportError as reason:
        print(f"waveprop is not installed, its figures are left out: {reason}")
    else:
        values["transfer_time_waveprop_over_ours"] = compare_transfer(peer, weights, rounds)
        values["step_time_waveprop_over_ours"] = compare_steps(peer, images, rounds)
    values["step_ratio_learned_over_fixed_b512"] = compare_masks(images, rounds)
    values["step_products_learned_over_fixed_b512"] = compare_products(images, rounds)
    for name, value in values.items():
        print(f"{name:42s} {value:10.3g}")
    record(figures, {name: float(f"{value:.4g}") for name, value in values.items()})


if __name__ == "__main__":
    typer.run(main)
