"""The paper's attacks on this camera, beside the paper's cells: tables 5 and 6.

``python -m benchmarks.privacy.paper convex --data data/faces --figures
benchmarks/results/privacy.json --pictures runs/pictures``, then ``generator`` and ``attributes``.

Each cell is kept in ``--work`` and not computed twice. docs/attacks.md says what is done, and what
differs from the paper.
"""

from __future__ import annotations

import typer
from benchmarks.privacy.paper import attributes, convex, generator

app = typer.Typer(no_args_is_help=True, pretty_exceptions_enable=False)
app.command("convex")(convex.command)
app.command("generator")(generator.command)
app.command("attributes")(attributes.command)

if __name__ == "__main__":
    app()
