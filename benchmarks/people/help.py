"""How long a person waits for help, as processor time of a command that computes nothing.

    python -m benchmarks.people.help --figures benchmarks/results/people.json

`help_cpu_s` is the larger of `veilcamd --help` and `veilcamd token list`, each the least of ten
runs, where `python -c pass` takes less than 0.05 s: of a slower machine it is told, not recorded.
"""

from __future__ import annotations

import resource
import subprocess
import sys
from typing import Annotated

import typer
from benchmarks.figures import FiguresOption, record
from benchmarks.rig import work_folder

from veilcam_server.security.tokens import TokenStore

REFERENCE = 0.05
"""What `python -c pass` may take on a machine that the figure is for [s]."""


def main(
    runs: Annotated[int, typer.Option(min=1, help="Of each command.")] = 10,
    figures: FiguresOption = None,
) -> None:
    """Measure how long a person waits for help."""
    with work_folder() as folder:
        TokenStore(folder).create("hall lamp", ("classify",), None)
        commands = {
            "python -c pass": ("-c", "pass"),
            "veilcamd --help": ("-m", "veilcam_server", "--help"),
            "veilcamd token list": (
                *("-m", "veilcam_server", "token", "list", "--state-dir", str(folder)),
            ),
        }
        found = {
            name: min(processor_time(command) for _ in range(runs))
            for name, command in commands.items()
        }
    for name, seconds in found.items():
        print(f"{name:<20} {seconds:.3f} s")
    reference = found.pop("python -c pass")
    if reference >= REFERENCE:
        print("this machine is too slow for the figure")
        return
    record(figures, {"help_cpu_s": round(max(found.values()), 3)})


def processor_time(command: tuple[str, ...]) -> float:
    """User and system time of one run [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *command], stdout=subprocess.DEVNULL, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


if __name__ == "__main__":
    typer.run(main)
