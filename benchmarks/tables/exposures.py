"""What several exposures through masks of their own read, with as many values in all."""

from __future__ import annotations

from benchmarks.tables.table import Figures

SHAPES = {12: {1: "3 x 4", 2: "2 x 3", 4: "1 x 3"}, 48: {1: "6 x 8", 2: "4 x 6", 4: "3 x 4"}}

EXPOSURES: Figures = {
    f"exposures_LR_{values}_in_{exposures}{suffix}": (
        "data",
        f"{values} values, {'one exposure' if exposures == 1 else f'{exposures} exposures'} "
        f"of {shape}{said}",
        pattern,
    )
    for values, shapes in SHAPES.items()
    for exposures, shape in shapes.items()
    for suffix, said, pattern in (
        ("", "", "{:.2f} %"),
        ("_interval", ": half of the interval", "{:.2f}"),
        ("_epoch_s", ": processor time of an epoch", "{:.1f} s"),
    )
}
