"""Files and functions of the product that one job enters.

    python -m benchmarks.structure fit walks --figures benchmarks/results/house.json

A job runs before it is counted: what modules do as they are imported is over by then. ``walks`` are
a classification and a calibration over REST, by a simulated daemon that wants tokens. Nothing that
``devices/simulated`` calls is counted: a real camera has light instead.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from types import CodeType, FrameType
from typing import Annotated

import httpx
import typer
from typer.testing import CliRunner

from benchmarks.figures import FiguresOption, record
from veilcam_server.cli.main import app as daemon
from veilcam_server.daemon import serve
from veilcam_server.demo_data import BUNDLE, FRESH, load_digits
from veilcam_server.devices.simulated.scenes import write_scene
from veilcam_server.settings import GivenSettings
from veilcam_training.cli.main import app as train

ROOT = Path(__file__).resolve().parents[1]
PARTS = ("client", "server", "optics", "training")
EMULATOR = str(ROOT / "server" / "veilcam_server" / "devices" / "simulated")
Functions = set[tuple[Path, str]]
Job = Callable[["Profile", Path], Iterator[tuple[str, Functions]]]


class Profile:
    """Profile function of all threads that start after it; it counts where it is told to."""

    def __init__(self) -> None:
        self._entered: set[CodeType] | None = None

    def __call__(self, frame: FrameType, event: str, argument: object) -> None:  # noqa: ARG002 - a hook's
        """Note the function that a frame enters."""
        code, entered = frame.f_code, self._entered
        if event != "call" or entered is None or code in entered:
            return
        if _of_product(code.co_filename) and not _emulated(frame):
            entered.add(code)

    @contextmanager
    def counted(self) -> Iterator[Functions]:
        """Yield the file and the name of each function of the product that is entered meanwhile."""
        entered, found = set[CodeType](), Functions()
        self._entered = entered
        try:
            yield found
        finally:
            self._entered = None
            for code in entered:
                found.add((Path(code.co_filename).relative_to(ROOT), code.co_qualname))


@cache
def _of_product(name: str) -> bool:
    path = Path(name)
    return path.is_relative_to(ROOT) and path.relative_to(ROOT).parts[0] in PARTS


def _emulated(frame: FrameType | None) -> bool:
    while frame is not None and not frame.f_code.co_filename.startswith(EMULATOR):
        frame = frame.f_back
    return frame is not None


def invoke(app: typer.Typer, *words: str) -> str:
    """Run a command in this process, and return what it printed."""
    result = CliRunner().invoke(app, words, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.stdout


def fit(profile: Profile, folder: Path) -> Iterator[tuple[str, Functions]]:
    """Fit own pictures."""
    invoke(train, "draw", str(folder / "shapes"), "--count", "200")
    words = ("fit", "--data", str(folder / "shapes"), "--epochs", "1", "--out")
    invoke(train, *words, str(folder / "fitted"))
    with profile.counted() as found:
        invoke(train, *words, str(folder / "counted"))
    yield "fit", found


def walks(profile: Profile, folder: Path) -> Iterator[tuple[str, Functions]]:
    """Classify once with a mask that is on the panel already, and calibrate once."""
    with served(folder / "pairs", BUNDLE, lambda ask: classified(profile, ask)) as found:
        yield "label", found
    with served(folder / "fresh", FRESH, lambda ask: calibrated(profile, ask)) as found:
        yield "calibration", found


def classified(profile: Profile, ask: httpx.Client) -> Functions:
    """Return what one classification enters."""
    for _ in range(2):
        ask.post("/v1/classifications").raise_for_status()
    with profile.counted() as found:
        ask.post("/v1/classifications").raise_for_status()
        time.sleep(0.5)  # the log of the request, and all that follows the answer
    return found


def calibrated(profile: Profile, ask: httpx.Client) -> Functions:
    """Return what one calibration enters, the last of two."""
    for _ in range(2):
        with profile.counted() as found:
            ask.post("/v1/calibration", json={"repeats": 1}).raise_for_status()
            while (stage := ask.get("/v1/calibration").json()["run"]["stage"]) != "done":
                assert stage not in ("failed", "cancelled"), stage
                time.sleep(0.2)
    return found


@contextmanager
def served(
    state: Path, bundle: Path, walk: Callable[[httpx.Client], Functions]
) -> Iterator[Functions]:
    """Serve a simulated camera, and yield what a walk through it finds."""
    options = ("--scope", "classify", "--scope", "calibrate", "--scope", "read:status")
    token = invoke(
        daemon, "token", "create", "--label", "walk", *options, "--state-dir", str(state)
    )
    found: list[Functions] = []

    def walked(url: str) -> None:
        headers = {"Authorization": f"Bearer {token.split()[0]}"}
        try:
            with httpx.Client(base_url=url, headers=headers, timeout=60) as ask:
                found.append(walk(ask))
        finally:
            os.kill(os.getpid(), signal.SIGTERM)

    given = {"device": "simulated", "bundle": bundle, "state_dir": state, "auth": "tokens"}
    settings = GivenSettings.model_validate({**given, "port": 0, "settle": 0.02})
    write_scene(settings.scene_file, load_digits().images[0])
    with suppress(SystemExit):  # it is told to stop
        serve(settings, lambda url: threading.Thread(target=walked, args=(url,)).start())
    yield found[0]


JOBS: Mapping[str, Job] = {"fit": fit, "walks": walks}


def main(
    jobs: Annotated[list[str], typer.Argument(help=f"Of {', '.join(JOBS)}.")],
    figures: FiguresOption = None,
) -> None:
    """Count what each job enters."""
    values: dict[str, float] = {}
    profile = Profile()
    threading.setprofile(profile)
    sys.setprofile(profile)
    for job in jobs:
        with TemporaryDirectory() as folder:
            for name, found in JOBS[job](profile, Path(folder)):
                files = sorted({str(path) for path, _ in found})
                print(*files, sep="\n")
                values |= {f"files_{name}": len(files), f"functions_{name}": len(found)}
    print(values)
    record(figures, values)


if __name__ == "__main__":
    typer.run(main)
