"""Time from a change of the time zone until a running daemon keeps the quiet hours of the new one.

``python -m benchmarks.people.zone --figures benchmarks/results/first-aid.json``
"""

from __future__ import annotations

import os
import shutil
import statistics
import time
from datetime import UTC, datetime, timedelta
from pathlib import Path

import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.rig import prompt_daemon, work_folder

from veilcam_client import Camera

ZONES = Path("/usr/share/zoneinfo/Etc")
HERE, THERE = "UTC", "GMT-9"
"""Zones before and after a change; by POSIX the second is nine hours ahead."""
LONGEST = 30.0
"""Time after which a change counts as not seen [s]."""


def _set(file: Path, zone: str) -> None:
    new = file.with_name("new")
    shutil.copy(ZONES / zone, new)
    new.replace(file)


def _seen_after(camera: Camera, activity: str) -> float:
    """Return how long a daemon takes to do something else [s]."""
    begun = time.monotonic()
    while camera.watch.get().activity != activity:
        if time.monotonic() - begun > LONGEST:
            raise SystemExit(f"the daemon is not {activity} {LONGEST:g} s after the change")
        time.sleep(0.02)
    return time.monotonic() - begun


def seen_after(folder: Path, changes: int) -> list[float]:
    """Return the time that each change of the zone takes to be seen [s].

    Args:
        folder: for the daemon.
        changes: number of changes, to and fro.
    """
    there = datetime.now(UTC) + timedelta(hours=9)
    ends = there + timedelta(hours=2)
    zone = folder / "localtime"
    _set(zone, HERE)
    os.environ["TZ"] = f":{zone}"
    times = []
    hours = f"{there - timedelta(hours=1):%H:%M}-{ends:%H:%M}"
    with prompt_daemon(folder, "--quiet-hours", hours) as url, Camera(url) as camera:
        _seen_after(camera, "on_request")
        for change in range(changes):
            there_next = change % 2 == 0
            _set(zone, THERE if there_next else HERE)
            times.append(_seen_after(camera, "quiet" if there_next else "on_request"))
    return times


def main(changes: int = 20, figures: FiguresOption = None) -> None:
    """Change the zone of a simulated daemon, and measure until it is seen."""
    with work_folder() as folder:
        times = seen_after(folder, changes)
    print(f"seen after {statistics.median(times):.2f} s, {max(times):.2f} s at most")
    record(figures, {"zone_change_seen_s": round(max(times), 3)})


if __name__ == "__main__":
    typer.run(main)
