"""What a daemon does without HTTP and without camera, in a process of its own, and what it takes.

    python -m benchmarks.deploy.device_path fresh
    python -m benchmarks.deploy.device_path pairs --with-torch

Imports, a bundle of the demonstration, five epochs, and behind each a frame that was recorded: it
is binned and classified. As on a device, neither torch nor SciPy,
matplotlib or Pillow can be imported; with ``--with-torch`` the same is done by torch, to compare.
One line of JSON says what came of it.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import numpy.typing as npt
import typer

if TYPE_CHECKING:
    from importlib.machinery import ModuleSpec

    from veilcam_client.keys.epoch_key import EpochKey
    from veilcam_training.bundle import Bundle

EPOCHS = 5
MISSING = ("torch", "scipy", "matplotlib", "PIL")
Labels = list[int]


@dataclass(frozen=True, slots=True)
class Taken:
    """By the whole process, its start included."""

    rss_mib: float
    """Resident memory at the end."""
    peak_mib: float
    ready_s: float
    """CPU time until the first mask is there."""
    labels: Labels
    """What was seen behind each mask."""


class NotInstalled:
    """Finds nothing of what no device has."""

    def find_spec(self, name: str, *_: object) -> ModuleSpec | None:
        """Refuse the missing; leave the rest to whoever finds it."""
        if name.partition(".")[0] in MISSING:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return None


def recorded(shape: tuple[int, int]) -> npt.NDArray[np.float32]:
    """A frame of the sensor, 12 bits, as a measurement: binned, of the camera's scale."""
    from veilcam_server.devices.raw import Binning  # noqa: PLC0415

    rows, columns = 4 * shape[0], 4 * shape[1]
    random = np.random.default_rng(0)
    place = np.hypot(*np.mgrid[-1 : 1 : rows * 1j, -1 : 1 : columns * 1j])
    frame = random.poisson(256 + 600 * np.exp(-2 * place**2)).clip(0, 4095).astype(np.uint16)
    binned = Binning((rows, columns), shape).means(frame)
    measurement: npt.NDArray[np.float32] = (0.05 * (binned - 256) / (4095 - 256)).astype(np.float32)
    return measurement


def in_numpy(bundle: Bundle, keys: list[EpochKey]) -> tuple[Labels, float]:
    """As the daemon does."""
    from veilcam_server.masks.fresh import FreshSource  # noqa: PLC0415
    from veilcam_server.masks.pairs import load_pairs  # noqa: PLC0415
    from veilcam_server.masks.source import MaskSource  # noqa: PLC0415

    source: MaskSource = load_pairs(bundle) if bundle.fresh is None else FreshSource(bundle)
    measurement, labels, ready = recorded(bundle.embedding.shape), [], 0.0
    for key in keys:
        mask = source.make(key, frozenset())
        ready = ready or time.process_time()
        labels.append(bundle.labels.index(mask.reader.classify(measurement).label))
        mask.erase()
    return labels, ready


def in_torch(bundle: Bundle, keys: list[EpochKey]) -> tuple[Labels, float]:
    """The same steps, all that computes being torch's."""
    import torch  # noqa: PLC0415

    from veilcam_optics.decoding import Precision  # noqa: PLC0415
    from veilcam_optics.keys.masks import draw_levels  # noqa: PLC0415
    from veilcam_training.bundle import classifier_inputs  # noqa: PLC0415
    from veilcam_training.models.network import build_classifier  # noqa: PLC0415

    torch.set_num_threads(1)
    measurement = torch.from_numpy(recorded(bundle.embedding.shape))[None]
    labels, ready = [], 0.0
    with torch.inference_mode():
        if bundle.fresh is None:
            networks = [build_classifier(pair.layers, pair.weights) for pair in bundle.pairs]
            ready = time.process_time()
            seen = [network(measurement.flatten(1)) for network in networks[:EPOCHS]]
            return [int(logits.argmax()) for logits in seen], ready
        fresh = bundle.fresh
        frame = fresh.frame(bundle.camera, bundle.scene, bundle.embedding).in_torch()
        decoding = frame.decoding(precision=Precision.DOUBLE)
        network = build_classifier(fresh.layers, fresh.weights)
        for key in keys:
            levels = draw_levels(
                key.levels(), camera=bundle.camera, distribution=fresh.distribution
            )
            decoder = decoding.prepare(frame.shown(levels))
            ready = ready or time.process_time()
            labels.append(int(network(classifier_inputs(decoder, measurement).float()).argmax()))
    return labels, ready


def take(mode: Literal["fresh", "pairs"], *, with_torch: bool) -> Taken:
    """Do it, and say what it took."""
    if not with_torch:
        sys.meta_path.insert(0, NotInstalled())
    from veilcam_client.keys.epoch_key import EpochKey  # noqa: PLC0415
    from veilcam_server.demo_data import BUNDLE, FRESH  # noqa: PLC0415
    from veilcam_training.bundle import read_bundle  # noqa: PLC0415

    bundle = read_bundle(FRESH if mode == "fresh" else BUNDLE)
    keys = [
        EpochKey(bytes([number]) * 32, device="d7" * 32, bundle=bundle.digest)
        for number in range(EPOCHS)
    ]
    labels, ready = (in_torch if with_torch else in_numpy)(bundle, keys)
    status = Path("/proc/self/status").read_text().splitlines()
    memory = {line.split(":")[0]: int(line.split()[1]) for line in status if line.endswith("kB")}
    return Taken(memory["VmRSS"] / 1024, memory["VmHWM"] / 1024, ready, labels)


def main(
    mode: Annotated[Literal["fresh", "pairs"], typer.Argument(help="Of the bundle.")],
    *,
    with_torch: Annotated[bool, typer.Option(help="What computes is torch.")] = False,
) -> None:
    """Print what it took, as JSON."""
    print(json.dumps(asdict(take(mode, with_torch=with_torch))))


if __name__ == "__main__":
    typer.run(main)
