"""How far the 24 x 32 transfer of a 28 x 28 scene is from the whole field, sampled 16 times finer.

python -m benchmarks.optics.transfer_error --figures benchmarks/results/main-job.json
"""

from __future__ import annotations

from typing import Annotated

import torch
import typer
from benchmarks.accuracy.measure import example_mask, relative_error
from benchmarks.accuracy.reference import reference_transfer
from benchmarks.figures import FiguresOption, record

from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.transfer.kernels import Approximation
from veilcam_optics.transfer.operator import TransferOperator


def main(
    *,
    oversampling: Annotated[int, typer.Option(min=1, help="Cells per 12.4 um.")] = 16,
    figures: FiguresOption = None,
) -> None:
    """Print the relative L2 error of the default operator; record it."""
    torch.set_num_threads(1)
    camera, scene, embedding = Camera(), Scene(), Embedding()
    weights = example_mask(camera)
    truth = reference_transfer(camera, scene, embedding, weights, oversampling=oversampling)
    axial = Approximation(axial=True)
    operator = TransferOperator(camera, scene, embedding, approximation=axial)
    error = relative_error(operator(weights.float()), truth)
    print(f"transfer error against {oversampling}x: {error:.2e}")
    record(figures, {"transfer_error_24x32": float(f"{error:.3g}")})


if __name__ == "__main__":
    typer.run(main)
