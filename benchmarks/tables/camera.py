"""Calibration, and cameras that differ from their drawing."""

from __future__ import annotations

from benchmarks.tables.table import Figures

SERVED: Figures = {
    f"served_{when}": ("daemon-calibration", f"digits that a daemon reads {words}", "{:.0%}")
    for when, words in {
        "before": "as its camera is drawn",
        "after": "once it was calibrated",
        "again": "after a restart, with the record",
    }.items()
}

CALIBRATED: Figures = {
    f"{knob}_{when}{figure}": ("daemon-calibration", f"{words}: {what}, decoded {said}", pattern)
    for knob, words in {
        "drawn": "nominal",
        "shift_y_150um": "mask 150 um off",
        "dead_lines": "a row and a column stuck open",
        "everything": "shift, rotation, distance, gamma, floor and a dead row at once",
        "gamma_2.2": "gamma 2.2",
        "leakage_0.2": "filters leak 20 % of the amplitude",
        "stray_0.1": "10 % stray light",
        "warm_up_0.1": "10 % of the light missing at first",
        "noise_30db": "noise of 30 dB, not 40",
    }.items()
    for figure, what, pattern in (
        ("", "digits read right", "{:.1%}"),
        ("_unexplained", "error of the scene", "{:.2f}"),
    )
    for when, said in {"before": "as nominal", "after": "as calibrated"}.items()
}
