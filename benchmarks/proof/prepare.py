"""What the proof of the mask costs: preparing its test beside a decoder, and testing a capture.

One thread; the contestants take turns, so that what slows the machine slows both. A capture is
tested against all alternatives, with 2 % of its bins clipped.

    python -m benchmarks.proof.prepare --figures benchmarks/results/proof.json
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

import numpy as np
import torch
import typer
from benchmarks.figures import FiguresOption, record

from veilcam_optics.keys.masks import draw_levels
from veilcam_optics.proof import PROOF, MaskTests
from veilcam_server.demo_data import FRESH
from veilcam_training.bundle import read_bundle

ROUNDS = 15
CAPTURES = 40


def main(*, figures: FiguresOption = None) -> None:
    """Print and record what it costs."""
    torch.set_num_threads(1)
    bundle = read_bundle(FRESH)
    if bundle.fresh is None:
        raise typer.BadParameter("the bundle has no fresh masks")
    frame = bundle.fresh.frame(bundle.camera, bundle.scene, bundle.embedding)
    levels = [
        draw_levels(bytes([number] * 32), camera=bundle.camera, distribution=frame.distribution)
        for number in (1, 2)
    ]
    decoding, tests = frame.decoding(), MaskTests(bundle.camera)
    before = [tests.prepare(each) for each in levels]

    def decoder() -> None:
        with torch.inference_mode():
            decoding.prepare(frame.shown(levels[1]))

    def test() -> None:
        tests.prepare(levels[1])

    decoders, proofs = [], []
    for _ in range(ROUNDS):
        decoders.append(_seconds(decoder))
        proofs.append(_seconds(test))
    chance = np.random.default_rng(0)
    prepared = tests.prepare(levels[1])
    capture = (0.1 + 0.01 * chance.random(PROOF.shape)).astype(np.float32)
    clipped = chance.random(PROOF.shape) < 0.02
    rounds = [
        [_seconds(lambda: prepared.find(capture, clipped, before)) for _ in range(CAPTURES)]
        for _ in range(ROUNDS)
    ]
    values = {
        "proof_prepare_over_before": 1 + statistics.median(proofs) / statistics.median(decoders),
        # Of the round that was disturbed least, as timeit has it.
        "proof_capture_ms": 1e3 * min(statistics.median(each) for each in rounds),
    }
    print(f"decoder {1e3 * statistics.median(decoders):.1f} ms")
    for name, value in values.items():
        print(f"{name} {value:.3f}")
    record(figures, values)


def _seconds(work: Callable[[], object]) -> float:
    """Processor time of one call [s]: what else the machine does is not counted."""
    began = time.process_time()
    work()
    return time.process_time() - began


if __name__ == "__main__":
    typer.run(main)
