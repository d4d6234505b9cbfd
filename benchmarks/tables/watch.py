"""What a camera that looks by itself believes."""

from __future__ import annotations

from benchmarks.tables.table import Figures

BELIEF: Figures = {
    "belief_false_seen": ("people", "false sights in 25,000 looks at empty scenes", "{:.0f}"),
    "belief_right_fraction": (
        "people",
        "presentations longer than 1.5 s with the right label, at 2 looks a second",
        "{:.2%}",
    ),
    "belief_latency_s": ("people", "until it is told, in the median", "{:.2f} s"),
    "beat_mb_per_day": (
        "privacy",
        "a stream of digits behind TLS, two looks a second, a mask at each, a day",
        "{:.0f} MB",
    ),
}
