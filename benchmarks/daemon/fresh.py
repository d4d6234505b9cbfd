"""Fresh masks in the simulated daemon, capture after capture: nothing repeats, mixes or leaks.

    python benchmarks/daemon/fresh.py --figures benchmarks/results/fresh-masks.json

Every capture has an epoch of its own. The simulated light carries a keyed digest of whatever mask
it passed, so each reading tells which mask was on the panel while it was exposed; a light that
computes point spread functions would take a hundred times as long and tell no more about the
engine. A crystal that needs a millisecond to turn, and somebody who changes masks by hand at random
moments, make mixed frames possible. Then the engine is killed at random moments and started again
on the same state directory. The start-up rule that moves the epoch counter up to the clock is
turned off here: what was committed to the disk must be enough.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import hashlib
import hmac
import multiprocessing
import random
import secrets
import tempfile
import threading
import time
from collections.abc import Callable, Iterable
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Self

import numpy as np
import numpy.typing as npt
import torch
import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from veilcam_client.wire.captures import Form, Prediction
from veilcam_client.wire.events import Event, MaskChanged
from veilcam_client.wire.rotation import EveryCaptures
from veilcam_optics.camera.geometry import Camera, Embedding, Scene
from veilcam_optics.decoding import ReadingNoise, fit_statistics
from veilcam_optics.keys.epoch_names import EpochNames
from veilcam_optics.keys.masks import MaskDistribution, Secret, epoch_levels
from veilcam_optics.simulation.operator import Response
from veilcam_server.camera.camera import MaskedCamera
from veilcam_server.camera.capture import Fence
from veilcam_server.camera.epochs import EpochStore, Preparation
from veilcam_server.demo_data import load_digits
from veilcam_server.devices import Device, Display, Shown
from veilcam_server.devices.base import Levels, Reading
from veilcam_server.devices.simulated.device import Conditions, raw_shape, simulated_device
from veilcam_server.masks.fresh import FreshSource
from veilcam_server.masks.source import Mask, Reader
from veilcam_training.bundle import Bundle, Fresh, build_untrained
from veilcam_training.bundle.layers import AveragePool, Conv2d, Flatten, Linear, ReLU, Reshape
from veilcam_training.experiments.records import record_figures

CAMERA, SCENE, EMBEDDING = Camera(), Scene(), Embedding(12, 16)
RAW = raw_shape(EMBEDDING)
RANK = 96
SETTLE = 1e-3
"""What the simulated crystal takes to turn, and what the engine grants it [s]."""
WARM_UP = 0.1
"""Share of the captures after which memory must have stopped growing."""
MIB = 2**20


def make_bundle() -> Bundle:
    """A camera of the real size with an untrained classifier: labels play no part here."""
    layers = (
        Reshape(shape=(2, *SCENE.shape)),
        Conv2d(inputs=2, outputs=8, stride=2),
        ReLU(),
        AveragePool(rows=4, columns=4),
        Flatten(),
        Linear(inputs=128, outputs=10),
    )
    digits = torch.from_numpy(load_digits().images[:2000] / np.float32(255))
    return Bundle(
        task="mnist",
        labels=tuple("0123456789"),
        camera=CAMERA,
        scene=SCENE,
        embedding=EMBEDDING,
        mode="fresh",
        fresh=Fresh(
            device="benchmark",
            distribution=MaskDistribution.uniform(CAMERA),
            statistics=fit_statistics([digits], RANK),
            noise=ReadingNoise(),
            layers=layers,
            weights=build_untrained(layers).state_dict(),
        ),
    )


@dataclass(frozen=True)
class Fingerprints:
    """Keyed digests of masks: comparable here, and worthless once the process has ended."""

    key: bytes = field(default_factory=lambda: secrets.token_bytes(32), repr=False)

    def of(self, levels: Levels) -> bytes:
        """Return 32 bytes for one mask."""
        return hmac.new(self.key, levels.tobytes(), hashlib.sha256).digest()


class PlantedLight:
    """Light that carries the fingerprint of the mask that it passed, in the first 32 pixels."""

    def __init__(self, fingerprints: Fingerprints) -> None:
        self._fingerprints = fingerprints

    def response(self, weights: torch.Tensor) -> Response:
        """Return the fingerprint; that of a half-turned mask is another one altogether."""
        top = CAMERA.panel.levels - 1
        levels = (weights * top).round().to(torch.uint8).numpy()
        return (torch.tensor(list(self._fingerprints.of(levels)), dtype=torch.float32),)

    def collect(self, scenes: torch.Tensor, response: Response) -> torch.Tensor:
        """Return raw pixels of an embedding that holds the fingerprint."""
        readings = scenes.mean((1, 2))[:, None].repeat(1, EMBEDDING.size)
        readings[:, : len(response[0])] = response[0]
        boxes = readings.reshape(-1, *EMBEDDING.shape)
        rows, columns = (raw // box for raw, box in zip(RAW, EMBEDDING.shape, strict=True))
        return boxes.repeat_interleave(rows, 1).repeat_interleave(columns, 2)


@dataclass(frozen=True, eq=False)
class MarkedReader:
    """A reader that knows the fingerprint of its mask."""

    reader: Reader
    fingerprint: bytes

    def classify(self, embedding: Reading) -> Prediction:
        """Classify as the reader does."""
        return self.reader.classify(embedding)

    def release(self, embedding: Reading, form: Form) -> Reading:
        """Release as the reader does."""
        return self.reader.release(embedding, form)


class MarkedSource(FreshSource):
    """The daemon's own source, whose readers can be told apart."""

    def __init__(self, bundle: Bundle, secret: Secret, fingerprints: Fingerprints) -> None:
        # First: a source makes a mask while it is built, to find faults then and not on the way.
        self._fingerprints = fingerprints
        super().__init__(bundle, secret, form="white")

    def make(self, counter: int, last_mark: str) -> Mask:
        """Prepare an epoch."""
        mask = super().make(counter, last_mark)
        fingerprint = self._fingerprints.of(mask.levels)
        return Mask(mask.levels, MarkedReader(mask.reader, fingerprint))


class WatchedDisplay:
    """A panel that tells what it was given to show, once it shows it."""

    def __init__(self, display: Display, tell: Callable[[Levels], None]) -> None:
        self._display, self._tell = display, tell

    @property
    def name(self) -> str:
        """Name of the panel."""
        return self._display.name

    @property
    def resets(self) -> int:
        """How often it was set up."""
        return self._display.resets

    def show(self, levels: Levels) -> Shown:
        """Show a mask and tell of it."""
        shown = self._display.show(levels)
        self._tell(levels)
        return shown

    def blank(self) -> None:
        """Show opaque; that is no mask."""
        self._display.blank()

    def close(self) -> None:
        """Let go of the panel."""
        self._display.close()


class Passed:
    """A self test that was passed: this light has no geometry to test by."""

    def run(self, device: Device, fence: Fence) -> None:
        """Nothing is shown."""


class GreyScene:
    """The same grey card all the time."""

    def read(self) -> npt.NDArray[np.float32]:
        """Return it."""
        return np.full(SCENE.shape, 0.5, np.float32)


@dataclass(frozen=True)
class Setting:
    """What one secret belongs to, whatever runs on it and however often it is started."""

    bundle: Bundle
    secret: Secret
    fingerprints: Fingerprints
    source: MarkedSource
    """Built once: it is what takes time when an engine starts."""

    @classmethod
    def make(cls) -> Self:
        """Draw a secret and build what belongs to it."""
        bundle, secret, fingerprints = make_bundle(), Secret.generate(), Fingerprints()
        return cls(bundle, secret, fingerprints, MarkedSource(bundle, secret, fingerprints))

    def camera(
        self,
        directory: Path,
        tell: Callable[[Levels], None],
        *,
        settle: float = SETTLE,
        granted: float = SETTLE,
    ) -> MaskedCamera:
        """Start an engine that changes masks at every capture.

        Args:
            directory: where epochs are recorded.
            tell: called with every mask that the panel shows.
            settle: what the simulated crystal takes to turn [s].
            granted: what the engine grants it [s].
        """
        device = simulated_device(
            PlantedLight(self.fingerprints),
            GreyScene(),
            camera=self.bundle.camera,
            embedding=EMBEDDING,
            conditions=Conditions(settle, exposure=0.0, snr_db=float("inf")),
            full_scale=300.0,
        )
        return MaskedCamera(
            Device(WatchedDisplay(device.display, tell), device.sensor, simulated=True),
            Preparation(self.source, EpochStore(directory, now=lambda: 0.0)),
            self.bundle.embedding.shape,
            Passed(),
            fence=Fence(granted),
            policy=EveryCaptures(captures=1),
        )

    def fingerprint(self, counter: int) -> bytes:
        """Draw the mask of an epoch again, as any holder of the secret can."""
        fresh = self.bundle.fresh
        assert fresh is not None
        levels = epoch_levels(
            self.secret,
            fresh.device,
            counter,
            camera=self.bundle.camera,
            distribution=fresh.distribution,
        )
        return self.fingerprints.of(levels)


@dataclass
class Outcome:
    """What a run came to."""

    captures: int = 0
    mixed: int = 0
    names: list[str] = field(default_factory=list)
    """Of every epoch, as the network hears them."""
    counters: list[int] = field(default_factory=list)
    masks: list[bytes] = field(default_factory=list)
    """Fingerprint of every mask that was on the panel."""
    late: int = 0
    growth: float = 0.0
    """Of resident memory after the warm-up [MiB]."""

    @property
    def repeated(self) -> int:
        """How many names, counters or masks came before."""
        return max(repeats(self.names), repeats(self.counters), repeats(self.masks))


def repeats(items: Iterable[object]) -> int:
    """How many of ``items`` came before."""
    listed = list(items)
    return len(listed) - len(set(listed))


def soak(
    setting: Setting,
    directory: Path,
    captures: int,
    advance: Callable[[], None],
    *,
    settle: float = SETTLE,
    granted: float = SETTLE,
) -> Outcome:
    """Take captures, each under an epoch of its own, while masks are changed by hand as well."""
    outcome = Outcome()
    fresh = setting.bundle.fresh
    assert fresh is not None
    epoch_names = EpochNames(setting.secret, fresh.device)

    def tell(levels: Levels) -> None:
        outcome.masks.append(setting.fingerprints.of(levels))

    camera = setting.camera(directory, tell, settle=settle, granted=granted)

    def note(make: Callable[..., Event]) -> None:
        event = make(id="", at=datetime.now(UTC))
        if isinstance(event, MaskChanged):
            outcome.names.append(event.epoch)

    camera.listen(note)
    ended = threading.Event()

    def meddle() -> None:
        while not ended.wait(random.expovariate(5.0)):
            camera.rotate()

    meddler = threading.Thread(target=meddle)
    with ExitStack() as stack:
        stack.callback(camera.stop)
        camera.rotate()
        meddler.start()
        stack.callback(meddler.join)
        stack.callback(ended.set)
        warm = 0.0
        for number in range(captures):
            if number == int(WARM_UP * captures):
                warm = resident()
            captured = camera.capture()
            outcome.captures += 1
            expected = setting.fingerprint(epoch_names.counter(captured.epoch))
            planted = np.array(list(expected), np.float32)
            reader = captured.reader
            assert isinstance(reader, MarkedReader)
            # The converter rounds to a twelfth of what tells two fingerprints apart.
            seen = np.rint(captured.embedding.ravel()[: len(planted)])
            if not np.array_equal(seen, planted) or reader.fingerprint != expected:
                outcome.mixed += 1
            # As a request would: the label, and the form in which the embedding leaves.
            reader.classify(captured.embedding)
            reader.release(captured.embedding, "white")
            advance()
        outcome.growth = resident() - warm
    outcome.late = camera.lateness.late
    outcome.counters = [epoch_names.counter(name) for name in outcome.names]
    return outcome


def resident() -> float:
    """Resident memory of this process [MiB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / MIB


def kill(
    setting: Setting, directory: Path, kills: int, advance: Callable[[], None]
) -> tuple[list[str], int]:
    """Kill the engine ``kills`` times at random moments, each time on the same state directory.

    Returns:
        Fingerprints of all masks that were ever on the panel, and how many lives showed any.
    """
    log = directory / "shown"
    fork = multiprocessing.get_context("fork")
    lives, lines = 0, 0
    log.touch(mode=0o600)
    for number in range(kills):
        child = fork.Process(target=_live, args=(setting, directory, log))
        child.start()
        # Every fourth dies while it starts; the others once they have shown something.
        while number % 4 and child.is_alive() and len(log.read_text().splitlines()) == lines:
            time.sleep(0.005)
        time.sleep(random.uniform(0.0, 0.3))
        child.kill()
        child.join()
        if child.exitcode != -9:
            raise RuntimeError(f"the engine ended by itself with {child.exitcode}")
        shown = log.read_text().splitlines()
        lives += len(shown) > lines
        lines = len(shown)
        advance()
    return log.read_text().splitlines(), lives


def _live(setting: Setting, directory: Path, log: Path) -> None:
    """Capture until killed. What the panel shows is in the log before anything else happens."""
    descriptor = os.open(log, os.O_WRONLY | os.O_APPEND)

    def tell(levels: Levels) -> None:
        os.write(descriptor, setting.fingerprints.of(levels).hex().encode() + b"\n")

    camera = setting.camera(directory, tell)
    camera.rotate()
    while True:
        camera.capture()


def main(
    *,
    captures: Annotated[int, typer.Option(min=10, help="Each under an epoch of its own.")] = 10_000,
    kills: Annotated[int, typer.Option(min=0, help="How often to kill the engine.")] = 40,
    growth: Annotated[
        float, typer.Option(min=0, help="Memory that may be gained after the warm-up [MiB].")
    ] = 16.0,
    figures: Annotated[Path | None, typer.Option(help="Record to write figures into.")] = None,
) -> None:
    """Look for epochs that repeat, frames that mix masks, and memory that grows."""
    torch.set_num_threads(1)
    setting = Setting.make()
    with tempfile.TemporaryDirectory(prefix="veilcam-") as temporary, _progress() as progress:
        # Before anything starts a thread: a fork copies no threads, but the locks they hold.
        task = progress.add_task("kills", total=kills)
        directory = Path(temporary) / "killed"
        directory.mkdir()

        def advance() -> None:
            progress.advance(task)
            progress.refresh()

        shown, lives = kill(setting, directory, kills, advance)
        task = progress.add_task("captures", total=captures)
        outcome = soak(setting, Path(temporary) / "soaked", captures, advance)
    again = repeats(shown)
    print(f"kills: {kills}, {lives} lives showed {len(shown)} masks, {again} of them again")
    print(
        f"captures: {outcome.captures} over {len(outcome.names)} epochs, "
        f"{outcome.repeated} repeated, {outcome.mixed} frames mixed, "
        f"{outcome.late} found the next mask late, memory {outcome.growth:+.1f} MiB"
    )
    if figures is not None:
        record_figures(
            figures,
            {
                "epochs_run": len(outcome.names),
                "epochs_repeated": outcome.repeated + again,
                "frames_mixed": outcome.mixed,
            },
        )
    if outcome.repeated + again + outcome.mixed or outcome.growth > growth:
        raise SystemExit(1)


def _progress() -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        auto_refresh=False,
    )


if __name__ == "__main__":
    typer.run(main)
