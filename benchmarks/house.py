"""Size of the repository, cost of its checks, and mutants that live since its tests were cut.

    python -m benchmarks.house size check test ci --figures benchmarks/results/house.json
    python -m benchmarks.house --mutants before.json after.json

Run it on two quiet cores, and once before, so that mypy's cache is warm. The files of mutants are
those of ``python -m tests.mutants``, of one list and two trees.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import time
from pathlib import Path
from typing import Annotated

import typer
from tests.house.test_budget import BUDGET, count, lines, words

from benchmarks.figures import FiguresOption, record
from veilcam_server.errors import PROBLEMS
from veilcam_server.settings import Settings

ROOT = Path(__file__).resolve().parents[1]
LOG = (
    "client/veilcam_client/keys/log.py, client/veilcam_client/keys/commitments.py, "
    "client/veilcam_client/wire/log.py, client/veilcam_client/log_file.py, "
    "client/veilcam_client/cli/logs.py, server/veilcam_server/security/log.py, "
    "server/veilcam_server/api/routes/log.py"
)
"""Files of the one log, and of the commitments that it keeps."""


def cost(command: list[str]) -> tuple[float, float, str]:
    """Return wall time and user time of a command and all that it starts [s], and what it printed.

    Raises:
        CalledProcessError: the command failed.
    """
    used, begun = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime, time.perf_counter()
    told = []
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as running:
        for line in running.stdout or ():
            print(line, end="", flush=True)
            told.append(line)
    if running.returncode:
        raise subprocess.CalledProcessError(running.returncode, command)
    took = time.perf_counter() - begun
    return took, resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - used, "".join(told)


def living_anew(before: Path, after: Path) -> list[str]:
    """Return the mutants that the tests killed before and do not kill afterwards."""
    found = []
    for old, new in zip(*(json.loads(path.read_text()) for path in (before, after)), strict=True):
        assert old["before"] == new["before"], "the files hold different mutants"
        if old.get("outcome") == "killed" and new.get("outcome") not in ("killed", "gone"):
            found.append(f"{old['file']}:{old['line']} {old['before']}: {new.get('outcome')}")
    return found


def main(
    targets: Annotated[
        list[str] | None, typer.Argument(help="size, ci (.ci/run), or targets of make.")
    ] = None,
    mutants: Annotated[
        tuple[Path, Path] | None, typer.Option(help="Mutants before and after.")
    ] = None,
    figures: FiguresOption = None,
) -> None:
    """Measure one target after the other."""
    values: dict[str, float] = {}
    for target in targets or ():
        if target == "size":
            parts = ("product", "server", "tests", "benchmarks")
            values |= {f"lines_{part}": count(part) for part in parts}
            values |= {"problem_codes": len(PROBLEMS), "settings": len(Settings.model_fields)}
            values["log_lines"] = lines(LOG)
            values["words_docs"] = sum(words(patterns) for patterns in BUDGET["words"])
        elif target == "ci":
            wall, _, told = cost([str(ROOT / ".ci" / "run")])
            values["ci_minutes"] = round(wall / 60, 1)
            values["pythons_in_ci"] = 1 + ("there is no Python" not in told)
        else:
            wall, used, _ = cost(["make", f"--directory={ROOT}", target])
            values[f"make_{target}_wall_s"] = round(wall, 1)
            values[f"make_{target}_user_cpu_s"] = round(used, 1)
    if mutants:
        found = living_anew(*mutants)
        values["mutants_that_live_anew"] = len(found)
        print(*found, sep="\n")
    load = ", ".join(f"{value:.1f}" for value in os.getloadavg())
    for name, value in values.items():
        print(f"{name}: {value:g}")
    print(f"load {load}")
    record(figures, values)


if __name__ == "__main__":
    typer.run(main)
