"""How long the SDK takes to import, over what it depends on.

    python -m benchmarks.client.imports --figures benchmarks/results/people.json

Processor time of fresh interpreters, in turn. The dependencies are imported as a program that uses
them does: ``import pydantic`` alone loads next to nothing, since its names come when they are asked
for, and so do the SDK's. So ``from veilcam_client import Camera`` stands against
``from pydantic import BaseModel, Field`` with httpx and NumPy, which the SDK itself loads with the
first array.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from typing import Annotated

import numpy as np
import typer
from benchmarks.figures import FiguresOption, record

DEPENDENCIES = "import httpx, numpy; from pydantic import BaseModel, Field"
SDK = "from veilcam_client import Camera"
STRICT = "import httpx, numpy, pydantic"


def processor_time(statement: str) -> float:
    """Of a fresh interpreter that runs one statement [s]."""
    environment = {
        name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"
    }
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run([sys.executable, "-c", statement], check=True, env=environment)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main(
    *,
    count: Annotated[int, typer.Option(min=1, help="Interpreters for each statement.")] = 15,
    figures: FiguresOption = None,
) -> None:
    """Measure the import of the SDK over that of its dependencies."""
    statements = (SDK, DEPENDENCIES, STRICT)
    for statement in statements:
        processor_time(statement)  # byte code is written
    taken = [[processor_time(statement) for statement in statements] for _ in range(count)]
    sdk, dependencies, strict = (float(each) for each in np.median(taken, axis=0))
    print(f"{sdk:.3f} s over {dependencies:.3f} s ({strict:.3f} s: {STRICT})")
    values = {
        "import_over_dependencies": round(sdk / dependencies, 3),
        "import_over_dependencies_unused": round(sdk / strict, 3),
    }
    print(values)
    record(figures, values)


if __name__ == "__main__":
    typer.run(main)
