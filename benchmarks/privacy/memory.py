"""Measurements that a daemon still holds in its memory after their answers.

``python -m benchmarks.privacy.memory --figures benchmarks/results/privacy.json``

A simulated daemon releases raw embeddings, 24 x 32, and takes a few more captures after those that
are looked for. Its writable memory is then searched for any 40 consecutive numbers of each
measurement: as float32, as float64, and as the text of an answer.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.privacy.keys.memory import regions, stopped
from benchmarks.privacy.keys.past import daemon_process
from benchmarks.rig import work_folder

from veilcam_client import Camera
from veilcam_server.demo.daemon import running
from veilcam_server.demo_data import BUNDLE, load_digits
from veilcam_server.devices.simulated.scenes import write_scene

RUN = 40
"""Consecutive numbers that give a measurement away."""
FORMS = ("float32", "float64", "text")
_TEXT = re.compile(rb"(?:-?[0-9.]+(?:e-?[0-9]+)?, ?){%d,}-?[0-9.]+" % (RUN - 1))

Values = npt.NDArray[np.float32]


class Sought:
    """Measurements that are looked for.

    Args:
        measurements: finite numbers, (measurements, numbers).
    """

    def __init__(self, measurements: Values) -> None:
        self._measurements = measurements
        values, places = np.unique(measurements, return_index=True)
        # A number that comes twice says nothing of where it is.
        self._values, self._places = values[values != 0], places[values != 0]

    def found(self, numbers: npt.NDArray[Any]) -> set[int]:
        """Measurements of which ``RUN`` consecutive numbers stand in ``numbers``, float32."""
        near = np.searchsorted(self._values, numbers).clip(max=len(self._values) - 1)
        alike = np.flatnonzero(self._values[near] == numbers)
        size, found = self._measurements.shape[1], set[int]()
        for at in alike.tolist():
            which, place = divmod(int(self._places[near[at]]), size)
            if which not in found and place + RUN <= size:
                wanted = self._measurements[which, place : place + RUN]
                if np.array_equal(numbers[at : at + RUN], wanted):
                    found.add(which)
        return found


def search(process: int, sought: Sought) -> dict[str, set[int]]:
    """Return the measurements in the writable memory of a process, by form."""
    found: dict[str, set[int]] = {form: set() for form in FORMS}
    for content in _memory(process):
        words = content[: len(content) // 8 * 8]
        found["float32"] |= sought.found(np.frombuffer(words, np.float32))
        doubles = np.frombuffer(words, np.float64)
        with np.errstate(over="ignore", invalid="ignore"):
            narrow = doubles.astype(np.float32)
        found["float64"] |= sought.found(np.where(narrow == doubles, narrow, np.nan))
        for text in _TEXT.findall(content):
            with suppress(ValueError):
                found["text"] |= sought.found(np.array(text.split(b","), np.float64).astype("f4"))
    return found


def _memory(process: int) -> Iterator[bytes]:
    with Path(f"/proc/{process}/mem").open("rb", buffering=0) as stream:
        for region in regions(process):
            if region.writable:
                stream.seek(region.start)
                with suppress(OSError):
                    yield stream.read(region.end - region.start)


def main(
    *,
    captures: Annotated[int, typer.Option(min=1, help="Captures that are looked for.")] = 200,
    further: Annotated[int, typer.Option(min=0, help="Captures after those.")] = 5,
    figures: FiguresOption = None,
) -> None:
    """Take captures, then further ones, and count those that memory still holds."""
    options = ("--release", "raw", "--raw-budget", "1000000", "--settle", "0", "--exposure", "0")
    with work_folder() as folder:
        scene = folder / "scene.npy"
        write_scene(scene, load_digits().images[0])
        with running(BUNDLE, scene, folder, *options) as url, Camera(url) as camera:
            taken = [np.asarray(camera.capture()).ravel() for _ in range(captures + further)]
            process = daemon_process(folder / "state")
            with stopped(process):
                found = search(process, Sought(np.stack(taken[:captures])))
                latest = search(process, Sought(np.stack(taken[captures:]))) if further else {}
    left = set[int]().union(*found.values())
    for form in FORMS:
        print(f"{form}: {len(found[form])} of {captures}; of the last: {len(latest.get(form, ()))}")
    print(f"{len(left)} of {captures} measurements are in memory after {further} further captures")
    record(figures, {"measurements_in_memory": len(left)})


if __name__ == "__main__":
    typer.run(main)
