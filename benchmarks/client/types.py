"""Types and names of the SDK's public surface: the percent that pyright knows, and a count.

    python -m benchmarks.client.types --figures benchmarks/results/people.json

``pyright --verifytypes`` needs Node.js, which its package fetches once; it takes a minute.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import typer
from benchmarks.figures import FiguresOption, record

import veilcam_client


def completeness(report: str) -> float:
    """Percent of symbols whose type is known, in a report of pyright; prints all others."""
    found = json.loads(report)["typeCompleteness"]
    if not found["modules"]:
        sys.exit("pyright found no veilcam_client: install the project beside this Python")
    for symbol in found["symbols"]:
        if symbol["isExported"] and not symbol["isTypeKnown"]:
            print(symbol["name"])
    return 100 * float(found["completenessScore"])


def main(*, figures: FiguresOption = None) -> None:
    """Measure the completeness of the SDK's types."""
    command = (sys.executable, "-m", "pyright", "--ignoreexternal", "--outputjson")
    # --verifytypes takes the packages of the first Python on the path, whichever runs pyright.
    first = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        (*command, "--verifytypes", "veilcam_client"),
        env={**os.environ, "PATH": first},
        capture_output=True,
        text=True,
        check=False,
    )
    values = {
        "verifytypes_percent": round(completeness(done.stdout), 2),
        "public_names_top": len(veilcam_client.__all__),
    }
    print(values)
    record(figures, values)


if __name__ == "__main__":
    typer.run(main)
