"""The daemon's engine on emulated hardware that fails at random: no measurement mixed, reused or
lost.

    python -m tests.siege.soak --figures benchmarks/results/daemon.json

Every capture has a mask of its own, drawn from a key. The light carries 64 of the mask's levels to
the 64 values of a measurement, so each measurement tells which mask, or which mixture, it was
taken under. Every embedding leaves: sealed, and opened again by a receiver, or white. Meanwhile
somebody changes masks by hand at random moments; the panel's bus breaks off in the middle of masks,
the camera hangs, gives old frames and gives frames twice. Every now and then the engine is stopped
and started. Then it is killed (SIGKILL) at random moments, again and again, on one state directory.
What only the optical self test can see, a panel that takes bytes and does not show them, is left
out: its own tests are for that.
"""

from __future__ import annotations

import hashlib
import itertools
import multiprocessing
import os
import random
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.rig import resident, work_folder
from rich.progress import track
from tests.siege.engine import CAMERA, SETTLE, Marked, Rig, Supply

from veilcam_client.errors import SealedError
from veilcam_client.keys.blocks import Opener
from veilcam_client.wire.captures import Capture
from veilcam_client.wire.sealing import Release
from veilcam_server.camera.camera import MaskedCamera
from veilcam_server.camera.capture import Captured, MaskedCapture
from veilcam_server.devices import DeviceError
from veilcam_server.devices.base import Levels
from veilcam_server.errors import FenceError, NotReadyError

FORMS: tuple[Release, ...] = ("sealed", "white")
"""Of one engine after the other."""
WARM_UP = 0.2
"""Share of the captures after which memory must have stopped growing."""
KNOWN = (DeviceError, FenceError, NotReadyError)


@dataclass
class Outcome:
    """What a run came to."""

    captures: int = 0
    mixed: int = 0
    errors: int = 0
    lost: int = 0
    """Captures that ended neither in a measurement, which its receiver could open, nor in an error
    that the daemon knows."""
    epochs: list[str] = field(default_factory=list)
    """Names of those that measurements were taken under."""
    masks: list[bytes] = field(default_factory=list)
    """Digests of all masks that were put on the panel, but for those that were put back."""
    growth: float = 0.0
    """Of resident memory after the warm-up [MB]."""

    @property
    def reused(self) -> int:
        """Measurements under an epoch, or showings of a mask, that was there before."""
        return sum(len(items) - len(set(items)) for items in (self.epochs, self.masks))


def attempt(rig: Rig, opener: Opener, outcome: Outcome) -> None:
    """Take one capture and judge it."""
    try:
        captured = rig.camera.capture(release=True)
    except KNOWN:
        outcome.errors += 1
        rig.mend()
        if rig.camera.state.state in ("safe", "degraded"):
            try:
                rig.camera.rotate()
            except KNOWN:
                outcome.errors += 1
        return
    except Exception:
        outcome.lost += 1
        return
    try:
        judge(captured, opener, outcome)
    except SealedError:
        outcome.lost += 1
    finally:
        captured.done()


def judge(captured: Captured, opener: Opener, outcome: Outcome) -> None:
    """Answer as a request would, and compare what leaves with the mask."""
    assert isinstance(captured, MaskedCapture)
    assert isinstance(captured.reader, Marked)
    outcome.captures += 1
    outcome.epochs.append(captured.epoch)
    captured.classify()
    answer = Capture(
        id="",
        epoch=captured.epoch,
        number=captured.number,
        taken_at=captured.taken_at,
        embedding=captured.release(0.0),
    )
    measured = captured.measurement
    if captured.form == "sealed":
        measured = np.asarray(opener.open(answer).embedding)
    seen = measured * (CAMERA.panel.levels - 1)
    outcome.mixed += bool(np.abs(seen - captured.reader.corner).max() > 0.1)


@contextmanager
def meddling(camera: MaskedCamera) -> Iterator[None]:
    """Meanwhile somebody changes masks by hand, about five times a second."""
    ended = threading.Event()

    def meddle() -> None:
        while not ended.wait(random.expovariate(5.0)):
            with suppress(*KNOWN):
                camera.rotate()

    meddler = threading.Thread(target=meddle)
    meddler.start()
    try:
        yield
    finally:
        ended.set()
        meddler.join()


def soak(
    supply: Supply,
    directory: Path,
    captures: int,
    *,
    faults: float = 0.05,
    granted: float = SETTLE,
    restart_every: int = 2000,
    advance: Callable[[], None] = lambda: None,
) -> Outcome:
    """Take captures on hardware that fails, over engines that are stopped and started."""
    outcome, opener = Outcome(), Opener(supply.receiver)

    def tell(levels: Levels) -> None:
        outcome.masks.append(hashlib.sha256(levels.tobytes()).digest())

    warm, done = 0.0, 0
    forms = itertools.cycle(FORMS)
    while done < captures:
        rig = Rig(supply, directory, form=next(forms), granted=granted, tell=tell)
        try:
            rig.camera.rotate()
            with meddling(rig.camera):
                for _ in range(min(restart_every, captures - done)):
                    if done == int(WARM_UP * captures):
                        warm = resident()
                    rig.break_something(faults)
                    attempt(rig, opener, outcome)
                    done += 1
                    advance()
        finally:
            rig.mend()
            rig.bus.breaks = rig.frames.hangs = 0
            rig.camera.stop()
    outcome.growth = resident() - warm
    return outcome


def kill(supply: Supply, directory: Path, lives: int) -> list[str]:
    """Kill the engine at random moments; return a digest of every mask that it ever showed."""
    log = directory / "shown"
    log.touch(mode=0o600)
    fork = multiprocessing.get_context("fork")
    for life in track(range(lives), "kills"):
        child = fork.Process(target=_live, args=(supply, directory, log))
        child.start()
        lines = log.read_text().count("\n")
        # Every fourth dies while it starts; the others once they have shown something.
        while life % 4 and child.is_alive() and log.read_text().count("\n") == lines:
            time.sleep(0.005)
        time.sleep(random.uniform(0.0, 0.2))
        child.kill()
        child.join()
        if child.exitcode != -9:
            raise RuntimeError(f"the engine ended by itself with {child.exitcode}")
    return log.read_text().splitlines()


def _live(supply: Supply, directory: Path, log: Path) -> None:
    """Capture until killed. What the panel shows is in the log before it is shown."""
    descriptor = os.open(log, os.O_WRONLY | os.O_APPEND)

    def tell(levels: Levels) -> None:
        os.write(descriptor, hashlib.sha256(levels.tobytes()).hexdigest().encode() + b"\n")

    rig = Rig(supply, directory, tell=tell)
    rig.camera.rotate()
    while True:
        rig.camera.capture(release=True).done()


def main(
    *,
    captures: Annotated[int, typer.Option(min=10, help="To try.")] = 20_000,
    kills: Annotated[int, typer.Option(min=0, help="How often to kill the engine.")] = 20,
    faults: Annotated[
        float, typer.Option(min=0, max=1, help="Share of captures that meet a fault.")
    ] = 0.05,
    figures: FiguresOption = None,
) -> None:
    """Look for measurements mixed, lost, or under a used epoch, and for memory that grows."""
    torch.set_num_threads(1)
    supply = Supply()
    with work_folder() as folder:
        # Before anything starts a thread: a fork copies no threads, but the locks they hold.
        killed = folder / "killed"
        killed.mkdir()
        shown = kill(supply, killed, kills)
        steps = iter(track(range(captures), "captures"))

        def advance() -> None:
            next(steps, None)

        outcome = soak(supply, folder / "soaked", captures, faults=faults, advance=advance)
    again = len(shown) - len(set(shown))
    print(f"kills: {kills}, {len(shown)} masks shown, {again} of them again")
    print(
        f"captures: {captures} tried, {outcome.captures} taken, {outcome.errors} errors, "
        f"{outcome.mixed} mixed, {outcome.reused} reused, {outcome.lost} lost, "
        f"memory {outcome.growth:+.1f} MB"
    )
    record(
        figures,
        {
            "soak_captures": captures,
            "soak_mixed": outcome.mixed,
            "soak_reused": outcome.reused + again,
            "soak_lost": outcome.lost,
            "soak_growth_mb": outcome.growth,
        },
    )
    if outcome.mixed + outcome.reused + again + outcome.lost or outcome.growth > 20:
        raise SystemExit(1)


if __name__ == "__main__":
    typer.run(main)
