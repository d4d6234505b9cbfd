"""What the tests cost."""

from __future__ import annotations

from benchmarks.tables.table import Figures

CHECKS: Figures = {
    f"make_{target}_{figure}": ("house", f"`make {target}`, {words}", "{:.0f} s")
    for target in ("lint", "types", "layers", "check", "test")
    for figure, words in {"wall_s": "wall", "user_cpu_s": "time of all cores"}.items()
}
